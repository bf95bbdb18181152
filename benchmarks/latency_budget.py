"""Where a sample waits on its way from the driver to its residual, hop by hop.

    python benchmarks/latency_budget.py [--seconds 8]                 the table of all rates
    python benchmarks/latency_budget.py --rate 500 [--rounds 1]       each stage of one rate
    chrt -r 10 python benchmarks/latency_budget.py                    as in the unit of systemd

One driver publishes to the ring nodes, and in another run to a plain rclpy node that does nothing
else. Every node notes when it takes a message and when it sends one, by stamp. With --rate the
plain node runs beside the ring nodes, and the time that the threads of each process were ready and
waited for a processor is read from the kernel. The table ends with ring/within_limits on a machine
that other programs keep busy, without and with real-time priority of the nodes.
"""

from __future__ import annotations

import argparse
import contextlib
from dataclasses import dataclass
import functools
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
import ros_load
from ros_load import listener, wait_matched
from std_msgs.msg import Bool

from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.ros.launcher import ALARM_NODES, NodeGroup, RING_NODES
from saddlering_ros.ros.names import WITHIN_LIMITS
from saddlering_ros.ros.raw_topics import DataWait, RawSubscription

TRACER = """
import sys
if any('saddlering_ros.nodes' in word for word in sys.orig_argv):
    import atexit, os, time
    from saddlering_ros.ros import raw_topics
    taken, sent = {}, {}
    take, send = raw_topics.RawSubscription.take, raw_topics.RawPublisher.send
    def traced_take(flow):
        messages = take(flow)
        if messages:
            taken.setdefault(flow.topic, []).append(
                (time.time_ns(), [message[4:12] for message in messages]))
        return messages
    def traced_send(flow, messages, last_stamp):
        send(flow, messages, last_stamp)
        if messages:
            sent.setdefault(flow.topic, []).append(
                (time.time_ns(), [message[4:12] for message in messages]))
    raw_topics.RawSubscription.take, raw_topics.RawPublisher.send = traced_take, traced_send
    def keep():
        import numpy as np
        arrays = {}
        for kind, flows in (('taken', taken), ('sent', sent)):
            for topic, batches in flows.items():
                raw = np.frombuffer(b''.join(b''.join(words) for _, words in batches), '<u4')
                stamps = raw[0::2].astype(np.int64) * 1_000_000_000 + raw[1::2]
                counts = [len(words) for _, words in batches]
                times = np.repeat(np.array([when for when, _ in batches], np.int64), counts)
                arrays[kind + topic] = np.stack([stamps, times])
        name = next(word for word in sys.orig_argv if 'saddlering_ros.nodes' in word)
        np.savez(os.path.join(os.environ['TRACES'], name.rpartition('.')[2]), **arrays)
    atexit.register(keep)
"""
SETTLED_NS = 1_500_000_000
"""Rows of the first 1.5 s wait for the zero and are left out."""

RATES = (200.0, 500.0, 1000.0)
BUSY_PROGRAMS = 20
PRIORITY = 10
HOPS = {
    'to displacement': ('driver: load published to taken by ring_displacement',
                        'ring_displacement: load to last probe of the stamp'),
    'displacement': ('ring_displacement: all inputs to displacement sent',),
    'to residual': ('displacement sent to taken by ring_residual',
                    'ring_residual: first input to second'),
    'residual': ('ring_residual: both inputs to residual sent',),
    'to listener': ('residual sent to taken by the listener',)}
"""Columns of the table, and the stages of each."""


@dataclass
class Threads:
    """Processor time and time spent ready without a processor [s], main thread and others."""

    own: np.ndarray
    others: np.ndarray

    @classmethod
    def of(cls, pid: int) -> Threads:
        """Of a process so far."""
        own, others = np.zeros(2), np.zeros(2)
        for task in Path(f'/proc/{pid}/task').iterdir():
            with contextlib.suppress(OSError):
                ran, waited, _ = map(int, (task / 'schedstat').read_text().split())
                (own if int(task.name) == pid else others)[:] += (ran / 1e9, waited / 1e9)
        return cls(own, others)

    def __sub__(self, other: Threads) -> Threads:
        return Threads(self.own - other.own, self.others - other.others)


