"""All benchmarks one after the other, each in a process of its own: what `make bench` runs.

python benchmarks/run.py [--full] [NAME ...] runs the short form of each (minutes), or with --full
the campaigns whose tables stand in docs/ (hours on two cores). One that fails does not stop the
next; the status tells at the end.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import subprocess
import sys

FOLDER = Path(__file__).parent
SHORT: dict[str, tuple[str, ...]] = {
    'simulator': ('--quick',),
    'bag_reading': ('--megabytes', '20'),
    'ros_load': ('--seconds', '10'),
    'identification': ('--quick',),
    'peers': ('--quick',),
    'recovery': ('--quick',),
    'uncertainty': ('--quick',),
    'fuzz': ('--quick',),
    'faults': ('--quick',),
    'logger_faults': ('--rounds', '1'),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('names', nargs='*', metavar='NAME', help=f'of {", ".join(SHORT)}')
    parser.add_argument('--full', action='store_true', help='the long campaigns')
    args = parser.parse_args()
    unknown = sorted(set(args.names) - set(SHORT))
    if unknown:
        parser.error(f'no benchmark {unknown[0]}: choose from {", ".join(SHORT)}')
    failed = []
    for name in args.names or SHORT:
        options = () if args.full else SHORT[name]
        print(f'\n== {name} {" ".join(options)}'.rstrip(), flush=True)
        script = FOLDER / f'{name}.py'
        program = (str(script),) if script.exists() else ('-m', f'benchmarks.{name}')
        command = [sys.executable, *program, *options]
        if subprocess.run(command, cwd=FOLDER.parent, check=False).returncode:
            failed.append(name)
    if failed:
        print(f'\nfailed: {", ".join(failed)}')
    return 1 if failed else 0


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
