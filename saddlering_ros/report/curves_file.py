"""The curves of a report as a CSV file beside it: measured and simulated values in SI units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import csv
from pathlib import Path

from saddlering_ros.report.curves import RunCurves
from saddlering_ros.report.errors import ReportError
from saddlering_ros.rig import CHANNELS
from saddlering_ros.writing import whole_file

FACTS = ('bag', 'test', 'elevation_deg', 'held_out', 'time_s', 'load_N', 'direction')


def curves_path(report: Path | str) -> Path:
    """'report_curves.csv' for 'report.html'."""
    path = Path(report)
    return path.with_name(f'{path.stem}_curves.csv')


def write_curves(path: Path, curves: Sequence[RunCurves]) -> None:
    """Write every run's curves as rows of one table, whole or not at all.

    Columns: FACTS, then each channel measured, simulated by the contact law alone and, if any run
    has it, by the extended model: [m], gamma [rad].
    """
    is_extended = any(run.is_extended for run in curves)
    versions = ('measured', 'simulated', *(('simulated_extended',) if is_extended else ()))
    with whole_file(path, ReportError) as temporary, temporary.open(
            'w', encoding='utf-8', newline='') as file:
        table = csv.writer(file)
        table.writerow([*FACTS, *(f'{name}_{kind}' for kind in versions for name in CHANNELS)])
        for run in curves:
            table.writerows(_rows(run, is_extended))


def _rows(run: RunCurves, is_extended: bool) -> Iterator[list[object]]:
    values = [*run.measured, *run.before, *(run.after if is_extended else ())]
    facts = [run.name, run.test, run.elevation_deg, int(run.held_out)]
    for place in range(run.time.size):
        yield [*facts, repr(float(run.time[place])), repr(float(run.load[place])),
               int(run.direction[place]), *(repr(float(row[place])) for row in values)]
