"""Ways to read a bag of about 100 MB, side by side: messages a second of CPU time, and memory.

    python benchmarks/bag_reading.py [--megabytes 100] [--compression zstd|lz4|none]

Every way runs in a process of its own and must return the same checksum of stamps and readings
as the others. `numpy` is what saddlering_ros.bags does; `numpy, no index` is the same on a file
whose message index was not written, so that chunks are walked record by record.
"""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path
import re
import subprocess
import sys
import tempfile
import time

import numpy as np

WAYS = {
    'numpy': 'saddlering_ros.bags: numpy view over raw CDR bytes',
    'numpy, no index': 'the same, records walked (file without message index)',
    'numpy, run': 'saddlering_ros.bags.read_run: checked and aligned too',
    'rosbags, raw': 'rosbags: messages, not decoded',
    'rosbags': 'rosbags: messages, decoded',
    'mcap, raw': 'mcap: messages, not decoded',
    'mcap + rosbags': 'mcap: messages, decoded by rosbags',
}
BYTES_PER_MESSAGE = 90.0
"""Mean size of an MCAP record of one of the rig's messages, five topics at one rate."""

EPOCH = 1_700_000_000_000_000_000


def main() -> int:
    """Write the bags, run every way on them, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--megabytes', type=float, default=100.0)
    parser.add_argument('--compression', choices=('zstd', 'lz4', 'none'), default='zstd')
    parser.add_argument('--way', choices=WAYS, help=argparse.SUPPRESS)
    parser.add_argument('--bag', type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.way:
        return report(args.way, args.bag)
    with tempfile.TemporaryDirectory(prefix='saddlering-bench-') as folder:
        count = int(args.megabytes * 1e6 / BYTES_PER_MESSAGE / 5)
        indexed, plain = Path(folder, 'indexed.mcap'), Path(folder, 'plain.mcap')
        write(indexed, count, args.compression, index=True)
        write(plain, count, args.compression, index=False)
        print(f'{5 * count} messages, {args.megabytes:g} MB of records, '
              f'{indexed.stat().st_size / 1e6:.1f} MB on disk ({args.compression})\n')
        print(f'{"way":<18}{"CPU s":>7}{"messages/s":>13}{"MB/s":>8}{"peak MB":>9}  what')
        sums = set()
        for way in WAYS:
            bag = plain if 'no index' in way else indexed
            answer = subprocess.run(
                [sys.executable, __file__, '--way', way, '--bag', str(bag)],
                check=True, capture_output=True, text=True).stdout.split()
            seconds, peak, total = float(answer[0]), float(answer[1]), answer[2]
            if total != '-':
                sums.add(total)
            print(f'{way:<18}{seconds:>7.2f}{5 * count / seconds:>13,.0f}'
                  f'{args.megabytes / seconds:>8.0f}{peak:>9.0f}  {WAYS[way]}')
        print('\nall ways that decode agree' if len(sums) == 1 else f'\nWAYS DISAGREE: {sums}')
        return 0 if len(sums) == 1 else 1


def report(way: str, bag: Path) -> int:
    """Run one way; print seconds, peak memory [MB] and the checksum."""
    reader = READERS[way]
    modules = ['saddlering_ros.bags'] if 'numpy' in way else ['mcap.reader', 'rosbags.highlevel']
    for module in modules:
        importlib.import_module(module)
    start = time.process_time()
    total = reader(bag)
    seconds = time.process_time() - start
    peak = re.search(r'VmHWM:\s+(\d+)', Path('/proc/self/status').read_text())
    print(seconds, int(peak[1]) / 1024, total)
    return 0


def checksum(stamps: int, values: float) -> str:
    return f'{stamps}:{values:.9g}'


def by_numpy(bag: Path) -> str:
    from saddlering_ros.bags import read_raw

    topics = read_raw(bag).topics.values()
    return checksum(sum(int((topic.stamps - EPOCH).sum()) for topic in topics),
                    sum(float(topic.values.sum()) for topic in topics))


def by_numpy_run(bag: Path) -> str:
    from saddlering_ros.bags import read_run

    run = read_run(bag)
    assert len(run.time)
    return '-'


def by_rosbags_raw(bag: Path) -> str:
    from rosbags.highlevel import AnyReader

    with AnyReader([bag]) as reader:
        assert sum(len(data) for _, _, data in reader.messages())
    return '-'


def _sums(messages) -> str:
    stamps, values = 0, 0.0
    for message in messages:
        stamp = message.header.stamp
        stamps += stamp.sec * 10 ** 9 + stamp.nanosec - EPOCH
        values += message.range if hasattr(message, 'range') else message.wrench.force.x
    return checksum(stamps, values)


def by_rosbags(bag: Path) -> str:
    from rosbags.highlevel import AnyReader

    with AnyReader([bag]) as reader:
        return _sums(reader.deserialize(data, connection.msgtype)
                     for connection, _, data in reader.messages())


def by_mcap_raw(bag: Path) -> str:
    from mcap.reader import make_reader

    with bag.open('rb') as file:
        messages = make_reader(file).iter_messages()
        assert sum(len(message.data) for _, _, message in messages)
    return '-'


def by_mcap(bag: Path) -> str:
    from mcap.reader import make_reader
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    with bag.open('rb') as file:
        return _sums(store.deserialize_cdr(message.data, schema.name)
                     for schema, _, message in make_reader(file).iter_messages())


READERS = {
    'numpy': by_numpy, 'numpy, no index': by_numpy, 'numpy, run': by_numpy_run,
    'rosbags, raw': by_rosbags_raw, 'rosbags': by_rosbags, 'mcap, raw': by_mcap_raw,
    'mcap + rosbags': by_mcap,
}


def write(path: Path, count: int, compression: str, *, index: bool) -> None:
    """A bare MCAP file of five rig topics at 1 kHz, `count` messages each."""
    from mcap.writer import CompressionType, IndexType, Writer
    from rosbags.typesys import get_typestore, Stores

    from saddlering_ros.bags.write import messages_of
    from saddlering_ros.record.topics import LOAD, PROBES
    from saddlering_ros.rig import default_rig

    random = np.random.default_rng(0)
    store = get_typestore(Stores.ROS2_JAZZY)
    stamps = EPOCH + np.arange(count) * 1_000_000
    load = 5e3 + 2.4e5 * np.sin(np.linspace(0.0, np.pi, count)) + random.normal(0, 100, count)
    probes = default_rig().probes
    span = (probes.min_range, probes.max_range)
    channels = [messages_of(LOAD, stamps, load)]
    for number, topic in enumerate(PROBES):
        gaps = 1e-3 + 4e-10 * load + random.normal(0, 3e-7, count)
        channels.append(messages_of(topic, stamps + 200_000 * (number + 1), gaps, span))
    kinds = {'zstd': CompressionType.ZSTD, 'lz4': CompressionType.LZ4,
             'none': CompressionType.NONE}
    indexes = IndexType.ALL if index else IndexType.ALL & ~IndexType.MESSAGE
    with path.open('wb') as file:
        writer = Writer(file, compression=kinds[compression], index_types=indexes)
        writer.start(profile='ros2')
        numbers = []
        for topic in (LOAD, *PROBES):
            definition = store.generate_msgdef(topic.type, ros_version=2)[0].encode()
            schema = writer.register_schema(topic.type, 'ros2msg', definition)
            numbers.append(writer.register_channel(
                topic.name, 'cdr', schema, {'offered_qos_profiles': ''}))
        rows = [channel.messages for channel in channels]
        times = np.stack([channel.log_times for channel in channels]).T.tolist()
        for place, of_place in enumerate(times):
            for number, of_channel, stamp in zip(numbers, rows, of_place, strict=True):
                writer.add_message(number, stamp, of_channel[place].tobytes(), stamp)
        writer.add_metadata('saddlering.test', {'test': 'dynamic', 'elevation_deg': '50'})
        writer.finish()


if __name__ == '__main__':
    sys.exit(main())
