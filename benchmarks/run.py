"""Benchmarks one after the other, each in a process of its own: what `make bench` runs.

python benchmarks/run.py [--full] [NAME ...] runs the short form of each (minutes), or with --full
the campaigns whose tables stand in docs/ (hours on two cores). Without a NAME it runs those of
speed, loss and faults. One that fails does not stop the next; the status reports a failure at the
end.
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
    'alarm': ('--hours', '200', '--swinging', '50', '--draws', '20', '--rings', '2',
              '--records', '1'),
    'long_bags': ('--minutes', '0.5', '1'),
    'sound_bags': ('--count', '40'),
    'logger_faults': ('--rounds', '1'),
    'faults': ('--quick',),
    'latency_budget': ('--seconds', '5'),
    'faults.interlock': ('--rate', '200'),
    'identification': ('--quick',),
    'cost': ('--rounds', '1'),
    'fleet': ('--fleets', '1', '--rings', '50'),
    'fuzz': ('--quick',),
    'blind': ('--quick',),
    'independent': ('--kinds', 'clean', '--clean', '1'),
    'dirty_ring': ('--seeds', '1', '--effects', 'none'),
    'changes': ('--seeds', '1', '--effects', 'none'),
    'any_simulator': ('--machines', 'mask', '--seeds', '1'),
    'real_faults': ('--machines', 'oscillator', '--seeds', '1'),
}
USUAL = ('simulator', 'bag_reading', 'ros_load', 'alarm', 'long_bags', 'sound_bags',
         'logger_faults', 'faults')
"""Those that need no other package and no hour of their own."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('names', nargs='*', metavar='NAME',
                        help=f'of {", ".join(SHORT)}; otherwise {", ".join(USUAL)}')
    parser.add_argument('--full', action='store_true', help='the long campaigns')
    args = parser.parse_args()
    unknown = sorted(set(args.names) - set(SHORT))
    if unknown:
        parser.error(f'no benchmark {unknown[0]}: choose from {", ".join(SHORT)}')
    failed = []
    for name in args.names or USUAL:
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
