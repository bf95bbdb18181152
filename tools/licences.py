"""Licences of what the environment holds, as a Markdown table: python tools/licences.py [LOCK]."""

from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
import re
import sys

LONGEST = 60


def licence_of(name: str) -> str:
    """What a package says of its licence: expression, classifier, or the field, in that order."""
    about = metadata.metadata(name)
    expression = about.get('License-Expression')
    if expression:
        return str(expression)
    classifiers = [line.rpartition(' :: ')[2] for line in about.get_all('Classifier') or []
                   if line.startswith('License :: ') and not line.endswith('OSI Approved')]
    if classifiers:
        return ', '.join(classifiers)
    lines = str(about.get('License') or '').strip().splitlines()
    return lines[0][:LONGEST] if lines else 'not said'


def pinned(lock: Path) -> Iterator[str]:
    """The packages that a lock file pins."""
    for line in lock.read_text().splitlines():
        found = re.match(r'([A-Za-z0-9._-]+)==', line)
        if found:
            yield found[1]


def main() -> None:
    """Print the table; packages of ROS 2 that say the same on one line."""
    version = f'{sys.version_info.major}.{sys.version_info.minor}'
    default = Path(__file__).parent.parent / 'requirements' / 'lock' / f'{version}-wheels.txt'
    lock = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    ros: dict[str, int] = {}
    print('| package | version | licence |\n|---|---|---|')
    for name in pinned(lock):
        try:
            licence, installed = licence_of(name), metadata.version(name)
        except metadata.PackageNotFoundError:
            print(f'| {name} | not installed | |')
            continue
        if name.startswith('ros-'):
            ros[licence] = ros.get(licence, 0) + 1
        else:
            print(f'| {name} | {installed} | {licence} |')
    for licence, count in sorted(ros.items(), key=lambda item: -item[1]):
        print(f'| {count} packages of ROS 2 Jazzy | | {licence} |')


if __name__ == '__main__':
    main()
