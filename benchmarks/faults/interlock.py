"""Whether examples/interlock.py opens when a node is lost during a slip of the probes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import math
import os
import signal
import subprocess
import sys
import threading
import time

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from benchmarks.frame import ROOT
from benchmarks.served_node import ServedNode
from saddlering_interfaces.msg import RingAlarm
from saddlering_ros.ros.launcher import ALARM_NODES, NodeGroup, RING_NODES

from .driver import start_driver
from .stage import Outcome, PARAMETERS

REST = 3.5
"""At preload in each cycle [s], from which the alarm learns the noise."""

SPEED = 0.2
"""Share of the driver's nominal rate."""

MAX_DELAY = 5.0
"""Time [s] in which the interlock must open."""

FAULTS = ('killed', 'stopped', 'deactivated', 'delayed')
NODES = (*RING_NODES, *ALARM_NODES)
LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Operator(ServedNode):
    """Hears the interlock and the alarm, and enables the hydraulics."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, 'operator')
        self.enabled: list[tuple[float, bool]] = []
        self.states: list[int] = []
        self.node.create_subscription(Bool, 'rig/hydraulics_enabled', self._hear, 10)
        self.node.create_subscription(
            RingAlarm, 'ring/alarm', lambda alarm: self.states.append(alarm.state), LATCHED)
        self.reset = self.node.create_client(Trigger, '/interlock/reset')
        self.serve()

    def _hear(self, message: Bool) -> None:
        self.enabled.append((time.monotonic(), message.data))

    def is_enabled(self) -> bool:
        return bool(self.enabled) and self.enabled[-1][1]

    def enable(self, seconds: float) -> bool:
        """Ask the interlock to enable the hydraulics until it does."""
        deadline = time.monotonic() + seconds
        while not self.is_enabled() and time.monotonic() < deadline:
            with self.lock:
                self.reset.call_async(Trigger.Request())
            time.sleep(0.3)
        return self.is_enabled()

    def deactivate(self, name: str) -> None:
        """Deactivate a node; does not wait."""
        with self.lock:
            service = self.node.create_client(ChangeState, f'/{name}/change_state')
        while not service.service_is_ready():
            time.sleep(0.01)
        request = ChangeState.Request(
            transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
        with self.lock:
            service.call_async(request)


@contextlib.contextmanager
def everything() -> Iterator[tuple[Operator, dict[str, int]]]:
    """Nodes, driver, interlock and operator in full swing; the numbers of the processes."""
    with NodeGroup() as group, contextlib.ExitStack() as stack:
        assert group.domain_id is not None
        for name in NODES:
            group.start(name, PARAMETERS.get(name))
        operator = Operator(group.domain_id)
        stack.callback(operator.close)
        driver, _ = start_driver(group, SPEED, REST)
        interlock = subprocess.Popen([sys.executable, str(ROOT / 'examples' / 'interlock.py')],
                                     env=group.environment, stdout=subprocess.DEVNULL)
        for process in (driver, interlock):
            stack.callback(process.wait)
            stack.callback(process.kill)
        numbers = {name: node.process.pid for name, node in group.processes.items()}
        yield operator, {**numbers, 'driver': driver.pid}


def wait(condition: Callable[[], bool], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.005)


def seconds_until_open(fault: str, name: str) -> float:
    """Time [s] from a fault to the open interlock; NaN if it stays closed."""
    with everything() as (operator, numbers):
        if not operator.enable(60.0):
            return math.nan
        wait(lambda: RingAlarm.WATCHING in operator.states[-1:], 30.0)
        operator.enable(30.0)
        began, ended, number = time.monotonic(), threading.Event(), numbers[name]
        if name != 'driver' or fault == 'delayed':  # a driver that is gone publishes no slip
            os.kill(numbers['driver'], signal.SIGUSR1)
        if fault == 'deactivated':
            operator.deactivate(name)
        elif fault == 'delayed':
            threading.Thread(target=delay, args=(number, ended), daemon=True).start()
        else:
            os.kill(number, signal.SIGKILL if fault == 'killed' else signal.SIGSTOP)
        wait(lambda: not operator.is_enabled(), MAX_DELAY)
        ended.set()
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, signal.SIGCONT)
        return next((at - began for at, value in operator.enabled if at > began and not value),
                    math.nan)


def delay(number: int, ended: threading.Event) -> None:
    """Let a process run for a fifth of the time only."""
    with contextlib.suppress(ProcessLookupError):
        while not ended.is_set():
            os.kill(number, signal.SIGSTOP)
            time.sleep(0.4)
            os.kill(number, signal.SIGCONT)
            time.sleep(0.1)


def lose_nodes_in_a_slip() -> Outcome:
    """Every node, the alarm and the driver in turn is killed, stopped, deactivated or delayed."""
    out = Outcome()
    for name in (*NODES, 'driver'):
        for fault in FAULTS:
            if (name, fault) == ('driver', 'deactivated'):
                continue
            out.put_in += 1
            seconds = seconds_until_open(fault, name)
            print(f'  {name:18} {fault:12} open after {seconds:5.2f} s', flush=True)
            if not seconds < MAX_DELAY:
                out.faults.append(f'the interlock stayed closed: {name} {fault}')
            out.figures['slowest to open [s]'] = max(
                seconds, out.figures.get('slowest to open [s]', 0.0))
    return out
