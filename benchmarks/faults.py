"""Do running nodes keep their promises when faults are put in; real processes, real DDS?

    python benchmarks/faults.py [--only NAME ...] [--rounds 3] [--seed 1]

A driver publishes the five raw topics of a ring whose true motion is known. One fault after the
other is put in at random moments: kills, stops, stalled, rubbish, ten_times. After each it is
asked:

- numbers: has a displacement, simulated displacement or residual gone out that differs from the
  truth by more than TOLERANCE, without a warning or error on /diagnostics within two seconds?
- others: do the processes that were left alone still run, and publish?
- back: is a node that was started again in step, or does it say what it waits for, within a second
  of its first sign of life?
- clean: does nothing of the ended processes in /dev/shm stay locked or break a next start?

Status 1 if a promise was broken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import os
import random
import signal
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from frame import arguments, ROOT
from geometry_msgs.msg import WrenchStamped
import numpy as np
import rclpy
from rclpy.serialization import deserialize_message
from rigs import RIG
from sensor_msgs.msg import Range
from served_node import ServedNode
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import ReplayProgress, RingDisplacement
from saddlering_ros.bags.wire import decode_displacements, encode_samples
from saddlering_ros.record.batches import Displacements, Samples
from saddlering_ros.record.topics import LOAD, LOAD_TOPIC, PROBE_TOPICS, PROBES
from saddlering_ros.rig import CHANNELS, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import simulate
from saddlering_ros.ros.launcher import NodeGroup, RING_NODES, sweep
from saddlering_ros.ros.names import PROGRESS
from saddlering_ros.ros.raw_topics import RawPublisher, RawSubscription, stream_qos

ELEVATION, RATE, CYCLE, REST = 50.0, 1000.0, 6.0, 1.2
"""Of the driver [deg, Hz, s]; it rests at preload at the beginning of a cycle, and 0.4 s at its
end."""

TOLERANCE = 2e-6
"""Of a published number [m, rad]; the truth is known to 0.1 of it."""

NOTICE = 2.0
"""A wrong number must be covered by a diagnostic within so many seconds before or after it."""

SETTLED_NS = round(0.5e9)
"""After its zero [ns] a simulation is in full swing."""

IN_STEP = 1.3
"""Of which 0.3 s are the time between two messages that say what a node waits for [s]."""

OUTPUTS = {'ring_displacement': '/ring/displacement',
           'ring_simulator': '/ring/simulated_displacement', 'ring_residual': '/ring/residual'}
PARAMETERS: dict[str, dict[str, object]] = {'ring_simulator': {'elevation_deg': ELEVATION}}
STALLED = """
import rclpy, sys, time
from saddlering_interfaces.msg import RingDisplacement
from geometry_msgs.msg import WrenchStamped
from saddlering_ros.ros.raw_topics import stream_qos
rclpy.init(); node = rclpy.create_node("stalled")
for topic, kind in (("/ring/displacement", RingDisplacement), ("/ring/residual", RingDisplacement),
                    ("/rig/hydraulic_load", WrenchStamped)):
    node.create_subscription(kind, topic, lambda m: None, stream_qos())
