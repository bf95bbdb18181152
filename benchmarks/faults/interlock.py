"""Whether examples/interlock.py opens when a node is lost during a slip of the probes.

python -m benchmarks.faults.interlock [--rate 500]

Every node, the driver and the alarm in turn is killed (SIGKILL), stopped (SIGSTOP), deactivated,
or delayed (stopped for 0.4 s of each 0.5 s). The probes slip by 60 um at that moment. Printed is
the time from the fault to `rig/hydraulics_enabled` false, and the state that the alarm gave.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Range
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from benchmarks.served_node import ServedNode
from saddlering_interfaces.msg import RingAlarm
from saddlering_ros.bags.messages import encode_samples
from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.record.samples import Samples
from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring import simulate
from saddlering_ros.ros.launcher import ALARM_NODES, NodeGroup, RING_NODES
from saddlering_ros.ros.raw_topics import RawPublisher

REPOSITORY = Path(__file__).resolve().parents[2]
ELEVATION = 50.0
SLIP = 60e-6
REST, CYCLE = 3.0, 6.0
FAULTS = ('killed', 'stopped', 'deactivated', 'delayed')
NODES = (*RING_NODES, *ALARM_NODES)
LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def drive(rate: float) -> None:
    """A sound ring at rest; SIGUSR2 makes the load swing, SIGUSR1 makes the probes slip."""
    slips: list[int] = []
    moves: list[int] = []
    signal.signal(signal.SIGUSR1, lambda *_: slips.append(1))
    signal.signal(signal.SIGUSR2, lambda *_: moves.append(sent))
    rig, chance = default_rig(), np.random.default_rng(1)
    time_axis = np.arange(0.0, CYCLE, 1.0 / rate)
    cycle = rig.preload + 1e5 * np.sin(np.pi * time_axis / CYCLE)**2
    probes = simulate(rig, ParameterSet(TRUE_TO_SCALE), np.radians(ELEVATION), time_axis,
                      cycle).probes
    rclpy.init()
    node = rclpy.create_node('driver')
    load_flow = RawPublisher(node, LOAD_TOPIC, WrenchStamped)
    flows = [RawPublisher(node, topic, Range) for topic in PROBE_TOPICS]
    start, sent = time.time_ns(), 0
    while os.getppid() != 1:
        due = int((time.time_ns() - start) * 1e-9 * rate)
        if due > sent:
            index = np.arange(sent, due)
            stamps = start + np.round(index / rate * 1e9).astype(np.int64)
            place = np.maximum(index - moves[0], 0) % cycle.size if moves else 0 * index
            samples = Samples(stamps, cycle[place] + chance.normal(0.0, 20.0, index.size))
            load_flow.send(encode_samples(samples, LOAD), int(stamps[-1]))
            for number, flow in enumerate(flows):
                gaps = 1e-3 + probes[number][place] + chance.normal(0.0, 3e-7, index.size)
                gaps += (1, 0, -1, 0)[number] * SLIP * bool(slips)
                readings = Samples(stamps, np.float64(np.float32(gaps)), 0.0, 2e-3)
                flow.send(encode_samples(readings, PROBES[number]), int(stamps[-1]))
            sent = due
        time.sleep(0.002)


class Listener(ServedNode):
    """Hears the interlock and the alarm."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, 'listener')
        self.enabled: list[tuple[float, bool]] = []
        self.limits: list[tuple[float, bool]] = []
        self.told: list[RingAlarm] = []
        self.node.create_subscription(Bool, 'rig/hydraulics_enabled', self._hear_enabled, 10)
        self.node.create_subscription(Bool, 'ring/within_limits', self._hear_limit, LATCHED)
        self.node.create_subscription(RingAlarm, 'ring/alarm', self.told.append, LATCHED)
        self.reset = self.node.create_client(Trigger, '/interlock/reset')
        self.serve()

    def _hear_enabled(self, message: Bool) -> None:
        self.enabled.append((time.monotonic(), message.data))

    def _hear_limit(self, message: Bool) -> None:
        self.limits.append((time.monotonic(), message.data))

    def enable(self, seconds: float) -> bool:
        """Ask the interlock to enable the hydraulics until it does."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if self.enabled and self.enabled[-1][1]:
                return True
            with self.lock:
                self.reset.call_async(Trigger.Request())
            time.sleep(0.3)
        return False

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
def everything(rate: float) -> Iterator[tuple[Listener, dict[str, int]]]:
    """Nodes, driver, interlock and listener in full swing; the numbers of the processes."""
    with NodeGroup() as group, contextlib.ExitStack() as stack:
        assert group.domain_id is not None
        for name in NODES:
            group.start(name, {'elevation_deg': ELEVATION} if name == 'ring_simulator' else {})
        listener = Listener(group.domain_id)
        stack.callback(listener.close)
        others = {
            'driver': [sys.executable, '-m', __spec__.name, '--drive', str(rate)],
            'interlock': [sys.executable, str(REPOSITORY / 'examples' / 'interlock.py')]}
        numbers = {name: node.process.pid for name, node in group.processes.items()}
        for name, command in others.items():
            process = subprocess.Popen(command, cwd=REPOSITORY, env=group.environment,
                                       stdout=subprocess.DEVNULL)
            stack.callback(process.wait)
            stack.callback(process.kill)
            numbers[name] = process.pid
        yield listener, numbers


def try_fault(fault: str, name: str, rate: float) -> tuple[float, float, str]:
    """Seconds from the fault to the open interlock and to a limit of false; the alarm's words."""
    with everything(rate) as (listener, numbers):
        if not listener.enable(60.0):
            return float('nan'), float('nan'), 'never enabled'
        time.sleep(REST)
        os.kill(numbers['driver'], signal.SIGUSR2)
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline and not (
                listener.told and listener.told[-1].state == RingAlarm.WATCHING):
            time.sleep(0.02)
        listener.enable(30.0)
        ended = threading.Event()
        began = time.monotonic()
        if name == 'driver' and fault != 'delayed':
            pass  # a driver that is gone publishes no slip
        else:
            os.kill(numbers['driver'], signal.SIGUSR1)
        if fault == 'killed':
            os.kill(numbers[name], signal.SIGKILL)
        elif fault == 'stopped':
            os.kill(numbers[name], signal.SIGSTOP)
        elif fault == 'deactivated':
            listener.deactivate(name)
        else:
            threading.Thread(target=_delay, args=(numbers[name], ended), daemon=True).start()
        while time.monotonic() - began < 5.0 and (
                not listener.enabled or listener.enabled[-1][1]):
            time.sleep(0.005)
        time.sleep(0.3)
        ended.set()
        with contextlib.suppress(ProcessLookupError):
            os.kill(numbers[name], signal.SIGCONT)
        opened = [at for at, value in listener.enabled if at > began and not value]
        limited = [at for at, value in listener.limits if at > began and not value]
        told = listener.told[-1]
        return (opened[0] - began if opened else float('nan'),
                limited[0] - began if limited else float('nan'), told.message[:90])


def _delay(number: int, ended: threading.Event) -> None:
    """Let a process run for a fifth of the time only."""
    with contextlib.suppress(ProcessLookupError):
        while not ended.is_set():
            os.kill(number, signal.SIGSTOP)
            time.sleep(0.4)
            os.kill(number, signal.SIGCONT)
            time.sleep(0.1)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--rate', type=float, default=500.0)
    parser.add_argument('--drive', type=float, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.drive:
        drive(args.drive)
        return 0
    closed = 0
    for name in (*NODES, 'driver'):
        for fault in FAULTS:
            if name == 'driver' and fault == 'deactivated':
                continue
            opened, limited, words = try_fault(fault, name, args.rate)
            closed += not opened < 5.0
            print(f'{name:18} {fault:12} open after {opened:5.2f} s, limit false after '
                  f'{limited:5.2f} s: {words}', flush=True)
    print(f'{closed} times the interlock stayed closed')
    return 1 if closed else 0


if __name__ == '__main__':
    sys.exit(main())
