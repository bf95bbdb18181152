"""What do bags cost: readers side by side, and commands on bags of growing length?

    python benchmarks/reading.py [--minutes 1 5] [--rate 10000] [--commands identify report]

Each bag is written block by block: ramps of 10 s. Each reader and each command runs in a process
of its own. Readers that decode must find the same checksum of stamps and readings. Resident
memory includes pages of scratch files, which the system can take back; anonymous memory does not.
"""

from collections.abc import Iterable
import importlib
from pathlib import Path
import sys
import tempfile
import time
from typing import Any

from frame import arguments, run, table
import numpy as np
from rigs import RIG

from saddlering_ros.rig import Displacement, TRUE_TO_SCALE
from saddlering_ros.rig.geometry import displacement_to_probes
from saddlering_ros.ring.simulator import static_response

EPOCH = 1_700_000_000_000_000_000
BLOCK = 1 << 18
REST, RAMPS = 1.0, 20.0
"""Time [s] at preload at the beginning, and of a ramp up and down."""

COMMANDS: dict[str, tuple[str, ...]] = {
    'info': ('{bag}',),
    'displacement': ('{bag}', '--out', '{out}.parquet'),
    'identify': ('{bag}', '--out', '{out}.yaml'),
    'simulate': ('{bag}', '--params', '{out}.yaml'),
    'residual': ('{bag}', '--params', '{out}.yaml', '--out', '{out}.parquet'),
    'validate': ('{bag}', '--params', '{out}.yaml'),
    'report': ('{bag}', '--params', '{out}.yaml', '--out', '{out}.html'),
    'watch': ('{bag}', '--params', '{out}.yaml'),
    'rig': ('--check', '{bag}'),
    'diagnose': ('{bag}',)}


# -- readers: each returns the checksum of what it decoded, or nothing ----------------------------


def by_numpy(bag: Path) -> str:
    from saddlering_ros.bags.reader import read_raw

    topics = read_raw(bag).topics.values()
    return checksum(sum(int((topic.stamps - EPOCH).sum()) for topic in topics),
                    sum(float(topic.values.sum()) for topic in topics))


def by_numpy_run(bag: Path) -> None:
    from saddlering_ros.bags.reader import read_run

    assert read_run(bag).time.size


def by_rosbags(bag: Path) -> str:
    from rosbags.highlevel import AnyReader

    with AnyReader([bag]) as reader:
        return sums(reader.deserialize(data, connection.msgtype)
                    for connection, _, data in reader.messages())


def by_mcap(bag: Path) -> str:
    from mcap.reader import make_reader
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    with next(bag.glob('*.mcap')).open('rb') as file:
        return sums(store.deserialize_cdr(message.data, schema.name)
                    for schema, _, message in make_reader(file).iter_messages())


def sums(messages: Iterable[Any]) -> str:
    stamps, values = 0, 0.0
    for message in messages:
        stamp = message.header.stamp
        stamps += stamp.sec * 10**9 + stamp.nanosec - EPOCH
        values += message.range if hasattr(message, 'range') else message.wrench.force.x
    return checksum(stamps, values)


def checksum(stamps: int, values: float) -> str:
    return f'{stamps}:{values:.9g}'


READERS = {
    'saddlering_ros.bags.reader.read_raw': by_numpy,
    'saddlering_ros.bags.reader.read_run, checked and aligned': by_numpy_run,
    'rosbags': by_rosbags, 'mcap, decoded by rosbags': by_mcap}


def read_by(reader: str, bag: Path) -> None:
    """Print the processor seconds of a reader and its checksum."""
    for module in ('saddlering_ros.bags.reader', 'mcap.reader', 'rosbags.highlevel'):
        importlib.import_module(module)
    began = time.process_time()
    total = READERS[reader](bag)
    print(time.process_time() - began, total)


# -- bags -----------------------------------------------------------------------------------------


