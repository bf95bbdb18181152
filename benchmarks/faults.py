"""Faults put into running nodes, and whether they keep their promises; real processes, real DDS.

python benchmarks/faults.py [--rounds 3] [--seed 1] [--only NAME ...] [--hours 24] [--json FILE]

A driver publishes the five raw topics of a ring whose true motion is known, or a bag is replayed
in lockstep; one fault after the other is put in at random moments. After each it is asked:

- numbers: has a displacement, simulated displacement or residual gone out that differs from the
  truth by more than TOLERANCE, without a warning or error on /diagnostics within two seconds?
- others: do the processes that were left alone still run, and publish?
- back: is a node that was started again in step, or does it say what it waits for, within a second
  of its first sign of life?
- clean: has every process ended, and does nothing in /dev/shm stay locked or break a next start?

Prints faults put in and faults survived; status 1 if a promise was broken.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
import contextlib
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_interfaces.msg import ReplayProgress, RingDisplacement
from saddlering_ros.bags import LOAD_TOPIC, PROBE_TOPICS, TestFacts, write_bag
from saddlering_ros.rig import CHANNELS, default_rig, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring import simulate
from saddlering_ros.ros.launcher import NodeGroup, RING_NODES, start_nodes
from saddlering_ros.ros.lockstep import PROGRESS_TOPIC
from saddlering_ros.ros.raw_topics import RawPublisher, RawSubscription, stream_qos
from saddlering_ros.streams import wire

RIG = default_rig()
ELEVATION = 50.0
RATE = 1000.0
CYCLE = 6.0
TOLERANCE = 2e-6
"""Of a published number [m, rad]; the truth is known to 0.1 of it."""

NOTICE = 2.0
"""A wrong number must be covered by a diagnostic within so many seconds before or after it."""

REST = round(0.5e9)
"""After its zero [ns] a simulation is in full swing."""

IN_STEP = 1.0
OUTPUTS = {'ring_displacement': '/ring/displacement',
           'ring_simulator': '/ring/simulated_displacement', 'ring_residual': '/ring/residual'}
MARK = 'SADDLERING_FAULTS'


# --- a ring whose motion is known ---

@dataclass(frozen=True)
class Truth:
    """One cycle of load that repeats for ever: load [N] (N,), gaps [m] (4, N), motion (4, N)."""

    load: np.ndarray
    gaps: np.ndarray
    motion: np.ndarray

    @classmethod
    def make(cls, rate: float = RATE, cycle: float = CYCLE) -> Truth:
        """1.2 s at preload, up to about 24 t and back; the second of two cycles, in full swing."""
        count = round(cycle * rate)
        time = np.arange(2 * count) / rate
        ramp = (cycle - 1.6) / 2.0
        within = time % cycle
        share = np.clip(np.minimum((within - 1.2) / ramp, (cycle - 0.4 - within) / ramp), 0.0, 1.0)
        load = RIG.preload + 230e3 * share
        run = simulate(RIG, ParameterSet(TRUE_TO_SCALE), np.radians(ELEVATION), time, load)
        motion = np.stack([np.asarray(getattr(run.displacement, name)) for name in CHANNELS])
        gaps = 1e-3 + np.asarray(RIG.probes.polarity)[:, None] * run.probes
        return cls(load[-count:], np.float64(np.float32(gaps[:, -count:])), motion[:, -count:])

    def at(self, seconds: np.ndarray, rate: float = RATE) -> np.ndarray:
        """Motion (4, N) at times since a cycle began."""
        place = (seconds * rate) % self.load.size
        whole = np.arange(self.load.size + 1)
        return np.stack([np.interp(place, whole, np.append(row, row[0])) for row in self.motion])


def driver_role() -> None:
    """A driver on its own: the truth's cycle on five topics, by the clock, until told to end.

    First argument: times the nominal rate. It says where its cycles begin [ns], then goes on.
    """
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import Range
    speed = float(sys.argv[3])
    truth = Truth.make()
    rate = RATE * speed
    rclpy.init()
    node = rclpy.create_node('driver')
    flows = [RawPublisher(node, LOAD_TOPIC, WrenchStamped)]
    flows += [RawPublisher(node, topic, Range) for topic in PROBE_TOPICS]
    start = time.time_ns() + 500_000_000
    print(start, flush=True)
    sent = 0
    count = truth.load.size
    while os.getppid() != 1:
        due = int((time.time_ns() - start) / 1e9 * rate)
        if due > sent:
            index = np.arange(sent, min(due, sent + 2000))
            stamps = start + np.round(index / rate * 1e9).astype(np.int64)
            place = np.round(index / speed).astype(int) % count
            low, high = RIG.probes.min_range, RIG.probes.max_range
            flows[0].send(wire.encode_loads(wire.Samples(stamps, truth.load[place]),
                                            'hydraulic_cylinder'), int(stamps[-1]))
            for number, flow in enumerate(flows[1:]):
                samples = wire.Samples(stamps, truth.gaps[number][place], low, high)
                flow.send(wire.encode_gaps(samples, f'eddy_current_{number + 1}'),
                          int(stamps[-1]))
            sent = int(index[-1]) + 1
        time.sleep(0.004)


# --- who listens ---

@dataclass(frozen=True)
class Heard:
    """A batch of one topic, and when it came (monotonic) [s]."""

    batch: wire.Displacements
    arrived: float


class Listener:
    """A node of this process that keeps everything the ring nodes say, with its time."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(f'listener_{time.monotonic_ns()}', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.lock = threading.RLock()
        self.heard: dict[str, list[Heard]] = {topic: [] for topic in OUTPUTS.values()}
        self.said: list[tuple[float, str, int, str]] = []
        self.alive: dict[str, float] = {}
        self.progress: dict[str, ReplayProgress] = {}
        self.words: dict[str, str] = {}
        self._flows = {topic: RawSubscription(self.node, topic, RingDisplacement)
                       for topic in OUTPUTS.values()}
        self._progress = RawSubscription(self.node, PROGRESS_TOPIC, ReplayProgress)
        self._diagnostics = RawSubscription(self.node, '/diagnostics', DiagnosticArray)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while not self._stop.is_set():
            with self.lock:
                self.executor.spin_once(timeout_sec=0.0)
                self._take(time.monotonic())
            time.sleep(0.002)

    def _take(self, now: float) -> None:
        for topic, flow in self._flows.items():
            messages = flow.take()
            if messages:
                self.heard[topic].append(Heard(wire.decode_displacements(messages), now))
        for message in self._progress.take():
            progress = deserialize_message(message, ReplayProgress)
            self.alive[progress.node], self.progress[progress.node] = now, progress
        for message in self._diagnostics.take():
            for status in deserialize_message(message, DiagnosticArray).status:
                self.said.append((now, status.name, status.level[0], status.message))
                self.words[status.name] = f'{now:.1f} {status.message}'

    def last(self, topic: str) -> float:
        """When something came last on a topic [s, monotonic]; 0 for never."""
        with self.lock:
            return self.heard[topic][-1].arrived if self.heard[topic] else 0.0

    def since(self, topic: str, when: float) -> int:
        """How many samples came on a topic after `when`."""
        with self.lock:
            return sum(len(item.batch) for item in self.heard[topic] if item.arrived > when)

    def warned(self, when: float, until: float, node: str = '') -> list[str]:
        """What was said above OK between two times, by one node or all."""
        with self.lock:
            return [f'{name}: {words}' for at, name, level, words in self.said
                    if when <= at <= until and 0 < level < 3 and name.startswith(node)]

    def state(self) -> str:
        """What every node said last, and whom it is matched with, to find a cause by."""
        with self.lock:
            lines = [f'{name}: {words}' for name, words in sorted(self.words.items())]
            for name, said in sorted(self.progress.items()):
                inputs = zip(said.inputs, said.publishers, said.received, strict=True)
                outputs = zip(said.outputs, said.subscriptions, said.published, strict=True)
                lines.append(f'{name} at {self.alive[name]:.1f}: has publishers, received '
                             f'{list(inputs)}; has subscriptions, published {list(outputs)}')
            lines += [f'here: {topic} has {flow.publishers()} publishers'
                      for topic, flow in self._flows.items()]
        return '\n        '.join([f'at {time.monotonic():.1f}', *lines])

    def call(self, name: str) -> bool:
        """Call a Trigger service."""
        with self.lock:
            client = self.node.create_client(Trigger, name)
        end = time.monotonic() + 20.0
        while not client.service_is_ready() and time.monotonic() < end:
            time.sleep(0.02)
        with self.lock:
            future = client.call_async(Trigger.Request())
        while not future.done() and time.monotonic() < end:
            time.sleep(0.01)
        return future.done() and bool(future.result().success)

    def forget(self) -> None:
        """Forget what was heard."""
        with self.lock:
            for items in self.heard.values():
                items.clear()
            self.said.clear()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.executor.shutdown(timeout_sec=0.0)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def wrong_numbers(listener: Listener, truth: Truth, starts: list[int],
                  tolerance: float = TOLERANCE) -> list[str]:
    """Numbers that went out, differ from the truth, and about which nothing was said.

    starts: stamps [ns] at which the cycles of each source of samples began; a number that fits one
    of them is right.
    """
    still = truth.motion[:, 400:1100].mean(axis=1, keepdims=True)
    faults = []
    with listener.lock:
        heard = {topic: list(items) for topic, items in listener.heard.items()}
    for topic, items in heard.items():
        for item in items:
            error = np.full(len(item.batch), np.inf)
            for start in starts:
                expected = truth.at((item.batch.stamps - start) / 1e9) - still
                if topic == '/ring/residual':
                    expected = np.zeros_like(expected)
                error = np.minimum(error, np.abs(item.batch.channels - expected).max(axis=0))
            # The zero is taken for rest; a ring still coming to rest then differs until it is.
            error[item.batch.stamps < item.batch.zero_stamps + REST] = 0.0
            worst = float(error.max(initial=0.0))
            if worst > tolerance or not np.isfinite(item.batch.channels).all():
                noticed = listener.warned(item.arrived - NOTICE, item.arrived + NOTICE)
                if not noticed:
                    stamp = item.batch.stamps[int(np.argmax(error))]
                    faults.append(f'{topic}: off by {worst * 1e6:.1f} um at stamp {stamp}, '
                                  'nothing said')
    return faults[:5]