end = time.monotonic() + 2
while time.monotonic() < end: rclpy.spin_once(node, timeout_sec=0.1)
print("spun", flush=True); time.sleep(600)
"""
"""A process that subscribes to everything reliably."""


@dataclass(frozen=True)
class Truth:
    """One cycle of load that repeats for ever: load [N] (N,), gaps [m] (4, N), motion (4, N)."""

    load: np.ndarray
    gaps: np.ndarray
    motion: np.ndarray

    @classmethod
    def make(cls) -> Truth:
        """Rest, up to about 24 t and back; the second of two cycles, in full swing."""
        count = round(CYCLE * RATE)
        times = np.arange(2 * count) / RATE
        within = times % CYCLE
        near_an_end = np.minimum(within - REST, CYCLE - 0.4 - within)
        load = RIG.preload + 230e3 * np.clip(2.0 * near_an_end / (CYCLE - REST - 0.4), 0.0, 1.0)
        run = simulate(RIG, ParameterSet(TRUE_TO_SCALE), np.radians(ELEVATION), times, load)
        motion = np.stack([np.asarray(getattr(run.displacement, name)) for name in CHANNELS])
        gaps = 1e-3 + np.asarray(RIG.probes.polarity)[:, None] * run.probes
        return cls(load[-count:], np.float64(np.float32(gaps[:, -count:])), motion[:, -count:])

    def at(self, seconds: np.ndarray) -> np.ndarray:
        """Motion (4, N) since the rest of the first cycle, at times since it began."""
        place = (seconds * RATE) % self.load.size
        whole = np.arange(self.load.size + 1)
        still = self.motion[:, 400:1100].mean(axis=1, keepdims=True)
        return np.stack([np.interp(place, whole, np.append(row, row[0]))
                         for row in self.motion]) - still


def drive(speed: float) -> None:
    """Publish the truth's cycle at `speed` times the nominal rate until the parent ends.

    Prints the stamp [ns] at which the cycles begin.
    """
    truth = Truth.make()
    rclpy.init()
    node = rclpy.create_node('driver')
    flows = [RawPublisher(node, LOAD_TOPIC, WrenchStamped)]
    flows += [RawPublisher(node, topic, Range) for topic in PROBE_TOPICS]
    start, sent = time.time_ns() + 500_000_000, 0
    print(start, flush=True)
    while os.getppid() != 1:
        due = int((time.time_ns() - start) / 1e9 * RATE * speed)
        if due > sent:
            index = np.arange(sent, min(due, sent + 2000))
            stamps = start + np.round(index / (RATE * speed) * 1e9).astype(np.int64)
            place = np.round(index / speed).astype(int) % truth.load.size
            flows[0].send(encode_samples(Samples(stamps, truth.load[place]), LOAD),
                          int(stamps[-1]))
            for topic, gap, flow in zip(PROBES, truth.gaps, flows[1:], strict=True):
                samples = Samples(stamps, gap[place], RIG.probes.min_range, RIG.probes.max_range)
                flow.send(encode_samples(samples, topic), int(stamps[-1]))
            sent = int(index[-1]) + 1
        time.sleep(0.004)


class Listener(ServedNode):
    """A node of this process that keeps everything the ring nodes say, with its time [s].

    heard: batches of each topic and when they came; said: time, node, level and words of each
    diagnostic; alive: when a node gave its last sign of life.
    """

    def __init__(self, domain: int) -> None:
        super().__init__(domain, f'listener_{time.monotonic_ns()}')
        self.forget()
        self.alive: dict[str, float] = {}
        self._flows = {topic: RawSubscription(self.node, topic, RingDisplacement)
                       for topic in OUTPUTS.values()}
        self._progress = RawSubscription(self.node, PROGRESS, ReplayProgress)
        self._diagnostics = RawSubscription(self.node, '/diagnostics', DiagnosticArray)
        self.serve()

    def forget(self) -> None:
        """Forget what was heard."""
        self.heard: dict[str, list[tuple[float, Displacements]]] = {
            topic: [] for topic in OUTPUTS.values()}
        self.said: list[tuple[float, str, int, str]] = []

    def take(self) -> None:
        now = time.monotonic()
        for topic, flow in self._flows.items():
            messages = flow.take()
            if messages:
                self.heard[topic].append((now, decode_displacements(messages)))
        for message in self._progress.take():
            self.alive[deserialize_message(message, ReplayProgress).node] = now
        for message in self._diagnostics.take():
            for status in deserialize_message(message, DiagnosticArray).status:
                self.said.append((now, status.name, status.level[0], status.message))

    def since(self, topic: str, when: float) -> int:
        """How many samples came on a topic after `when`."""
        with self.lock:
            return sum(len(batch) for at, batch in self.heard[topic] if at > when)

    def warned(self, when: float, until: float) -> list[str]:
        """What was said above OK between two times."""
        with self.lock:
            return [f'{name}: {words}' for at, name, level, words in self.said
                    if when <= at <= until and 0 < level < 3]

    def zero(self) -> None:
        """Ask for a new zero; the waiting time is the test's own."""
        with self.lock:
            client = self.node.create_client(Trigger, '/ring_displacement/zero')
        end = time.monotonic() + 20.0
        while not client.service_is_ready() and time.monotonic() < end:
            time.sleep(0.02)
        with self.lock:
            client.call_async(Trigger.Request())