def dropped_packets() -> int:
    """UDP packets that this machine dropped since its start because a socket's queue was full."""
    lines = [line.split() for line in Path('/proc/net/snmp').read_text().splitlines()
             if line.startswith('Udp:')]
    return int(dict(zip(*lines, strict=True))['RcvbufErrors'])


def traced(seconds: float, rate: float, *, alone: bool) -> dict[str, Any]:
    """One run: the budget by hop [ms], and each process's use of the processors."""
    command = [sys.executable, ros_load.__file__, '--seconds', str(seconds), '--rate', str(rate),
               '--role']
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / 'sitecustomize.py').write_text(TRACER)
        extra = {'PYTHONPATH': folder, 'TRACES': folder}
        kept = Path(folder) / 'published.npy'
        with (NodeGroup(extra_environment=extra) as group,
              listener(group.domain_id) as (node, residual, progress)):
            for name in RING_NODES:
                group.start(name)
            plain = None if alone else subprocess.Popen(
                [*command, 'plain'], env=group.environment, stdout=subprocess.PIPE, text=True,
                start_new_session=True)
            driver = subprocess.Popen([*command, 'drive', '--published', str(kept)],
                                      env=group.environment, stdin=subprocess.PIPE,
                                      stdout=subprocess.PIPE, text=True, start_new_session=True)
            assert driver.stdin is not None
            if plain is not None:
                assert plain.stdout is not None
                plain.stdout.readline()
            wait_matched(progress)
            progress.close()
            processes = {name: one.process.pid for name, one in group.processes.items()}
            processes |= {'driver': driver.pid, 'listener': os.getpid()}
            if plain is not None:
                processes['plain'] = plain.pid
            before = {name: Threads.of(pid) for name, pid in processes.items()}
            dropped, spent, began = dropped_packets(), ros_load.busy(), time.monotonic()
            driver.stdin.write('2 1 1 1 1\n' if alone else '3 2 2 2 2\n')
            driver.stdin.flush()
            stamps, arrivals = ros_load.receive(node, [residual], round(seconds * rate),
                                                seconds + 10)
            used = {name: Threads.of(pid) - before[name] for name, pid in processes.items()}
            dropped, spent = dropped_packets() - dropped, ros_load.busy() - spent
            took = time.monotonic() - began
            said = None
            if plain is not None:
                assert plain.stdout is not None
                said = json.loads(plain.stdout.readline())
                plain.wait()
            driver.wait()
        traces = {name: dict(np.load(Path(folder) / f'{name}.npz')) for name in RING_NODES}
        published = np.load(kept)
    found: dict[str, Any] = {'hops': hops(published, traces, stamps, arrivals), 'used': used,
                             'packets dropped': dropped, 'seconds': took,
                             'others': spent - sum(float((one.own + one.others)[0])
                                                   for one in used.values()),
                             'lost': round(seconds * rate) - len(stamps)}
    if said is not None:
        calls = ros_load.Calls(said)
        for name, when in (('callbacks of the plain node: load alone', calls.of_load),
                           ('callbacks of the plain node: all', calls.of_all),
                           ('callbacks of the plain node: last of a stamp', calls.complete)):
            found['hops'][name] = between(published, when, published[0, 0])
    return found


