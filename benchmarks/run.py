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
import subprocess
import sys

from frame import ROOT

SHORT: dict[str, tuple[str, ...]] = {
    'simulator': ('--short',),
    'reading': ('--short',),
    'versions': ('--short',),
    'ros_load': ('--seconds', '10'),
    'latency_budget': ('--seconds', '5'),
    'faults': ('--quick',),
    'faults.interlock': ('--rate', '200'),
    'alarm': ('--hours', '200', '--swinging', '50', '--draws', '20', '--rings', '2',
              '--records', '1'),
    'sound_bags': ('--count', '40'),
    'logger_faults': ('--rounds', '1'),
    'fuzz': ('--quick',),
    'attacks': (),
    'identification': ('--quick',),
    'fleet': ('--fleets', '1', '--rings', '50'),
    'blind': ('--quick',),
    'independent': ('--kinds', 'clean', '--clean', '1'),
    'dirty_ring': ('--seeds', '1', '--effects', 'none'),
    'changes': ('--seeds', '1', '--effects', 'none'),
    'certificates': ('coverage', '--rigs', '3'),
    'any_simulator': ('--machines', 'mask', '--seeds', '1'),
    'real_faults': ('--machines', 'oscillator', '--seeds', '1'),
}
USUAL = ('simulator', 'reading', 'ros_load', 'faults', 'alarm', 'sound_bags', 'logger_faults')
"""Those that need no other package and no hour of their own."""


def program(name: str) -> list[str]:
    """How Python starts a benchmark: a script, or a package with its own modules."""
    script = ROOT / 'benchmarks' / f'{name}.py'
    is_script = script.exists() and name != 'attacks'
    return [str(script)] if is_script else ['-m', f'benchmarks.{name}']


def question(name: str) -> str:
    """The first line of a benchmark's docstring."""
    place = ROOT / 'benchmarks' / name.replace('.', '/')
    file = place / '__main__.py' if place.is_dir() else place.with_suffix('.py')
    return (ast.get_docstring(ast.parse(file.read_text())) or '').splitlines()[0]


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
            print(f'{name}: {question(name)}')
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
