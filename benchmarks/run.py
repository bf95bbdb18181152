"""Benchmarks one after the other, each in a process of its own: what `make bench` runs.

    python benchmarks/run.py [NAME ...] [--full] [--list]

Each runs in its short form of minutes, or with --full as the campaign whose figures stand in
docs/benchmarks (hours on two cores). Without a NAME those of speed, loss and faults run. One that
fails does not stop the next; the status reports a failure at the end. --list prints the question
of each.
"""

from __future__ import annotations

import argparse
import ast
from pathlib import Path
import subprocess
import sys

from frame import ROOT

SHORT: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(('simulator', 'reading', 'versions', 'ros_speed', 'faults',
                     'alarm', 'sound_bags', 'logger_faults', 'fuzz', 'attacks',
                     'identification', 'fleet', 'blind', 'independent', 'any_simulator',
                     'real_faults'), ('--short',)),
    'dirty_ring': ('--seeds', '1', '--effects', 'none'),
    'changes': ('--seeds', '1', '--effects', 'none'),
    'certificates': ('coverage', '--rigs', '3'),
}
"""Benchmarks, and the options of their short forms."""

USUAL = ('simulator', 'reading', 'ros_speed', 'faults', 'alarm', 'sound_bags', 'logger_faults')
"""Those that need no other package and no hour of their own."""


def file_of(name: str) -> Path:
    """The script of a benchmark, or the main module of one in several modules."""
    folder = ROOT / 'benchmarks' / name
    return folder / '__main__.py' if folder.is_dir() else folder.with_suffix('.py')


def program(name: str) -> list[str]:
    """How Python starts a benchmark."""
    file = file_of(name)
    return ['-m', f'benchmarks.{name}'] if file.stem == '__main__' else [str(file)]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('names', nargs='*', metavar='NAME', help=f'otherwise {", ".join(USUAL)}')
    parser.add_argument('--full', action='store_true', help='the long campaigns')
    parser.add_argument('--list', action='store_true', help='print the question of each')
    args = parser.parse_args()
    unknown = sorted(set(args.names) - set(SHORT))
    if unknown:
        parser.error(f'no benchmark {unknown[0]}: choose from {", ".join(SHORT)}')
    failed = []
    for name in SHORT if args.list else args.names or USUAL:
        if args.list:
            doc = ast.get_docstring(ast.parse(file_of(name).read_text())) or ''
            print(f'{name}: {doc.splitlines()[0]}')
            continue
        options = () if args.full else SHORT[name]
        print(f'\n== {name} {" ".join(options)}'.rstrip(), flush=True)
        if subprocess.run([sys.executable, *program(name), *options], cwd=ROOT,
                          check=False).returncode:
            failed.append(name)
    if failed:
        print(f'\nfailed: {", ".join(failed)}')
    return 1 if failed else 0


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
