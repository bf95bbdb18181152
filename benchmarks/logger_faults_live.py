"""Logger faults through the stream that the live displacement node runs: what it reports of them.

    python benchmarks/logger_faults_live.py [--rounds N]

A ramp with a fault arrives in batches of 20 samples, in order of arrival. Of the rows that come
out without a mark, delta_x, delta_y and gamma are compared with those of the sound ramp at the
same stamps. A severity is silent if their rms change exceeds 4 standard deviations of a reading's
noise and nothing was marked, refused, restarted or missing.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from logger_faults import Fault, FAULTS, raw_record, severities, Topics
import numpy as np

from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.record.guard import Samples
from saddlering_ros.rig import default_rig
from saddlering_ros.streams.displacement import DisplacementStream

BATCH = 20


@dataclass(frozen=True)
class Published:
    """Rows without a mark: stamps (N,) and channels (3, N); marked: how many others; counts."""

    stamps: np.ndarray
    channels: np.ndarray
    marked: int
    counts: dict[str, int]


def published(topics: Topics, expected: int) -> Published:
    """What comes out of the stream; `expected`: rows of the sound record."""
    stream = DisplacementStream(default_rig())
    found = []
    for start in range(0, max(map(len, topics.values())), BATCH):
        part = slice(start, start + BATCH)
        load, *gaps = (Samples(topics[name].stamps[part], topics[name].values[part])
                       for name in (LOAD_TOPIC, *PROBE_TOPICS))
        found.append(stream.push(load, gaps))
    found.append(stream.flush())
    stamps = np.concatenate([one.stamps for one in found])
    channels = np.concatenate([one.channels[:3] for one in found], axis=1)
    sound = np.concatenate([one.validity for one in found]) == 0
    counts = {**stream.counters.as_dict(), **stream.aligner.counters.as_dict()}
    counts['at a limit of the span'] = sum(
        int(np.count_nonzero((topics[name].values <= topics[name].min_range)
                             | (topics[name].values >= topics[name].max_range)))
        for name in PROBE_TOPICS)  # as the node's diagnostics count them
    counts['rows missing'] = max(0, round(0.99 * expected) - len(stamps))
    return Published(stamps[sound], channels[:, sound], int((~sound).sum()),
                     {name: count for name, count in counts.items() if count})


def line_of(name: str, fault: Fault, severity: float, sound: Published, topics: Topics) -> str:
    """One row of the table."""
    seen = published(fault.act(topics, severity), len(sound.stamps))
    _, here, there = np.intersect1d(sound.stamps, seen.stamps, return_indices=True)
    noise = np.std(np.diff(sound.channels[:, :400], 2, axis=1), axis=1) / np.sqrt(6.0)
    change = np.sqrt(np.mean((seen.channels[:, there] - sound.channels[:, here]) ** 2, axis=1)) \
        if here.size else np.zeros(3)
    move = float((change / (4.0 * noise)).max())
    new = {key: count for key, count in seen.counts.items()
           if count > sound.counts.get(key, 0) + 2}
    words = ', '.join(f'{count} {key.replace("_", " ")}' for key, count in new.items())
    if seen.marked > sound.marked:
        words = f'{seen.marked} rows marked' + (f', {words}' if words else '')
    silent = 'SILENT' if move > 1.0 and not words else ''
    return f'| {name} | {severity:.3g} {fault.unit} | {move:.2f} | {words} | {silent} |'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--rounds', type=int, default=2)
    args = parser.parse_args()
    topics = raw_record('dynamic').topics
    sound = published(topics, 0)
    print('| fault | severity | rms change over 4 deviations of noise | reported live | |')
    print('|---|---|---|---|---|')
    for name, fault in FAULTS.items():
        for severity in severities(fault, args.rounds):
            print(line_of(name, fault, severity, sound, topics), flush=True)


if __name__ == '__main__':
    main()