def hops(published: np.ndarray, traces: dict[str, dict[str, np.ndarray]], stamps: np.ndarray,
         arrivals: np.ndarray) -> dict[str, np.ndarray]:
    """Time from one stage to the next [ms] for each sample that passed both."""
    ring, simulator, residual = (traces[name] for name in RING_NODES)
    inputs = [ring['taken' + topic] for topic in (LOAD_TOPIC, *PROBE_TOPICS)]
    load = simulator['taken' + LOAD_TOPIC]
    measured = ring['sent/ring/displacement']
    simulated = simulator['sent/ring/simulated_displacement']
    came = [residual['taken/ring/displacement'], residual['taken/ring/simulated_displacement']]
    complete, both = together(inputs, np.max), together(came, np.max)
    sent, heard = residual['sent/ring/residual'], np.stack([stamps, arrivals])
    stages = {
        'driver: load published to taken by ring_displacement': (published, inputs[0]),
        'ring_displacement: load to last probe of the stamp': (inputs[0], complete),
        'ring_displacement: all inputs to displacement sent': (complete, measured),
        'displacement sent to taken by ring_residual': (measured, came[0]),
        'driver: load published to taken by ring_simulator': (published, load),
        'ring_simulator: load taken to state sent': (load, simulated),
        'state sent to taken by ring_residual': (simulated, came[1]),
        'ring_residual: first input to second': (together(came, np.min), both),
        'ring_residual: both inputs to residual sent': (both, sent),
        'residual sent to taken by the listener': (sent, heard),
        'all: load published to residual taken': (published, heard)}
    return {name: between(start, end, published[0, 0]) for name, (start, end) in stages.items()}


def together(flows: list[np.ndarray], choose: Any) -> np.ndarray:
    """Stamp, and the time at which the first or last of several messages of it was taken."""
    common = functools.reduce(np.intersect1d, [flow[0] for flow in flows])
    times = [flow[1][np.searchsorted(flow[0], common)] for flow in flows]
    return np.stack([common, choose(times, axis=0)])


def between(start: np.ndarray, end: np.ndarray, first: int) -> np.ndarray:
    """Time [ms] between two stages, each (2, N): stamps and times [ns]; start in order."""
    places = np.minimum(np.searchsorted(start[0], end[0]), start.shape[1] - 1)
    both = (start[0][places] == end[0]) & (end[0] > first + SETTLED_NS)
    return np.asarray((end[1] - start[1][places])[both] / 1e6)


def show(found: dict[str, Any]) -> None:
    """Print a run."""
    print(f'  {"hop":56} {"p50":>8} {"p90":>8} {"p99":>8} {"max":>8}  [ms]')
    for name, times in found['hops'].items():
        figures = ' '.join(f'{value:8.2f}' for value in np.percentile(times, (50, 90, 99, 100)))
        print(f'  {name:56} {figures}')
    print(f'  {"process":20} {"main: ran":>10} {"waited":>8} {"others: ran":>12} '
          f'{"waited":>8}  [s]')
    for name, used in found['used'].items():
        print(f'  {name:20} {used.own[0]:10.2f} {used.own[1]:8.2f} {used.others[0]:12.2f} '
              f'{used.others[1]:8.2f}')
    print(f'  residuals lost: {found["lost"]}, packets dropped: {found["packets dropped"]}; '
          f'kernel and other programs: {found["others"]:.2f} s of {found["seconds"]:.1f} s',
          flush=True)


def plain_alone(seconds: float, rate: float) -> np.ndarray:
    """Time [ms] from each load to the last of its five callbacks in a plain node, alone."""
    command = [sys.executable, ros_load.__file__, '--seconds', str(seconds), '--rate', str(rate),
               '--role']
    with tempfile.TemporaryDirectory() as folder, NodeGroup() as group:
        kept = Path(folder) / 'published.npy'
        plain = subprocess.Popen([*command, 'plain'], env=group.environment, text=True,
                                 stdout=subprocess.PIPE)
        assert plain.stdout is not None
        plain.stdout.readline()
        subprocess.run([*command, 'drive', '--published', str(kept)], env=group.environment,
                       input='1 1 1 1 1\n', text=True, stdout=subprocess.DEVNULL, check=True)
        calls = ros_load.Calls(json.loads(plain.stdout.readline()))
        plain.wait()
        published = np.load(kept)
    return between(published, calls.complete, published[0, 0])


