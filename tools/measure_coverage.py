"""Run the test suite with every process measured: statements covered, by package.

python tools/measure_coverage.py [arguments of pytest]

Prints a table and writes each file's uncovered lines to out/coverage/lines.txt. Compiled functions
are left out (setup.cfg): they do not run as Python.
"""

import collections
import json
import os
from pathlib import Path
import shutil
import subprocess
import sys

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / 'out' / 'coverage'
ENVIRONMENT = {**os.environ, 'COVERAGE_PROCESS_START': str(ROOT / 'setup.cfg'),
               'COVERAGE_FOLDER': str(FOLDER)}


def coverage(*arguments: str) -> str:
    """Return what a coverage command prints, which runs unmeasured itself."""
    environment = {name: value for name, value in ENVIRONMENT.items()
                   if name != 'COVERAGE_PROCESS_START'}
    return subprocess.run([sys.executable, '-m', 'coverage', *arguments], cwd=ROOT, check=True,
                          env=environment, stdout=subprocess.PIPE, text=True).stdout


def by_package() -> dict[str, tuple[int, int]]:
    """Return the statements of each package, and how many of them ran."""
    coverage('json', '--quiet', '-o', str(FOLDER / 'coverage.json'))
    sums: dict[str, list[int]] = collections.defaultdict(lambda: [0, 0])
    files = json.loads((FOLDER / 'coverage.json').read_text())['files']
    for name, figures in files.items():
        inside = Path(name).parts[1:]
        package = inside[0] if len(inside) > 1 else 'modules of no package'
        sums[package][0] += figures['summary']['num_statements']
        sums[package][1] += figures['summary']['covered_lines']
    return {package: (total, ran) for package, (total, ran) in sorted(sums.items())}


def main() -> int:
    """Run the tests, then print the table; the status is that of the tests."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir(parents=True)
    status = subprocess.run(['tools/test.sh', *sys.argv[1:]], cwd=ROOT, env=ENVIRONMENT,
                            check=False).returncode
    coverage('combine', '--quiet')
    (FOLDER / 'lines.txt').write_text(coverage('report', '--show-missing', '--skip-covered'))
    packages = by_package()
    packages['all'] = (sum(total for total, _ in packages.values()),
                       sum(ran for _, ran in packages.values()))
    print(f'\n{"package":24}{"statements":>12}{"covered":>10}')
    for package, (total, ran) in packages.items():
        print(f'{package:24}{total:12}{100.0 * ran / max(total, 1):8.1f} %')
    return status


if __name__ == '__main__':
    sys.exit(main())
