"""What all benchmarks share: command line, tasks side by side, processes, tables, shares, rows."""

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
import json
import math
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any

from saddlering_ros.quantities import WIDTH_95

ROOT = Path(__file__).resolve().parents[1]
ONE_THREAD = {
    'SADDLERING_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1',
    'MKL_NUM_THREADS': '1'}
LOOKS = 0.05
"""Time [s] between two looks at the memory of a process."""


def arguments(doc: str | None, short: Mapping[str, Any], **options: Any) -> argparse.Namespace:
    """The command line of a benchmark whose docstring explains its options.

    Each option has its default here: False makes a switch, a type an option that may be absent, a
    tuple one of several values (of these words). --short sets those of `short`, for a minute.
    """
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in options.items():
        flag = f'--{name.replace("_", "-")}'
        if default is False:
            parser.add_argument(flag, action='store_true')
        elif isinstance(default, tuple):
            kind = type(default[0]) if default else str
            parser.add_argument(flag, nargs='*', type=kind, default=list(default),
                                choices=default if kind is str and default else None)
        elif isinstance(default, type):
            parser.add_argument(flag, type=default)
        else:
            parser.add_argument(flag, type=type(default), default=default)
    parser.add_argument('--short', action='store_true', help='the form of a minute')
    if '--short' in sys.argv:
        parser.set_defaults(**short)
    return parser.parse_args()


def side_by_side(tasks: Mapping[str, Callable[[], object]], rounds: int,
                 clock: Callable[[], float] = time.thread_time) -> dict[str, float]:
    """Seconds of each task: the least of rounds in which all run in turn.

    Other programs can only add to a time. The first call of each, which compiles, does not count.
    """
    least = dict.fromkeys(tasks, math.inf)
    for task in tasks.values():
        task()
    for _ in range(rounds):
        for name, task in tasks.items():
            began = clock()
            task()
            least[name] = min(least[name], clock() - began)
    return least


@dataclass(frozen=True)
class Process:
    """One process: what it printed, peaks of resident and of anonymous memory [MB], times [s]."""

    said: str
    peak: float
    anonymous: float
    processor: float
    passed: float


def run(words: Sequence[str], **environment: str) -> Process:
    """Run a Python program in the repository; SystemExit if it fails."""
    began, peak, anonymous = time.monotonic(), 0.0, 0.0
    with tempfile.TemporaryFile('w+') as file:
        child = subprocess.Popen([sys.executable, *words], cwd=ROOT, stdout=file,
                                 env={**os.environ, **environment})
        while True:
            ended, status, usage = os.wait4(child.pid, os.WNOHANG)
            if ended:
                break
            memory = memory_of(child.pid)
            peak = max(peak, memory.get('VmHWM', 0.0))
            anonymous = max(anonymous, memory.get('RssAnon', 0.0))
            time.sleep(LOOKS)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise SystemExit(f'{" ".join(words)}: status {child.returncode}')
        file.seek(0)
        return Process(file.read(), peak, anonymous, usage.ru_utime + usage.ru_stime,
                       time.monotonic() - began)


def memory_of(process: int) -> dict[str, float]:
    """Memory [MB] of a process by the kernel's names; what it was before its program started is
    not part of it, as it is of the usage that wait4 reports."""
    try:
        lines = Path(f'/proc/{process}/status').read_text(encoding='ascii').splitlines()
    except OSError:
        return {}
    return {line.split(':')[0]: float(line.split()[1]) / 1024.0
            for line in lines if line.endswith(' kB')}


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a Markdown table; a float with four digits."""
    print(f'\n{title}\n\n| {" | ".join(columns)} |\n{"|---" * len(columns)}|')
    for row in rows:
        cells = [f'{cell:.4g}' if isinstance(cell, float) else str(cell) for cell in row]
        print(f'| {" | ".join(cells)} |', flush=True)


def wilson(count: int, total: int) -> tuple[float, float]:
    """95 % interval of a share (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    share, whole = count / total, WIDTH_95**2 / total
    middle = (share + 0.5 * whole) / (1.0 + whole)
    half = math.sqrt(whole * (share * (1.0 - share) + 0.25 * whole)) / (1.0 + whole)
    return max(0.0, middle - half), min(1.0, middle + half)


def share(hits: Iterable[object]) -> str:
    """How many of the hits are true, with the interval of their share."""
    listed = [bool(hit) for hit in hits]
    if not listed:
        return 'no trials'
    low, high = wilson(sum(listed), len(listed))
    return (f'{sum(listed)}/{len(listed)} = {100.0 * sum(listed) / len(listed):.0f} % '
            f'({100.0 * low:.0f} to {100.0 * high:.0f})')


def kept_rows(file: Path) -> list[dict[str, Any]]:
    """Rows of a campaign kept so far; a last line that was cut off does not count."""
    rows = []
    for line in file.read_text().splitlines() if file.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def keep(file: Path, row: Mapping[str, Any]) -> None:
    """Append a row to a campaign, so that one that was cut off goes on where it stopped."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open('a') as kept:
        kept.write(f'{json.dumps(row)}\n')