def limits_while_busy(seconds: float, rate: float, policy: int) -> tuple[float, int, int]:
    """Longest silence [s] of ring/within_limits among busy programs; its messages, false ones.

    They count from the first true message to the last load. policy: of the scheduler, for nodes
    and driver.
    """
    os.sched_setscheduler(0, policy, os.sched_param(PRIORITY if policy else 0))
    with (tempfile.TemporaryDirectory() as folder, NodeGroup() as group,
          listener(group.domain_id) as (node, _, progress)):
        kept = Path(folder) / 'published.npy'
        command = [sys.executable, ros_load.__file__, '--seconds', str(seconds), '--rate',
                   str(rate), '--role', 'drive', '--published', str(kept)]
        for name in (*RING_NODES, *ALARM_NODES):
            group.start(name)
        limits = RawSubscription(node, WITHIN_LIMITS, Bool)
        heard: list[tuple[float, bool]] = []
        driver = subprocess.Popen(command, env=group.environment, stdin=subprocess.PIPE,
                                  stdout=subprocess.DEVNULL, text=True)
        assert driver.stdin is not None
        wait_matched(progress)
        busy = [subprocess.Popen([sys.executable, '-c', 'while True: pass'], preexec_fn=lambda:
                                 os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0)))
                for _ in range(BUSY_PROGRAMS)]
        try:
            driver.stdin.write('3 1 1 1 1\n')
            driver.stdin.flush()
            data, end = DataWait(node.context), time.monotonic() + seconds + 30.0
            while driver.poll() is None and time.monotonic() < end:
                data.wait([limits], 0.1)
                heard += [(time.time(), bool(message[4])) for message in limits.take()]
        finally:
            for one in busy:
                one.kill()
            driver.kill()
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        last = np.load(kept)[1, -1] / 1e9
    first = next((index for index, (_, within) in enumerate(heard) if within), 0)
    times = np.array([at for at, _ in heard[first:] if at <= last])
    within = [value for at, value in heard[first:] if at <= last]
    return float(np.diff(times).max(initial=0.0)), len(within), within.count(False)


def show_table(seconds: float) -> None:
    """Print the latency of all rates and the hops of each, and the limit on a busy machine."""
    print(f'load average {os.getloadavg()[0]:.1f}; p50 and p99 [ms]\n')
    print('| rate [Hz] | plain node | residual | p50 of: ' + ' | '.join(HOPS) + ' | lost |')
    print('|---' * (len(HOPS) + 4) + '|')
    for rate in RATES:
        plain, found = plain_alone(seconds, rate), traced(seconds, rate, alone=True)
        total = found['hops']['all: load published to residual taken']
        pairs = ['{:.2f} and {:.2f}'.format(*np.percentile(times, (50, 99)))
                 for times in (plain, total)]
        stages = [f'{sum(np.percentile(found["hops"][name], 50) for name in names):.2f}'
                  for names in HOPS.values()]
        print(f'| {rate:g} | ' + ' | '.join([*pairs, *stages, str(found['lost'])]) + ' |',
              flush=True)
    for policy, words in ((os.SCHED_OTHER, 'ordinary'), (os.SCHED_RR, 'real-time')):
        silence, count, lows = limits_while_busy(seconds, 200.0, policy)
        print(f'ring/within_limits beside {BUSY_PROGRAMS} busy programs, {words} priority: '
              f'silent for {silence:.2f} s at most, {lows} of {count} messages false', flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=8.0)
    parser.add_argument('--rate', type=float, help='of a topic [Hz]; none: the table')
    parser.add_argument('--rounds', type=int, default=1)
    parser.add_argument('--alone', action='store_true', help='without the plain node')
    args = parser.parse_args()
    if args.rate is None:
        show_table(args.seconds)
        return
    for number in range(args.rounds):
        print(f'round {number + 1}, {args.rate:g} Hz a topic, '
              f'{"no" if args.alone else "one"} plain node, '
              f'load average {os.getloadavg()[0]:.1f}')
        show(traced(args.seconds, args.rate, alone=args.alone))


if __name__ == '__main__':
    main()
