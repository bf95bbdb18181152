"""The picture of an import: load and gaps over time, in a few thousand points a channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.files import whole_file
from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.clock import words_of
from saddlering_ros.record.batches import SECOND
from saddlering_ros.rig import FORCE_UNITS, Rig

if TYPE_CHECKING:
    from saddlering_ros.importing.convert import ImportedRun

MAX_RUNS = 6
MAX_POINTS = 4096  # more than a picture has pixels
POINTS_PER_BLOCK = 256  # each with its extremes
_COLOURS = {'hydraulic_load': '#333333', 'eddy_current_1': '#0072B2', 'eddy_current_2': '#D55E00',
            'eddy_current_3': '#009E73', 'eddy_current_4': '#CC79A7'}


@dataclass
class Course:
    """A channel: how many samples, the stamps [ns] of its ends, and stretches for a picture.

    stamps: the first [ns] of each stretch; lowest, highest: its extreme values.
    """

    count: int = 0
    first: int = 0
    last: int = 0
    stamps: list[int] = field(default_factory=list)
    lowest: list[float] = field(default_factory=list)
    highest: list[float] = field(default_factory=list)

    def add(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Add a block of samples (N,)."""
        if not len(stamps):
            return
        self.first = self.first if self.count else int(stamps[0])
        self.last = int(stamps[-1])
        self.count += len(stamps)
        starts = np.unique(np.linspace(0, len(stamps), POINTS_PER_BLOCK + 1).astype(int)[:-1])
        self.stamps += stamps[starts].tolist()
        self.lowest += np.minimum.reduceat(values, starts).tolist()
        self.highest += np.maximum.reduceat(values, starts).tolist()
        if len(self.stamps) > MAX_POINTS:
            even = len(self.stamps) // 2 * 2
            self.stamps = self.stamps[:even:2]
            self.lowest = np.minimum(self.lowest[:even:2], self.lowest[1:even:2]).tolist()
            self.highest = np.maximum(self.highest[:even:2], self.highest[1:even:2]).tolist()


def save_preview(path: Path, runs: Sequence[ImportedRun], rig: Rig) -> None:
    """Write the picture (PNG, SVG or PDF, by the suffix) of the first MAX_RUNS runs.

    rig: whose unit of forces the picture has.
    """
    from matplotlib.figure import Figure

    shown = list(runs[:MAX_RUNS])
    figure = Figure(figsize=(max(7.5, 4.0 * len(shown)), 5.0), layout='constrained')
    axes = figure.subplots(2, len(shown), squeeze=False, sharex='col')
    for run, (load, gaps) in zip(shown, axes.T, strict=True):
        for name in (name for name in _COLOURS if name in run.courses):
            course, is_load = run.courses[name], name == 'hydraulic_load'
            time = (np.array(course.stamps) - run.start) / SECOND
            band = np.array([course.lowest, course.highest])
            band /= FORCE_UNITS[rig.force_unit] if is_load else 1e-3
            plot = load if is_load else gaps
            plot.fill_between(time, *band, color=_COLOURS[name], alpha=0.35, linewidth=0)
            plot.plot(time, band.mean(axis=0), color=_COLOURS[name], linewidth=0.9,
                      label=name.replace('eddy_current_', 'probe '))
        facts = run.metadata
        load.set_title(f'{run.path.name}: {facts.test}, {facts.elevation_deg:g} deg\n'
                       f'from {words_of(run.start)}', fontsize=9)
        gaps.set_xlabel('time [s]')
    axes[0, 0].set_ylabel(f'load [{rig.force_unit}]')
    axes[1, 0].set_ylabel('gap [mm]')
    axes[1, 0].legend(fontsize=8, loc='best')
    for plot in axes.flat:
        plot.grid(color='#dddddd', linewidth=0.6)
    kind = path.suffix.lstrip('.').lower() or 'png'
    with whole_file(path, ImportingError) as temporary:
        try:
            figure.savefig(temporary, format=kind, dpi=120)
        except ValueError as problem:
            raise ImportingError(f'{path}: this kind of figure is not supported: give a name '
                                 'that ends in .png, .svg or .pdf') from problem