# --- the stage ---

@dataclass
class Stage:
    """The three ring nodes, a driver, and a listener."""

    group: NodeGroup
    listener: Listener
    truth: Truth
    driver: subprocess.Popen[str]
    start: int
    chance: random.Random
    faults: list[str] = field(default_factory=list)
    put_in: int = 0

    def expect(self, condition: Callable[[], bool], seconds: float, what: str) -> float:
        """Wait for a condition; a broken promise if it does not come true. How long it took."""
        began = time.monotonic()
        while not condition():
            if time.monotonic() - began > seconds:
                now = time.monotonic()
                words = sorted(set(self.listener.warned(now - 1.5, now)))
                self.faults.append(f'not within {seconds:g} s: {what} (said: {words})')
                print(f'        {what}: {self.listener.state()}', flush=True)
                break
            time.sleep(0.005)
        return time.monotonic() - began

    def others_run(self, *but: str) -> None:
        """Every process that was left alone still runs."""
        for name, node in self.group.processes.items():
            if name not in but and not node.running:
                self.faults.append(f'{name} ended with status {node.process.returncode}: '
                                   f'{node.said()[-200:]}')

    def in_flow(self, *names: str, seconds: float = 20.0) -> None:
        """The named nodes publish (again)."""
        now = time.monotonic()
        for name in names or tuple(OUTPUTS):
            self.expect(lambda topic=OUTPUTS[name]: self.listener.since(topic, now) > 0, seconds,
                        f'{name} publishes')

    def kill(self, name: str) -> None:
        """Kill -9."""
        self.group.processes[name].process.kill()
        self.group.processes[name].process.wait()

    def numbers(self) -> None:
        """Compare all that was heard with the truth, and forget it."""
        time.sleep(1.2)  # the diagnostics of the last second
        self.faults += wrong_numbers(self.listener, self.truth, [self.start])
        self.listener.forget()

    def zero_together(self) -> None:
        """A node that zeroed anew alone is said not to fit the other; one call puts that right."""
        began = time.monotonic()
        self.expect(lambda: self.listener.since('/ring/residual', began) > 0 or any(
            at > began and name.startswith('ring_residual') and level > 0
            for at, name, level, _ in list(self.listener.said)),
            3.0, 'residual, or a word about why there is none')
        for _ in range(5):
            if self.listener.since('/ring/residual', time.monotonic() - 0.3):
                return
            while not 0.2 < (time.time_ns() - self.start) / 1e9 % CYCLE < 0.5:
                time.sleep(0.02)  # at preload, as someone who knows the test would
            self.listener.call('/ring_displacement/zero')
            time.sleep(1.5)
        self.in_flow('ring_residual', seconds=2.0)

    def pause(self, low: float = 0.1, high: float = CYCLE) -> None:
        """A random while."""
        time.sleep(self.chance.uniform(low, high))


