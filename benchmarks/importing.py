"""How long an import takes and how much memory it needs."""

from __future__ import annotations

import argparse
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

import h5py
import nptdms
import numpy as np

CHANNELS = ('F', 'w1', 'w2', 'w3', 'w4')
MAP = """\
time: {time}
channels:
  hydraulic_load: {{column: F, unit: kN}}
  eddy_current_1: {{column: w1, unit: mm, range: [0, 0.002]}}
  eddy_current_2: {{column: w2, unit: mm, range: [0, 0.002]}}
  eddy_current_3: {{column: w3, unit: mm, range: [0, 0.002]}}
  eddy_current_4: {{column: w4, unit: mm, range: [0, 0.002]}}
test: {{test: dynamic, elevation_deg: 50}}
"""
COUNTED = '{column: t, unit: s, start: "2026-11-20T08:00:00Z"}'


def write_files(folder: Path, rows: int) -> dict[str, tuple[Path, str]]:
    """The same record as CSV, HDF5 and TDMS; with each file what its map says of the time."""
    rng = np.random.default_rng(1)
    table = {'t': np.arange(rows) / 2000.0, 'F': 100.0 + rng.standard_normal(rows),
             **{name: 1.0 + 0.01 * rng.standard_normal(rows) for name in CHANNELS[1:]}}
    with (folder / 'a.csv').open('w') as file:
        file.write(','.join(table) + '\n')
        for row in zip(*(column.tolist() for column in table.values()), strict=True):
            file.write('{:.4f},{:.5f},{:.6f},{:.6f},{:.6f},{:.6f}\n'.format(*row))
    with h5py.File(folder / 'a.h5', 'w') as file:
        for name, values in table.items():
            file.create_dataset(name, data=values, chunks=True)
    start = np.datetime64('2026-11-20T08:00:00')
    with nptdms.TdmsWriter(folder / 'a.tdms') as writer:
        writer.write_segment([nptdms.ChannelObject(
            'g', name, table[name], {'wf_start_time': start, 'wf_increment': 1 / 2000})
            for name in CHANNELS])
    return {'CSV': (folder / 'a.csv', COUNTED), 'HDF5': (folder / 'a.h5', COUNTED),
            'TDMS': (folder / 'a.tdms', '{from: file}')}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('rows', type=int, nargs='?', default=1_000_000)
    rows = parser.parse_args().rows
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print('| format | rows | messages | file [MB] | time [s] | of it processor [s] '
              '| memory [MB] |\n|---|---|---|---|---|---|---|')
        for kind, (path, clock) in write_files(folder, rows).items():
            (folder / 'map.yaml').write_text(MAP.format(time=clock))
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            started = time.monotonic()
            done = subprocess.run(
                [sys.executable, '-c', PROGRAM, 'import', str(path), '--map',
                 str(folder / 'map.yaml'), '--out', str(folder / kind)],
                check=True, capture_output=True, text=True)
            elapsed = time.monotonic() - started
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            memory = float(done.stdout.splitlines()[-1])
            print(f'| {kind} | {rows} | {5 * rows} | {path.stat().st_size / 1e6:.0f} '
                  f'| {elapsed:.1f} | {used:.1f} | {memory:.0f} |')


PROGRAM = """
import sys
from saddlering_ros.cli.main import main
status = main(sys.argv[1:])
lines = open('/proc/self/status').read().splitlines()
print(next(int(line.split()[1]) / 1e3 for line in lines if line.startswith('VmHWM')))
sys.exit(status)
"""

if __name__ == '__main__':
    main()
