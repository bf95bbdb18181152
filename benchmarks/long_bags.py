"""Memory and time of commands on bags of growing length at 10 kHz.

    python benchmarks/long_bags.py [--minutes 1 5] [--rate 10000] [--keep FOLDER]

Each bag is written block by block. Each command runs in a process of its own, of which the peaks
of resident and of anonymous memory, the processor time and the time on the clock are printed.
Resident memory includes pages of scratch files, which the system can take back.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

import numpy as np

from saddlering_ros.rig import Rig

EPOCH = 1_700_000_000_000_000_000
BLOCK = 1 << 18
COMMANDS = {
    'info': ['info', '{bag}'],
    'displacement': ['displacement', '{bag}'],
    'displacement to parquet': ['displacement', '{bag}', '--out', '{out}.parquet'],
    'identify': ['identify', '{bag}', '--out', '{out}.yaml'],
    'simulate': ['simulate', '{bag}', '--params', '{out}.yaml'],
    'residual to parquet': ['residual', '{bag}', '--params', '{out}.yaml',
                            '--out', '{out}.parquet'],
    'validate': ['validate', '{bag}', '--params', '{out}.yaml'],
    'report': ['report', '{bag}', '--params', '{out}.yaml', '--out', '{out}.html'],
    'watch': ['watch', '{bag}', '--params', '{out}.yaml'],
    'rig --check': ['rig', '--check', '{bag}'],
    'diagnose': ['diagnose', '{bag}'],
}
SAMPLED_EVERY = 0.05
"""Time between two looks at the memory of a command [s]."""


def main() -> int:
    """Write the bags, run the commands on each, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--minutes', type=float, nargs='+', default=[1.0, 5.0])
    parser.add_argument('--rate', type=float, default=1e4)
    parser.add_argument('--test', choices=('dynamic', 'static'), default='dynamic')
    parser.add_argument('--commands', nargs='+', help='only these')
    parser.add_argument('--keep', type=Path, help='folder for the bags, which are kept there')
    args = parser.parse_args()
    print(f'{"minutes":>8}{"messages":>12}{"MB":>8}  {"command":<26}{"peak MB":>9}{"anon MB":>9}'
          f'{"CPU s":>8}{"s":>8}')
    with tempfile.TemporaryDirectory(prefix='saddlering-bench-') as scratch:
        folder = args.keep or Path(scratch)
        for minutes in args.minutes:
            bag = folder / f'{args.test}_{minutes:g}'
            count = int(60.0 * minutes * args.rate)
            if not bag.exists():
                write(bag, count, args.rate, args.test)
            size = sum(file.stat().st_size for file in bag.iterdir()) / 1e6
            for name, words in COMMANDS.items():
                if args.commands and name.split()[0] not in args.commands:
                    continue
                command = [word.format(bag=bag, out=Path(scratch) / 'out') for word in words]
                found = measured(command)
                print(f'{minutes:>8g}{5 * count:>12}{size:>8.0f}  {name:<26}{found.peak:>9.0f}'
                      f'{found.anonymous:>9.0f}{found.processor:>8.1f}{found.passed:>8.1f}',
                      flush=True)
    return 0


@dataclass(frozen=True)
class Measured:
    """Peaks of resident and of anonymous memory [MB], processor time and time [s]."""

    peak: float
    anonymous: float
    processor: float
    passed: float


def measured(words: list[str]) -> Measured:
    """The memory and time of one command."""
    start, anonymous = time.monotonic(), 0.0
    child = subprocess.Popen([sys.executable, '-m', 'saddlering_ros.cli.main', *words],
                             stdout=subprocess.DEVNULL)
    while True:
        ended, status, usage = os.wait4(child.pid, os.WNOHANG)
        if ended:
            break
        anonymous = max(anonymous, anonymous_memory(child.pid))
        time.sleep(SAMPLED_EVERY)
    if status:
        raise SystemExit(f'{" ".join(words)}: status {status}')
    return Measured(usage.ru_maxrss / 1024.0, anonymous, usage.ru_utime + usage.ru_stime,
                    time.monotonic() - start)


def anonymous_memory(process: int) -> float:
    """Memory [MB] of a process that lies in no file."""
    try:
        lines = Path(f'/proc/{process}/status').read_text(encoding='ascii').splitlines()
    except OSError:
        return 0.0
    return sum(float(line.split()[1]) for line in lines if line.startswith('RssAnon')) / 1024.0


def write(bag: Path, count: int, rate: float, test: str) -> None:
    """A bag of `count` messages of each topic: ramps, or steps that are held."""
    from saddlering_ros.bags.write import BagWriter, messages_of
    from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, TOPICS
    from saddlering_ros.rig import default_rig

    rig = default_rig()
    span = (rig.probes.min_range, rig.probes.max_range)
    topics = {name: TOPICS[name].type for name in (LOAD_TOPIC, *PROBE_TOPICS)}
    random = np.random.default_rng(0)
    loads, readings = at_rest(rig)
    with BagWriter(bag, topics, {'test': test, 'elevation_deg': '50'}) as writer:
        for start in range(0, count, BLOCK):
            time_of = np.arange(start, min(start + BLOCK, count)) / rate
            load = rig.preload + 0.9 * rig.full_scale_load * shape(time_of, test, count / rate)
            load += random.normal(0.0, 50.0, load.size)
            stamps = EPOCH + np.rint(1e9 * time_of).astype(np.int64)
            blocks = [messages_of(TOPICS[LOAD_TOPIC], stamps, load)]
            for number, moved in enumerate(readings, start=1):
                gaps = 1e-3 + rig.probes.polarity[number - 1] * np.interp(load, loads, moved)
                gaps += random.normal(0.0, 3e-7, load.size)
                blocks.append(messages_of(TOPICS[PROBE_TOPICS[number - 1]],
                                          stamps + 1000 * number, gaps, span))
            writer.write(blocks)


def at_rest(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Loads (N,) [N], and how far the faces of the probes (4, N) [m] stand at rest under them."""
    from saddlering_ros.rig import Displacement, displacement_to_probes, TRUE_TO_SCALE
    from saddlering_ros.ring import static_response

    loads = np.linspace(0.5 * rig.preload, rig.full_scale_load, 200)
    x, y, tilt = static_response(rig, TRUE_TO_SCALE.to_array(), np.radians(50.0), loads)
    return loads, displacement_to_probes(rig.probes, Displacement(x, y, tilt, 0.0))


def shape(time_of: np.ndarray, test: str, end: float) -> np.ndarray:
    """The load's share of its range: ramps of 10 s, or steps of 5 s up and down, after 1 s.

    Ramps that would not be over at `end` [s] do not begin: a record ends at rest.
    """
    later = np.maximum(time_of - 1.0, 0.0)
    if test == 'dynamic':
        share = 1.0 - np.abs(1.0 - (later % 20.0) / 10.0)
        return np.where(later < 20.0 * ((end - 2.0) // 20.0), share, 0.0)
    step = np.floor(later / 5.0) % 48
    return np.minimum(step, 48 - step) / 24.0


if __name__ == '__main__':
    sys.exit(main())
