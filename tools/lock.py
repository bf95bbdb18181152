"""Write requirements/lock/: exactly which versions `make setup` installs, per Python."""

from collections.abc import Sequence
import json
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

REQUIREMENTS = Path(__file__).resolve().parent.parent / 'requirements'
PYTHONS = ('3.10', '3.11', '3.12', '3.13')
JAZZY_PYTHON = '3.12'
JAZZY_BUILT_WITH = ('numpy==1.26.4',)
INSTALLERS = ('pip', 'setuptools')
SOURCE_ONLY = 'empy'  # pure Python, never published as a wheel


def resolve(python: str, inputs: Sequence[str], pins: Sequence[str] = ()) -> dict[str, str]:
    """Return name -> version of all that pip would install for `inputs`, keeping to `pins`."""
    with tempfile.TemporaryDirectory() as folder:
        constraints = Path(folder, 'pins.txt')
        constraints.write_text('\n'.join(pins))
        report = Path(folder, 'report.json')
        arguments = [part for name in inputs for part in ('-r', REQUIREMENTS / f'{name}.in')]
        subprocess.run(
            [python, '-m', 'pip', 'install', '--quiet', '--dry-run', '--ignore-installed',
             '--only-binary', ':all:', '--no-binary', SOURCE_ONLY,
             '--report', report, '-c', constraints, *arguments],
            check=True)
        installed = json.loads(report.read_text())['install']
    return {item['metadata']['name']: item['metadata']['version'] for item in installed}


def write(name: str, versions: dict[str, str], note: str) -> None:
    """Write one lock file."""
    pins = sorted(f'{package}=={version}' for package, version in versions.items())
    path = REQUIREMENTS / 'lock' / f'{name}.txt'
    path.parent.mkdir(exist_ok=True)
    path.write_text('\n'.join([f'# {note}; written by `make lock`', *pins, '']))
    print(f'{path.relative_to(REQUIREMENTS.parent)}: {len(pins)} packages')


def lock(version: str) -> None:
    """Write the lock files of one Python."""
    python = shutil.which(f'python{version}')
    if python is None:
        raise SystemExit(f'lock: python{version} is not on the PATH')
    everything = resolve(python, ['ros', 'build', 'run', 'test'])
    pins = [f'{name}=={number}' for name, number in everything.items()]
    base = resolve(python, ['ros', 'build', 'run'], pins)
    tests = {name: number for name, number in everything.items() if name not in base}
    write(f'{version}-wheels', base, f'ROS 2 Jazzy and all else, for Python {version}')
    write(f'{version}-test', tests, f'what the tests add, for Python {version}')
    needed = resolve(python, ['ros', 'build', 'run', 'docs'], pins)
    docs = {name: number for name, number in needed.items() if name not in base}
    write(f'{version}-docs', docs, f'what `make docs` adds, for Python {version}')
    write(f'{version}-coverage', resolve(python, ['coverage']),
          f'what `make coverage` adds, for Python {version}')
    if version == JAZZY_PYTHON:
        jazzy = resolve(python, ['run'], JAZZY_BUILT_WITH)
        jazzy |= {name: base[name] for name in INSTALLERS}
        write(f'{version}-jazzy', jazzy, 'beside a sourced ROS 2 Jazzy on Ubuntu 24.04')


if __name__ == '__main__':
    for wanted in sys.argv[1:] or PYTHONS:
        lock(wanted)