PARAMETERS = {'ring_simulator': {'elevation_deg': ELEVATION}}


def start_driver(group: NodeGroup, speed: float = 1.0) -> tuple[subprocess.Popen[str], int]:
    """A driver process, and the stamp at which its first cycle begins."""
    driver = subprocess.Popen(
        [sys.executable, __file__, '--role', 'driver', str(speed)], env=group.environment,
        stdout=subprocess.PIPE, text=True)
    assert driver.stdout is not None
    return driver, int(driver.stdout.readline())


@contextlib.contextmanager
def stage(chance: random.Random, nodes: tuple[str, ...] = RING_NODES,
          domain: int | None = None) -> Iterator[Stage]:
    """Everything started, matched and in full swing; ended again whatever happens."""
    truth = Truth.make()
    with NodeGroup(domain_id=domain) as group:
        assert group.domain_id is not None
        listener = Listener(group.domain_id)
        for name in nodes:
            group.start(name, PARAMETERS.get(name))
        driver, start = start_driver(group)
        one = Stage(group, listener, truth, driver, start, chance)
        try:
            one.in_flow(*[name for name in nodes if name in OUTPUTS], seconds=60.0)
            one.listener.forget()
            yield one
        finally:
            one.driver.kill()
            one.driver.wait()
            listener.close()


# --- faults beside a driver ---

