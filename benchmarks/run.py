"""Benchmarks one after the other, each in a process of its own: what `make bench` runs.

    python benchmarks/run.py [NAME ...] [--full] [--list]

Each runs in its short form of minutes, or with --full as the campaign whose figures stand in
docs/benchmarks (hours on two cores). Without a NAME those of speed, loss and faults run. One that
fails does not stop the next; the status reports a failure at the end. --list prints the question
of each.
"""

import argparse
import ast
import subprocess
import sys

from frame import ROOT

NAMES = ('simulator', 'reading', 'versions', 'ros_speed', 'faults', 'alarm', 'sound_bags',
         'logger_faults', 'identification', 'fleet', 'blind', 'independent', 'dirty_ring',
         'changes', 'certificates', 'any_simulator', 'real_faults')
USUAL = ('simulator', 'reading', 'ros_speed', 'faults', 'alarm', 'sound_bags', 'logger_faults')
"""Those that need no other package and no hour of their own."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('names', nargs='*', metavar='NAME', help=f'otherwise {", ".join(USUAL)}')
    parser.add_argument('--full', action='store_true', help='the long campaigns')
    parser.add_argument('--list', action='store_true', help='print the question of each')
    args = parser.parse_args()
    if not set(args.names) <= set(NAMES):
        parser.error(f'choose from {", ".join(NAMES)}')
    failed = []
    for name in NAMES if args.list else args.names or USUAL:
        script = ROOT / 'benchmarks' / f'{name}.py'
        if args.list:
            doc = ast.get_docstring(ast.parse(script.read_text())) or ''
            print(f'{name}: {doc.splitlines()[0]}')
            continue
        options = () if args.full else ('--short',)
        print(f'\n== {name} {" ".join(options)}'.rstrip(), flush=True)
        if subprocess.run([sys.executable, str(script), *options], cwd=ROOT,
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