@dataclass
class Stage:
    """The three ring nodes, a driver, and a listener; start: stamp [ns] of the first cycle."""

    group: NodeGroup
    chance: random.Random
    truth: Truth = field(default_factory=Truth.make)
    faults: list[str] = field(default_factory=list)
    put_in: int = 0
    slowest: float = 0.0

    def __post_init__(self) -> None:
        assert self.group.domain_id is not None
        self.listener = Listener(self.group.domain_id)
        for name in RING_NODES:
            self.group.start(name, PARAMETERS.get(name))
        self.start_driver()
        self.in_flow(seconds=60.0)
        self.listener.forget()

    def start_driver(self, speed: float = 1.0) -> None:
        self.driver = subprocess.Popen(
            [sys.executable, __file__, '--drive', str(speed)], cwd=ROOT,
            env=self.group.environment, stdout=subprocess.PIPE, text=True)
        assert self.driver.stdout is not None
        self.start = int(self.driver.stdout.readline())

    def end_driver(self) -> None:
        self.driver.kill()
        self.driver.wait()

    def expect(self, condition: Callable[[], object], seconds: float, what: str) -> None:
        """Wait for a condition; a broken promise if it does not come true."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                words = sorted(set(self.listener.warned(end - 1.5, end)))
                self.faults.append(f'not within {seconds:g} s: {what} (said: {words})')
                return
            time.sleep(0.005)

    def others_run(self, *but: str) -> None:
        """Every process that was left alone still runs."""
        self.faults += [
            f'{name} ended with status {node.process.returncode}: {node.said()[-200:]}'
            for name, node in self.group.processes.items() if name not in but and not node.running]

    def in_flow(self, *names: str, seconds: float = 20.0) -> None:
        """The named nodes publish (again)."""
        now = time.monotonic()
        for name in names or tuple(OUTPUTS):
            self.expect(lambda name=name: self.listener.since(OUTPUTS[name], now), seconds,
                        f'{name} publishes')

    def numbers(self, tolerance: float = TOLERANCE) -> None:
        """Compare all that was heard with the truth, and forget it."""
        time.sleep(1.2)  # the diagnostics of the last second
        for topic, batches in list(self.listener.heard.items()):
            for arrived, batch in list(batches):
                expected = self.truth.at((batch.stamps - self.start) / 1e9)
                if topic == '/ring/residual':
                    expected[:] = 0.0
                error = np.abs(batch.channels - expected).max(axis=0)
                # The zero is taken for rest; a ring still coming to rest differs until it is.
                error[batch.stamps < batch.zero_stamps + SETTLED_NS] = 0.0
                worst = float(error.max(initial=0.0))
                if not worst <= tolerance and not self.listener.warned(
                        arrived - NOTICE, arrived + NOTICE):
                    self.faults.append(f'{topic}: off by {worst * 1e6:.1f} um, nothing said')
        with self.listener.lock:
            self.listener.forget()

    def zero_together(self) -> None:
        """A node that zeroed anew alone is said not to fit the other; one call puts that right."""
        began = time.monotonic()
        self.expect(lambda: self.listener.since('/ring/residual', began) > 0 or any(
            words.startswith('ring_residual') for words in self.listener.warned(
                began, time.monotonic())), 3.0, 'residual, or a word about why there is none')
        for _ in range(5):
            if self.listener.since('/ring/residual', time.monotonic() - 0.3):
                return
            while not 0.2 < (time.time_ns() - self.start) / 1e9 % CYCLE < 0.5:
                time.sleep(0.02)  # at preload, as someone who knows the test would
            self.listener.zero()
            time.sleep(1.5)
        self.in_flow('ring_residual', seconds=2.0)

    def pause(self) -> None:
        """A random part of a cycle."""
        time.sleep(self.chance.uniform(0.1, CYCLE))


def kills(one: Stage) -> None:
    """Kill each node at a random moment and start it again; it is in step or says why."""
    for name, topic in OUTPUTS.items():
        one.put_in += 1
        one.pause()
        killed = time.monotonic()
        one.group.processes[name].process.kill()
        one.group.processes[name].process.wait()
        time.sleep(0.3)
        others = [other for other in OUTPUTS if other not in (name, 'ring_residual')]
        one.in_flow(*others, seconds=6.0)  # at most the rest of a cycle, should it wait
        one.others_run(name)
        one.listener.alive.pop(name, None)
        one.group.start(name, PARAMETERS.get(name))
        one.expect(lambda name=name, killed=killed: one.listener.alive.get(name, 0.0) > killed,
                   30.0, f'{name} lives')
        alive = one.listener.alive.get(name, time.monotonic())
        one.expect(lambda name=name, topic=topic, alive=alive: one.listener.since(
            topic, alive) or any(
                at > alive - 1.0 and said.startswith(name) and (level > 0 or 'waiting' in words)
                for at, said, level, words in list(one.listener.said)),
            IN_STEP, f'{name} in step, or says what it waits for')
        one.slowest = max(one.slowest, time.monotonic() - alive)
        if name != 'ring_residual':
            one.in_flow(name, seconds=2.5 * CYCLE)
        one.zero_together()
        one.numbers()


def stops(one: Stage) -> None:
    """A node stands still for three seconds, as on a machine that has something else to do."""
    one.put_in += 1
    one.pause()
    process = one.group.processes[one.chance.choice(list(OUTPUTS))].process
    process.send_signal(signal.SIGSTOP)
    time.sleep(3.0)
    one.others_run()
    process.send_signal(signal.SIGCONT)
    one.in_flow(seconds=2.5 * CYCLE)
    one.numbers()


def stalled(one: Stage) -> None:
    """A process that subscribes to everything reliably, and then stands still."""
    one.put_in += 1
    reader = subprocess.Popen([sys.executable, '-c', STALLED], env=one.group.environment,
                              stdout=subprocess.PIPE, text=True)
    assert reader.stdout is not None
    try:
        reader.stdout.readline()
        reader.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        time.sleep(8.0)
        count = one.listener.since('/ring/displacement', began)
        if count < 0.9 * 8.0 * RATE:
            one.faults.append(f'beside a stalled subscriber {count} of {8 * RATE:.0f} came')
        one.others_run()
        one.numbers()
    finally:
        reader.kill()
        reader.wait()


def rubbish(one: Stage) -> None:
    """NaN, infinite, absurd readings, stamps of far past and future, from a second source."""
    one.put_in += 1
    with one.listener.lock:
        load = RawPublisher(one.listener.node, LOAD_TOPIC, WrenchStamped, stream_qos())
        probe = RawPublisher(one.listener.node, PROBE_TOPICS[0], Range, stream_qos())
    one.expect(lambda: load.subscriptions() >= 2, 5.0, 'the second source is matched')
    now = time.time_ns()
    stamps = np.array([now, now + 1, 0, 1, now - 10 ** 12, now + 10 ** 12,
                       2 ** 31 * 10 ** 9 - 1], np.int64)
    for value in (np.nan, np.inf, -np.inf, 1e38, -1e38, 0.0):
        samples = Samples(stamps, np.full(len(stamps), value), np.nan, np.inf)
        with np.errstate(all='ignore'):
            load.send(encode_samples(samples, LOAD, 'x' * 1000), now)
            probe.send(encode_samples(samples, PROBES[0], ''), now)
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
    one.end_driver()
    time.sleep(1.0)
    one.numbers()
    one.start_driver(10.0)
    began = time.monotonic()
    one.in_flow('ring_displacement', seconds=30.0)
    time.sleep(max(0.0, began + 10.0 - time.monotonic()))
    one.others_run()
    one.end_driver()
    time.sleep(2.0)
    # Between two samples of one cycle the driver repeats the former ten times.
    one.numbers(5.0 * TOLERANCE)
    one.start_driver()
    one.in_flow(seconds=5.0 * CYCLE)
    one.numbers()


FAULTS = (kills, stops, stalled, rubbish, ten_times)


def main() -> int:
    args = arguments(__doc__, {'rounds': 1}, only=(), rounds=3, seed=1, drive=float)
    if args.drive:
        drive(args.drive)
        return 0
    with NodeGroup() as group:
        one = Stage(group, random.Random(args.seed))
        try:
            for fault in args.rounds * FAULTS:
                if args.only and fault.__name__ not in args.only:
                    continue
                before = len(one.faults)
                fault(one)
                broken = one.faults[before:]
                print('\n  BROKEN: '.join([f'{fault.__name__}: {len(broken)} promises broken',
                                           *broken]), flush=True)
        finally:
            one.end_driver()
            one.listener.close()
    time.sleep(2.1)  # younger files may belong to a process that has not locked them yet
    sweep()
    if sweep():
        one.faults.append('files of dead processes come back in /dev/shm')
    print(f'{one.put_in} faults put in, {len(one.faults)} promises broken; slowest in step or '
          f'said so after {one.slowest:.2f} s')
    return 1 if one.faults else 0


if __name__ == '__main__':
    sys.exit(main())