def kill_and_restart(one: Stage, name: str) -> float:
    """Kill a node at a random moment, start it again; how long until it is in step or says why."""
    one.put_in += 1
    one.pause()
    killed = time.monotonic()
    one.kill(name)
    time.sleep(0.3)
    others = [other for other in OUTPUTS if other != name and other != 'ring_residual']
    one.in_flow(*others, seconds=6.0)  # at most the rest of a cycle, should it wait for preload
    one.others_run(name)
    one.listener.alive.pop(name, None)
    one.group.start(name, PARAMETERS.get(name))
    one.expect(lambda: one.listener.alive.get(name, 0.0) > killed, 30.0, f'{name} lives')
    alive = one.listener.alive.get(name, time.monotonic())
    topic = OUTPUTS[name]

    def accounted() -> bool:
        return one.listener.last(topic) > alive or any(
            at > alive - 1.0 and said.startswith(name) and (level > 0 or 'waiting' in words)
            for at, said, level, words in list(one.listener.said))

    one.expect(accounted, IN_STEP + 0.3, f'{name} in step, or says what it waits for')
    took = time.monotonic() - alive
    if name != 'ring_residual':
        one.in_flow(name, seconds=2.5 * CYCLE)
    one.zero_together()
    one.numbers()
    return took


def stall_a_subscriber(one: Stage) -> None:
    """A process that subscribes to everything reliably, and then stands still."""
    one.put_in += 1
    code = ('import rclpy, sys, time\n'
            'from saddlering_interfaces.msg import RingDisplacement\n'
            'from geometry_msgs.msg import WrenchStamped\n'
            'from saddlering_ros.ros.raw_topics import stream_qos\n'
            'rclpy.init(); node = rclpy.create_node("stalled")\n'
            'for topic, kind in (("/ring/displacement", RingDisplacement), '
            '("/ring/residual", RingDisplacement), ("/rig/hydraulic_load", WrenchStamped)):\n'
            '    node.create_subscription(kind, topic, lambda m: None, stream_qos())\n'
            'print("ready", flush=True)\n'
            'end = time.monotonic() + 2\n'
            'while time.monotonic() < end: rclpy.spin_once(node, timeout_sec=0.1)\n'
            'print("spun", flush=True); time.sleep(600)\n')
    stalled = subprocess.Popen([sys.executable, '-c', code], env=one.group.environment,
                               stdout=subprocess.PIPE, text=True)
    assert stalled.stdout is not None
    try:
        stalled.stdout.readline()
        stalled.stdout.readline()
        stalled.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        time.sleep(8.0)
        count = one.listener.since('/ring/displacement', began)
        if count < 0.9 * 8.0 * RATE:
            one.faults.append(f'beside a stalled subscriber {count} of {8 * RATE:.0f} came')
        one.others_run()
        one.numbers()
    finally:
        stalled.kill()
        stalled.wait()


def join_late(one: Stage) -> None:
    """A second listener in the middle of a cycle hears right numbers at once."""
    one.put_in += 1
    one.pause()
    assert one.group.domain_id is not None
    late = Listener(one.group.domain_id)
    try:
        one.expect(lambda: late.since('/ring/displacement', 0.0) > 0, 5.0, 'a late joiner hears')
        time.sleep(1.0)
        one.faults += wrong_numbers(late, one.truth, [one.start])
    finally:
        late.close()
    one.numbers()


def stop_a_node(one: Stage, name: str) -> None:
    """A node stands still for three seconds, as on a machine that has something else to do."""
    one.put_in += 1
    one.pause()
    process = one.group.processes[name].process
    process.send_signal(signal.SIGSTOP)
    time.sleep(3.0)
    one.others_run()
    process.send_signal(signal.SIGCONT)
    one.in_flow(seconds=2.5 * CYCLE)
    one.numbers()


def send_rubbish(one: Stage) -> None:
    """NaN, infinite, absurd readings, stamps of far past and future, from a second source."""
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import Range
    one.put_in += 1
    with one.listener.lock:
        node = one.listener.node
        load = RawPublisher(node, LOAD_TOPIC, WrenchStamped, stream_qos())
        probe = RawPublisher(node, PROBE_TOPICS[0], Range, stream_qos())
    one.expect(lambda: load.subscriptions() >= 2, 5.0, 'the second source is matched')
    now = time.time_ns()
    far = [0, 1, now - 10 ** 12, now + 10 ** 12, 2 ** 31 * 10 ** 9 - 1]
    stamps = np.array([now, now + 1, *far], np.int64)
    for value in (np.nan, np.inf, -np.inf, 1e38, -1e38, 0.0):
        samples = wire.Samples(stamps, np.full(len(stamps), value), np.nan, np.inf)
        with np.errstate(all='ignore'):
            load.send(wire.encode_loads(samples, 'x' * 1000), now)
            probe.send(wire.encode_gaps(samples, ''), now)
    load.send([b'', b'\0\1\0\0', b'\0\1\0\0' + b'\xff' * 40, bytes(100_000)], now)
    time.sleep(2.0)
    with one.listener.lock:
        load.close()
        probe.close()
    one.others_run()
    one.in_flow(seconds=3.0 * CYCLE)
    one.numbers()