def write(bag: Path, count: int, rate: float) -> None:
    """A bag of `count` messages of each topic."""
    from saddlering_ros.bags.write import BagWriter, messages_of
    from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, TOPICS

    span = (RIG.probes.min_range, RIG.probes.max_range)
    topics = {name: TOPICS[name].type for name in (LOAD_TOPIC, *PROBE_TOPICS)}
    random = np.random.default_rng(0)
    loads, readings = at_rest()
    with BagWriter(bag, topics, {'test': 'dynamic', 'elevation_deg': '50'}) as writer:
        for start in range(0, count, BLOCK):
            time_of = np.arange(start, min(start + BLOCK, count)) / rate
            load = RIG.preload + 0.9 * RIG.full_scale_load * share_of_range(time_of, count / rate)
            load += random.normal(0.0, 50.0, load.size)
            stamps = EPOCH + np.rint(1e9 * time_of).astype(np.int64)
            blocks = [messages_of(TOPICS[LOAD_TOPIC], stamps, load)]
            for number, moved in enumerate(readings):
                gaps = 1e-3 + RIG.probes.polarity[number] * np.interp(load, loads, moved)
                gaps += random.normal(0.0, 3e-7, load.size)
                blocks.append(messages_of(TOPICS[PROBE_TOPICS[number]],
                                          stamps + 1000 * (number + 1), gaps, span))
            writer.write(blocks)


def at_rest() -> tuple[np.ndarray, np.ndarray]:
    """Loads (N,) [N], and how far the faces of the probes (4, N) [m] stand at rest under them."""
    loads = np.linspace(0.5 * RIG.preload, RIG.full_scale_load, 200)
    x, y, tilt = static_response(RIG, TRUE_TO_SCALE.to_array(), np.radians(50.0), loads)
    return loads, displacement_to_probes(RIG.probes, Displacement(x, y, tilt, 0.0))


def share_of_range(time_of: np.ndarray, end: float) -> np.ndarray:
    """The load's share of its range; ramps that would not be over at `end` [s] do not begin."""
    later = np.maximum(time_of - REST, 0.0)
    share = 1.0 - np.abs(1.0 - (later % RAMPS) / (0.5 * RAMPS))
    return np.where(later < RAMPS * ((end - 2.0) // RAMPS), share, 0.0)


def main() -> int:
    args = arguments(__doc__, {'minutes': [0.5], 'rate': 2e3}, minutes=(1.0, 5.0), rate=1e4,
                     commands=tuple(COMMANDS), read_by=str, bag=Path)
    if args.read_by:
        read_by(args.read_by, args.bag)
        return 0
    decoded: set[str] = set()
    with tempfile.TemporaryDirectory(prefix='saddlering-bench-') as folder:
        for minutes in args.minutes:
            bag, count = Path(folder) / f'{minutes:g}', int(60.0 * minutes * args.rate)
            write(bag, count, args.rate)
            size = sum(file.stat().st_size for file in bag.iterdir()) / 1e6
            rows: list[tuple[object, ...]] = []
            for reader in READERS:
                found = run([__file__, '--read-by', reader, '--bag', str(bag)])
                seconds, total = found.said.split()
                rows.append((reader, f'{5 * count / float(seconds):,.0f}', float(seconds),
                             found.peak))
                decoded |= {total} - {'None'}
            table(f'{minutes:g} minutes: {5 * count} messages, {size:.0f} MB',
                  ('reader', 'messages/s', 'processor [s]', 'peak [MB]'), rows)
            rows = []
            for name in args.commands:
                words = [word.format(bag=bag, out=Path(folder) / 'out') for word in COMMANDS[name]]
                found = run(['-m', 'saddlering_ros.cli.main', name, *words])
                rows.append((name, found.peak, found.anonymous, found.processor, found.passed))
            table(f'commands on {minutes:g} minutes',
                  ('command', 'peak [MB]', 'anonymous [MB]', 'processor [s]', 'clock [s]'), rows)
    is_one = len(decoded) == len(args.minutes)
    print('\nall readers that decode agree' if is_one else f'\nREADERS DISAGREE: {decoded}')
    return 0 if is_one else 1


if __name__ == '__main__':
    sys.exit(main())
