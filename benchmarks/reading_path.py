"""How often a reader changes the file on the way from bags to a verdict.

python benchmarks/reading_path.py [BAG ...] [--hold-out BAG ...] [--share 0.01]

Diagnoses the bags (default: the shipped ones) and notes every function of the package at its
first call, in the order of the calls, which is the order of reading. Functions in which less than
`share` of the time passes, callees included, are helpers and are left out. A stop is a stay in one
file; a return is a stop in a file that the reader had left before. To measure an older checkout,
put it first on PYTHONPATH.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import time
from types import CodeType, FrameType
from typing import Any

SHARES = (0.01, 0.03, 0.1)
BAGS = Path(__file__).resolve().parent.parent / 'bags'


class Trace:
    """First calls of the package's functions in order, and the seconds that pass in each."""

    def __init__(self, package: Path) -> None:
        self._package = str(package)
        self._open: dict[CodeType, list[float]] = {}
        self.seconds: dict[CodeType, float] = {}

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event not in ('call', 'return') or not code.co_filename.startswith(self._package):
            return
        if event == 'call':
            self.seconds.setdefault(code, 0.0)
            self._open.setdefault(code, []).append(time.perf_counter())
        elif self._open.get(code):
            began = self._open[code].pop()
            if not self._open[code]:
                self.seconds[code] += time.perf_counter() - began

    def main_functions(self, share: float) -> list[CodeType]:
        """Functions in which at least this share of the time passes, by their first call."""
        least = share * max(self.seconds.values())
        return [code for code, seconds in self.seconds.items()
                if seconds >= least and not code.co_name.startswith('<')]


def stops(functions: list[CodeType]) -> list[tuple[str, list[str]]]:
    """Files in the order of reading, each with the functions that are read there."""
    found: list[tuple[str, list[str]]] = []
    for code in functions:
        if not found or found[-1][0] != code.co_filename:
            found.append((code.co_filename, []))
        found[-1][1].append(code.co_name)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('bags', nargs='*', default=[
        str(BAGS / name) for name in ('static_50', 'dynamic_50', 'dynamic_50_fast', 'static_70')])
    parser.add_argument('--hold-out', nargs='*', default=[str(BAGS / 'dynamic_70')])
    parser.add_argument('--share', type=float, default=0.01)
    args = parser.parse_args()

    import saddlering_ros
    from saddlering_ros.diagnosis import diagnose_bags

    package = Path(saddlering_ros.__file__).parent
    diagnose_bags(args.bags, args.hold_out)  # compiles, so that the share is that of the work
    trace = Trace(package)
    sys.setprofile(trace)
    diagnose_bags(args.bags, args.hold_out)
    sys.setprofile(None)
    for file, names in stops(trace.main_functions(args.share)):
        print(f'{Path(file).relative_to(package)}: {", ".join(names)}')
    for share in sorted({args.share, *SHARES}):
        found = stops(trace.main_functions(share))
        files = {file for file, _ in found}
        print(f'functions with {share:.0%} of the time: '
              f'{sum(len(names) for _, names in found)}, in {len(found)} stops in '
              f'{len(files)} files, {len(found) - len(files)} returns')


if __name__ == '__main__':
    main()