def ten_times(one: Stage) -> None:
    """Ten times the nominal rate for a while: what is lost must be said; then all is as before."""
    one.put_in += 1
    one.driver.kill()
    one.driver.wait()
    time.sleep(1.0)
    one.numbers()
    one.driver, one.start = start_driver(one.group, 10.0)
    began = time.monotonic()
    one.in_flow('ring_displacement', seconds=30.0)
    time.sleep(max(0.0, began + 10.0 - time.monotonic()))
    one.others_run()
    one.driver.kill()
    one.driver.wait()
    time.sleep(3.0)
    # Between two samples of one cycle the driver repeats the former ten times.
    one.faults += wrong_numbers(one.listener, one.truth, [one.start], 5 * TOLERANCE)
    one.listener.forget()
    one.driver, one.start = start_driver(one.group)
    one.in_flow(seconds=5.0 * CYCLE)
    one.numbers()


def slow_disk_library(folder: Path) -> Path:
    """A library that makes every write and fsync of a process take 0.2 s."""
    source = folder / 'slow.c'
    source.write_text(
        '#define _GNU_SOURCE\n#include <dlfcn.h>\n#include <unistd.h>\n#include <sys/stat.h>\n'
        'static int is_file(int fd) {\n'
        '  struct stat s;\n  return !fstat(fd, &s) && S_ISREG(s.st_mode);\n}\n'
        'ssize_t write(int fd, const void *data, size_t size) {\n'
        '  static ssize_t (*real)(int, const void *, size_t);\n'
        '  if (!real) real = dlsym(RTLD_NEXT, "write");\n'
        '  if (is_file(fd)) usleep(200000);\n  return real(fd, data, size);\n}\n'
        'int fsync(int fd) {\n  static int (*real)(int);\n'
        '  if (!real) real = dlsym(RTLD_NEXT, "fsync");\n'
        '  usleep(200000);\n  return real(fd);\n}\n')
    library = folder / 'slow.so'
    subprocess.run(['cc', '-shared', '-fPIC', '-o', str(library), str(source), '-ldl'], check=True)
    return library


def slow_disk(one: Stage) -> None:
    """A node whose logs go to a disk that takes 0.2 s for every write."""
    one.put_in += 1
    with tempfile.TemporaryDirectory() as name:
        library = slow_disk_library(Path(name))
        one.kill('ring_displacement')
        kept, one.group.extra_environment = one.group.extra_environment, {
            'LD_PRELOAD': str(library)}
        one.group.start('ring_displacement')
        one.group.extra_environment = kept
        one.in_flow(seconds=40.0)
        began = time.monotonic()
        time.sleep(4.0)
        count = one.listener.since('/ring/displacement', began)
        if count < 0.9 * 4.0 * RATE:
            one.faults.append(f'on a slow disk {count} of {4 * RATE:.0f} came')
        one.numbers()
        one.kill('ring_displacement')
        one.group.start('ring_displacement')
        one.in_flow(seconds=40.0)
        one.listener.forget()


def full_log_disk(one: Stage) -> None:
    """A node that may write no file any more, neither its log nor anything else."""
    one.put_in += 1
    pid = one.group.processes['ring_displacement'].process.pid
    limits = resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
    one.pause()
    one.listener.call('/ring_displacement/zero')  # something it logs or answers
    one.in_flow(seconds=2.5 * CYCLE)
    one.others_run()
    resource.prlimit(pid, resource.RLIMIT_FSIZE, limits)
    # The zero was asked for at any load: numbers count from there, and say so in zero_load.
    one.kill('ring_simulator')
    one.kill('ring_displacement')
    for name in ('ring_simulator', 'ring_displacement'):
        one.group.start(name, PARAMETERS.get(name))
    one.in_flow(seconds=40.0)
    one.listener.forget()


# --- faults in a replay ---

def cycle_bag(folder: Path, truth: Truth, cycles: int, rate: float = RATE) -> tuple[Path, int]:
    """A bag of `cycles` cycles; its path, and its first stamp."""
    start = 1_700_000_000_000_000_000
    count = truth.load.size * cycles
    stamps = start + np.round(np.arange(count) / rate * 1e9).astype(np.int64)
    bag = write_bag(folder / 'bag', TestFacts('dynamic', ELEVATION), stamps,
                    np.tile(truth.load, cycles), [stamps] * 4,
                    list(np.tile(truth.gaps, (1, cycles))), RIG.probes)
    return bag, start


@dataclass
class Outcome:
    """Of one scenario: what was put in, which promises were broken, figures worth showing."""

    put_in: int = 0
    faults: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)


