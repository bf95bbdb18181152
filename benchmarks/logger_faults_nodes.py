"""Logger faults through real node processes: do they publish what the command computes offline?

    python benchmarks/logger_faults_nodes.py [--only NAME ...] [--rounds N]

For each fault `ring_displacement` runs as a process of its own. The ramp with the fault is
published over ROS, in order of arrival. Its messages are
compared with the rows that `saddlering displacement` gives for the same record: stamps, channels
and marks (`validity`). The node publishes nothing before its zero, where it reports that it waits
for the preload; rows of the command before that zero are counted apart. A difference without a
word in the node's diagnostics is silent. Where the command refuses the record, diagnostics must
hold a warning.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
import os
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from logger_faults import as_stored, Fault, FAULTS, raw_record, severities, Topics
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Range
from served_node import ServedNode

from saddlering_interfaces.msg import ReplayProgress, RingDisplacement
from saddlering_ros.bags.reader import run_of_record
from saddlering_ros.bags.samples import DisplacementSamples, measured_samples
from saddlering_ros.errors import SaddleringError
from saddlering_ros.record import displacement_of_run, LOAD_TOPIC, PROBE_TOPICS, RawRecord
from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.rig import CHANNELS, default_rig
from saddlering_ros.ros.launcher import NodeGroup
from saddlering_ros.ros.names import PROGRESS
from saddlering_ros.ros.raw_topics import RawPublisher, RawSubscription
from saddlering_ros.streams import batches

BATCH = 20
AHEAD = 500
"""Samples that are sent ahead of what the node has published, if it publishes."""
MAX_DELAY = 0.5
OUTPUT = '/ring/displacement'
STILL_SECONDS, PATIENCE = 10.0, 60.0
"""Silence after which no further message is waited for; longest start of the node."""

AT_END = 10
"""Rows at the end of a record that wait for later samples, which do not come."""

USUAL = 'waiting for preload'
"""A node reports this at the beginning of a sound record too."""

REPORT_SECONDS = 1.2
"""Diagnostics come once a second."""


class Bench(ServedNode):
    """Publishes a record in place of the drivers, and keeps what the node publishes."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, 'logger')
        self.inputs = [RawPublisher(self.node, LOAD_TOPIC, WrenchStamped)]
        self.inputs += [RawPublisher(self.node, topic, Range) for topic in PROBE_TOPICS]
        self._output = RawSubscription(self.node, OUTPUT, RingDisplacement)
        self._diagnostics = RawSubscription(self.node, '/diagnostics', DiagnosticArray)
        self._progress = RawSubscription(self.node, PROGRESS, ReplayProgress)
        self._publishers: list[int] = []
        self.heard: list[batches.Displacements] = []
        self.last = time.monotonic()
        self.words: set[str] = set()
        self.serve()

    def take(self) -> None:
        messages = self._output.take()
        if messages:
            self.heard.append(batches.decode_displacements(messages))
            self.last = time.monotonic()
        for message in self._progress.take():
            self._publishers = list(deserialize_message(message, ReplayProgress).publishers)
        for message in self._diagnostics.take():
            for status in deserialize_message(message, DiagnosticArray).status:
                if 0 < status.level[0] < 3 and not status.message.startswith(USUAL):
                    self.words.add(status.message)

    def send(self, topics: Topics) -> None:
        """Publish a record, all topics by the same part of it."""
        count = max(map(len, topics.values()))
        for start in range(0, count, BATCH):
            part = slice(start, start + BATCH)
            with self.lock:
                for flow, name, kind in zip(self.inputs, (LOAD_TOPIC, *PROBE_TOPICS),
                                            (LOAD, *PROBES), strict=True):
                    topic = topics[name]
                    samples = batches.Samples(topic.stamps[part], topic.values[part],
                                              topic.min_range, topic.max_range)
                    if len(samples):
                        flow.send(batches.encode_samples(samples, kind), int(samples.stamps[-1]))
            self._let_it_follow(int(topics[LOAD_TOPIC].stamps[max(0, start - AHEAD):][0]))

    def _let_it_follow(self, stamp: int) -> None:
        """Wait a little, and for a while longer until the node has published up to `stamp`."""
        end = time.monotonic() + MAX_DELAY
        time.sleep(1e-3 * BATCH)  # as a driver at 1 kHz sends them
        while time.monotonic() < end and self.heard and self.heard[-1].stamps[-1] < stamp:
            time.sleep(5e-3)

    def wait(self) -> None:
        """Until all know of each other: the node of our writers, and we of its readers."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            with self.lock:
                if (self._output.publishers() and self._publishers and all(self._publishers)
                        and all(flow.subscriptions() for flow in self.inputs)):
                    return
            time.sleep(0.05)
        raise SystemExit('ring_displacement does not start')

    def published(self, stamp: int) -> batches.Displacements:
        """All messages: up to a stamp [ns], or until none has come for a while."""
        while time.monotonic() - self.last < STILL_SECONDS:
            if self.heard and self.heard[-1].stamps[-1] >= stamp:
                break
            time.sleep(0.05)
        time.sleep(REPORT_SECONDS)
        with self.lock:
            return batches.join(self.heard) if self.heard else batches.no_displacements()


@dataclass(frozen=True)
class Compared:
    """Messages of the node, rows of the command, early ones before the zero, other differences."""

    live: int
    offline: int
    early: int
    differ: int
    marked: int
    words: tuple[str, ...]
    refused: str = ''

    @property
    def is_silent(self) -> bool:
        if self.refused:
            return not self.words
        return self.differ > AT_END and not self.words


def as_sent(topics: Topics) -> Topics:
    """Readings of the probes as a Range message carries them."""
    return {name: topic if name == LOAD_TOPIC else replace(
        topic, values=topic.values.astype(np.float32).astype(np.float64))
        for name, topic in topics.items()}


def of_nodes(topics: Topics) -> tuple[batches.Displacements, tuple[str, ...]]:
    """What a process of ring_displacement makes of a record, and its warnings."""
    with NodeGroup() as group:
        assert group.domain_id is not None
        os.environ.update(group.environment)  # the same transport for both ends
        bench = Bench(group.domain_id)
        try:
            group.start('ring_displacement')
            bench.wait()
            bench.words.clear()
            bench.send(topics)
            bench.last = time.monotonic()
            found = bench.published(int(topics[LOAD_TOPIC].stamps[-AT_END]))
            return found, tuple(sorted(bench.words))
        finally:
            bench.close()


def of_command(record: RawRecord, topics: Topics) -> DisplacementSamples:
    """What `saddlering displacement` makes of it."""
    stored = replace(record, topics={name: as_stored(topic) for name, topic in topics.items()})
    rig = default_rig()
    return measured_samples(displacement_of_run(rig, run_of_record(stored, stored.facts, rig)))


def compared(record: RawRecord, topics: Topics) -> Compared:
    """Both on the same record."""
    live, words = of_nodes(topics)
    marked = int(np.count_nonzero(live.validity))
    try:
        offline = of_command(record, topics)
    except SaddleringError as refusal:
        return Compared(len(live), 0, 0, 0, marked, words, str(refusal).partition(': ')[2])
    _, here, there = np.intersect1d(live.stamps, offline.stamps, return_indices=True)
    channels = np.stack([np.asarray(getattr(offline.displacement, name)) for name in CHANNELS])
    same = (np.isclose(live.channels[:, here], channels[:, there], rtol=0.0, atol=1e-15,
                       equal_nan=True).all(axis=0)
            & (live.validity[here] == offline.validity[there]))
    early = int(np.count_nonzero(offline.stamps < live.zero_stamps[0])) if len(live) else 0
    differ = max(len(live), len(offline) - early) - int(same.sum())
    return Compared(len(live), len(offline), early, differ, marked, words)


def line_of(name: str, fault: Fault, severity: float, found: Compared) -> str:
    """One row of the table."""
    words = found.refused and f'the command refuses: {found.refused[:60]}; node: '
    words += '; '.join(found.words)[:160]
    cells = (name, f'{severity:.3g} {fault.unit}', found.live, found.offline, found.early,
             found.differ, found.marked, words, 'SILENT' if found.is_silent else '')
    return f'| {" | ".join(map(str, cells))} |'


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--only', nargs='*')
    parser.add_argument('--rounds', type=int, default=1)
    args = parser.parse_args()
    record = raw_record('dynamic')
    print('| fault | severity | messages | rows | early | differ | marked | diagnostics | |')
    print('|---|---|---|---|---|---|---|---|---|')
    sound = Fault(lambda topics, severity: topics, 0.0, '')
    chosen = {'none': sound, **FAULTS}
    silent = 0
    for name, fault in chosen.items():
        if args.only and not any(word in name for word in args.only):
            continue
        for severity in severities(fault, args.rounds):
            found = compared(record, as_sent(fault.act(record.topics, severity)))
            silent += found.is_silent
            print(line_of(name, fault, severity, found), flush=True)
    return int(silent > 0)


if __name__ == '__main__':
    sys.exit(main())