def lose_replay_nodes(chance: random.Random) -> Outcome:
    """Each node of a replay is killed and started again; the replay goes on, or begins anew."""
    out = Outcome()
    truth = Truth.make()
    names = ('hydraulic_load', 'eddy_current', 'replay_clock', 'ring_displacement',
             'ring_simulator')
    with tempfile.TemporaryDirectory() as folder:
        bag, start = cycle_bag(Path(folder), truth, 40)
        replay = {'replay_clock': {'timeout': 1.0}}
        with start_nodes(bag, rate=2.0, exit_at_end=False, parameters=replay) as group:
            listener = Listener(group.domain_id)
            one = Stage(group, listener, truth, None, start, chance)  # type: ignore[arg-type]
            one.in_flow(seconds=60.0)
            given = {'replay_clock': {
                'bag': str(bag), 'lockstep': True, 'rate': 2.0, 'timeout': 1.0,
                'participants': ['hydraulic_load', 'eddy_current', *RING_NODES]}}
            for name in names:
                out.put_in += 1
                one.pause(0.2, 2.0)
                one.kill(name)
                time.sleep(2.0)
                one.others_run(name)
                group.start(name, given.get(name, {'bag': str(bag)}))
                one.in_flow(seconds=30.0)
            out.put_in += 1  # a paused clock
            if not listener.call('/replay_clock/pause'):
                one.faults.append('the replay cannot be paused')
            time.sleep(0.5)
            standing = time.monotonic()
            time.sleep(2.0)
            if listener.since('/ring/residual', standing):
                one.faults.append('samples came from a paused replay')
            if not listener.call('/replay_clock/play'):
                one.faults.append('the replay does not go on')
            one.in_flow(seconds=10.0)
            out.put_in += 1  # a clock that hangs
            clock = group.processes['replay_clock'].process
            clock.send_signal(signal.SIGSTOP)
            since = time.monotonic()
            time.sleep(4.5)
            if not any('silent' in words for words in listener.warned(since, time.monotonic())):
                one.faults.append('nobody says that /clock is silent')
            clock.send_signal(signal.SIGCONT)
            one.in_flow(seconds=10.0)
            time.sleep(1.2)
            one.others_run()
            out.faults += one.faults + wrong_numbers(listener, truth, [start])
            listener.close()
    return out


def two_replays(chance: random.Random) -> Outcome:
    """Two replays of bags recorded at different times, on one domain: mixed up, and said so."""
    out = Outcome(put_in=1)
    truth = Truth.make()
    with tempfile.TemporaryDirectory() as name:
        bag, start = cycle_bag(Path(name), truth, 12)
        with start_nodes(bag, lockstep=False, rate=1.0, exit_at_end=False) as group:
            listener = Listener(group.domain_id)
            one = Stage(group, listener, truth, None, start, chance)  # type: ignore[arg-type]
            one.in_flow(seconds=60.0)
            one.pause(0.5, 2.0)
            with start_nodes(bag, nodes=(), lockstep=False, rate=1.0, exit_at_end=False,
                             domain_id=group.domain_id) as second:
                began = time.monotonic()
                one.expect(lambda: any('publishers on' in words for words in listener.warned(
                    began, time.monotonic())), 30.0, 'someone says that there are two sources')
                time.sleep(6.0)
                for process in second.processes.values():
                    if not process.running:
                        one.faults.append(f'{process.name} of the second replay ended')
            one.others_run()
            one.in_flow(seconds=4.0 * CYCLE)
            time.sleep(1.2)
            out.faults += one.faults + wrong_numbers(listener, truth, [start])
            listener.close()
    return out


def kill_action_servers(chance: random.Random) -> Outcome:
    """Action servers killed in the middle of a goal: their workers go too, new ones serve."""
    bags = ['dynamic_50_fast']
    out = Outcome()
    with NodeGroup() as group:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=group.domain_id)
        node = rclpy.create_node('client', context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        for server, topic, action, goal in (
                ('ring_identification', '/identify_ring', IdentifyRing,
                 IdentifyRing.Goal(bags=bags, particles=200, iterations=100_000)),
                ('ring_diagnosis', '/diagnose_ring', DiagnoseRing, DiagnoseRing.Goal(bags=bags))):
            client = ActionClient(node, action, topic)
            for _ in range(2):
                out.put_in += 1
                group.start(server)
                process = group.processes[server].process
                out.faults += [f'{server}: {fault}' for fault in kill_in_a_goal(
                    process, client, executor, goal, chance)]
            client.destroy()
        executor.shutdown(timeout_sec=0.0)
        node.destroy_node()
        rclpy.shutdown(context=context)
    return out


def kill_in_a_goal(process: subprocess.Popen[str], client: ActionClient,
                   executor: SingleThreadedExecutor, goal: Any, chance: random.Random,
                   ) -> list[str]:
    """Kill -9 of a server while it works on a goal; broken promises."""
    if not client.wait_for_server(60.0):
        return ['the server does not serve']
    faults = []
    running: list[Any] = []
    sent = client.send_goal_async(goal, feedback_callback=running.append)
    asked, end = time.monotonic(), time.monotonic() + 90.0
    while not running and time.monotonic() < end:
        executor.spin_once(0.1)
        # A server killed without a word stays known for a while: what went to it is lost.
        if not sent.done() and time.monotonic() - asked > 5.0:
            asked = time.monotonic()
            sent = client.send_goal_async(goal, feedback_callback=running.append)
    if not running:
        faults.append('no feedback')
    time.sleep(chance.uniform(0.0, 1.0))
    workers = children_of(process.pid)
    process.kill()
    process.wait()
    end = time.monotonic() + 3.0
    while any(map(lives, workers)) and time.monotonic() < end:
        time.sleep(0.05)
    if not workers or any(map(lives, workers)):
        faults.append(f'workers {workers} outlive their server')
    return faults


def full_disk(chance: random.Random) -> Outcome:
    """Commands that write where there is no room: status 2, one line, the old file kept."""
    out = Outcome()
    truth = Truth.make()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag, _ = cycle_bag(folder, truth, 3)
        place, mounted = folder / 'full', False
        place.mkdir()
        if os.geteuid() == 0:
            done = subprocess.run(['mount', '-t', 'tmpfs', '-o', 'size=64k', 'tmpfs', str(place)],
                                  capture_output=True, check=False)
            mounted = done.returncode == 0
        try:
            for output in ('d.csv', 'd.parquet'):
                out.put_in += 1
                target = place / output
                target.write_text('old')
                done = subprocess.run(
                    [sys.executable, '-m', 'saddlering_ros.cli.main', 'displacement', str(bag),
                     '--out', str(target)], capture_output=True, text=True, check=False,
                    preexec_fn=None if mounted else limit_files)
                lines = done.stderr.splitlines()
                if done.returncode != 2 or len(lines) != 1 or 'cannot be written' not in lines[0]:
                    out.faults.append(f'{output}: status {done.returncode}, {done.stderr[-200:]}')
                if target.read_text() != 'old' or len(list(place.iterdir())) != 1:
                    out.faults.append(f'{output}: the old file is not alone there any more')
                target.unlink()
        finally:
            if mounted:
                subprocess.run(['umount', str(place)], check=False)
        out.faults += killed_on_a_slow_disk(folder, bag, chance)
        out.put_in += 3
    out.figures['on a full tmpfs'] = float(mounted)
    return out


def killed_on_a_slow_disk(folder: Path, bag: Path, chance: random.Random) -> list[str]:
    """A command killed while it writes on a slow disk leaves the old file or the new one."""
    library = slow_disk_library(folder)
    target = folder / 'samples.csv'
    faults = []
    command = [sys.executable, '-m', 'saddlering_ros.cli.main', 'displacement', str(bag), '--out',
               str(target)]
    subprocess.run(command, check=True, capture_output=True)
    new = target.read_bytes()
    for _ in range(3):
        target.write_text('old')
        process = subprocess.Popen(command, env={**os.environ, 'LD_PRELOAD': str(library)},
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not list(folder.glob('.samples*')) and process.poll() is None:
            time.sleep(0.01)
        time.sleep(chance.uniform(0.0, 1.0))
        process.kill()
        process.wait()
        if target.read_bytes() not in (b'old', new):
            faults.append('half a file was left behind')
    return faults


def limit_files() -> None:
    """Files of this process may have 64 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))


def a_day(hours: float) -> Outcome:
    """`hours` of recorded time in lockstep as fast as the nodes follow: memory stays flat."""
    out = Outcome(put_in=1)
    rate, cycle = 10.0, 40.0
    truth = Truth.make(rate, cycle)
    cycles = round(hours * 3600.0 / cycle)
    with tempfile.TemporaryDirectory() as name:
        bag, start = cycle_bag(Path(name), truth, cycles, rate)
        parameters = {'replay_clock': {'window': 1.0},
                      'ring_simulator': {'max_step': 0.05, 'bag': str(bag)}}
        with start_nodes(bag, parameters=parameters) as group:
            listener = Listener(group.domain_id)
            sizes: dict[str, list[int]] = {node: [] for node in group.processes}
            began = time.monotonic()
            newest = 0
            while group.processes['replay_clock'].running:
                time.sleep(1.0)
                with listener.lock:
                    for items in listener.heard.values():
                        if items:
                            newest = max(newest, int(items[-1].batch.stamps[-1]))
                        items.clear()
                    listener.said.clear()
                for node, process in group.processes.items():
                    if process.running:
                        sizes[node].append(resident(process.process.pid))
            listener.close()
            took = time.monotonic() - began
            status = group.processes['replay_clock'].process.returncode
    if status:
        out.faults.append(f'the replay ended with status {status}')
    seen = (newest - start) / 3.6e12
    if seen < 0.999 * hours - 0.01:
        out.faults.append(f'{seen:.2f} of {hours:g} h came through')
    for node, series in sizes.items():
        settled = series[len(series) // 5:]
        growth = (np.mean(settled[-5:]) - np.mean(settled[:5])) / 1e6 if len(settled) > 9 else 0.0
        out.figures[f'growth of {node} [MB]'] = float(growth)
        if growth > 8.0:
            out.faults.append(f'{node} grew by {growth:.1f} MB')
    out.figures['hours'], out.figures['times real time'] = hours, hours * 3600.0 / took
    return out


# --- processes ---

def resident(pid: int) -> int:
    """Memory of a process [bytes]."""
    with contextlib.suppress(OSError, IndexError):
        return int(Path(f'/proc/{pid}/statm').read_text().split()[1]) * os.sysconf('SC_PAGE_SIZE')
    return 0


def children_of(pid: int) -> list[int]:
    with contextlib.suppress(OSError):
        return [int(word) for task in Path(f'/proc/{pid}/task').iterdir()
                for word in (task / 'children').read_text().split()]
    return []


def lives(pid: int) -> bool:
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


def marked() -> list[str]:
    """Processes that carry this campaign's mark, but this one."""
    mark = f'{MARK}={os.environ[MARK]}'.encode()
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        with contextlib.suppress(OSError):
            if int(folder.name) != os.getpid() and mark in (folder / 'environ').read_bytes():
                found.append((folder / 'cmdline').read_bytes().replace(b'\0', b' ').decode())
    return found


def clean() -> list[str]:
    """What is left over: processes; files of dead processes that a start does not remove."""
    from saddlering_ros.ros.shared_memory import sweep
    deadline = time.monotonic() + 5.0
    while marked() and time.monotonic() < deadline:
        time.sleep(0.1)
    faults = [f'still running: {line}' for line in marked()]
    time.sleep(2.1)  # younger files may belong to a process that has not locked them yet
    sweep()
    if sweep():
        faults.append('files of dead processes come back in /dev/shm')
    return faults


# --- the campaign ---

def beside_a_driver(chance: random.Random, rounds: int, only: set[str]) -> Outcome:
    """All faults that need a driver and the ring nodes, on one stage."""
    out = Outcome()
    took = []

    def kills(one: Stage) -> None:
        for name in OUTPUTS:
            took.append(kill_and_restart(one, name))

    def stops(one: Stage) -> None:
        stop_a_node(one, chance.choice(list(OUTPUTS)))

    scenarios: dict[str, Callable[[Stage], None]] = {
        'kills': kills, 'stops': stops, 'late': join_late, 'stalled': stall_a_subscriber,
        'rubbish': send_rubbish, 'slow_log': slow_disk, 'full_log': full_log_disk,
        'ten_times': ten_times}
    with stage(chance) as one:
        for _ in range(rounds):
            for name, scenario in scenarios.items():
                if only and name not in only:
                    continue
                before = len(one.faults)
                scenario(one)
                one.faults[before:] = [f'{name}: {fault}' for fault in one.faults[before:]]
                verdict = 'ok' if len(one.faults) == before else 'BROKEN'
                print('\n    '.join([f'  {name:12} {verdict}', *one.faults[before:]]), flush=True)
        out.put_in, out.faults = one.put_in, one.faults
    if took:
        out.figures['slowest in step or said so after [s]'] = max(took)
    return out


DRIVEN = ('kills', 'stops', 'late', 'stalled', 'rubbish', 'slow_log', 'full_log', 'ten_times')


def campaign(rounds: int, seed: int, hours: float, only: set[str]) -> dict[str, Outcome]:
    """Every scenario; what came of it by name."""
    chance = random.Random(seed)
    scenarios: dict[str, Callable[[], Outcome]] = {
        'driver': lambda: beside_a_driver(chance, rounds, only),
        'replay': lambda: lose_replay_nodes(chance),
        'two_replays': lambda: two_replays(chance),
        'servers': lambda: kill_action_servers(chance),
        'full_disk': lambda: full_disk(chance),
        'day': lambda: a_day(hours),
    }
    outcomes = {}
    for name, scenario in scenarios.items():
        if only and name not in only and not (name == 'driver' and only & set(DRIVEN)):
            continue
        print(name, flush=True)
        outcome = scenario()
        outcome.faults += clean()
        outcomes[name] = outcome
        for what, value in outcome.figures.items():
            print(f'  {what:44} {value:10.2f}', flush=True)
        for fault in outcome.faults:
            print(f'  BROKEN: {fault}', flush=True)
    return outcomes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--rounds', type=int, default=3, help='of the faults beside a driver')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--hours', type=float, default=24.0, help='of recorded time in one replay')
    parser.add_argument('--only', nargs='+', default=[], metavar='NAME')
    parser.add_argument('--quick', action='store_true', help='one round, a quarter of an hour')
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    if args.quick:
        args.rounds, args.hours = 1, 0.25
    os.environ[MARK] = str(os.getpid())
    outcomes = campaign(args.rounds, args.seed, args.hours, set(args.only))
    put_in = sum(outcome.put_in for outcome in outcomes.values())
    broken = sum(len(outcome.faults) for outcome in outcomes.values())
    print(f'\n{put_in} faults put in, {broken} promises broken')
    if args.json:
        figures = {name: vars(outcome) for name, outcome in outcomes.items()}
        args.json.write_text(json.dumps(figures, indent=2) + '\n')
    return 1 if broken else 0


if __name__ == '__main__':
    if sys.argv[1:3] == ['--role', 'driver']:
        driver_role()
    else:
        sys.exit(main())
