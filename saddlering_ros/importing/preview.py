"""The picture of an import: load and gaps over time, in a few thousand points a channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.files import whole_file
from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.clock import SECOND, words_of
from saddlering_ros.rig import FORCE_UNITS, Rig

if TYPE_CHECKING:
    from saddlering_ros.importing.convert import ImportedRun

MAX_RUNS = 6
_GAP, _MILLIMETRE = 'eddy_current_', 1e-3
_COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7')


def save_preview(path: Path, runs: Sequence[ImportedRun], rig: Rig) -> None:
    """Write the picture (PNG, SVG or PDF, by the suffix) of the first MAX_RUNS runs.

    rig: whose unit of forces the picture has.
    """
    from matplotlib.figure import Figure

    shown = list(runs[:MAX_RUNS])
    figure = Figure(figsize=(max(7.5, 4.0 * len(shown)), 5.0), layout='constrained')
    axes = figure.subplots(2, len(shown), squeeze=False, sharex='col')
    for run, (load, gaps) in zip(shown, axes.T, strict=True):
        # Draw one run into its two plots; force_unit [N]: of the plot of the load.
        force_unit = FORCE_UNITS[rig.force_unit]
        start = min(first for first, _ in run.spans.values())
        for name, envelope in run.envelopes.items():
            time = (np.array(envelope.stamps) - start) / SECOND
            band = np.array([envelope.lowest, envelope.highest])
            if name.startswith(_GAP):
                number = int(name.removeprefix(_GAP))
                _draw_band(gaps, time, band / _MILLIMETRE, _COLOURS[number - 1], f'probe {number}')
            elif name == 'hydraulic_load':
                _draw_band(load, time, band / force_unit, '#333333', None)
        facts = run.metadata
        load.set_title(f'{run.path.name}: {facts.test}, {facts.elevation_deg:g} deg\n'
                       f'from {words_of(start)}', fontsize=9)
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


def _draw_band(plot: Any, time: Any, band: Any, colour: str, label: str | None) -> None:
    plot.fill_between(time, *band, color=colour, alpha=0.35, linewidth=0)
    plot.plot(time, band.mean(axis=0), color=colour, linewidth=0.9, label=label)


MAX_POINTS = 4096
POINTS_PER_BLOCK = 256


@dataclass
class Envelope:
    """Stretches of a channel, each with its first stamp [ns], its lowest and highest value."""

    stamps: list[int] = field(default_factory=list)
    lowest: list[float] = field(default_factory=list)
    highest: list[float] = field(default_factory=list)

    def add(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Add a block of samples (N,), N above 0."""
        starts = np.unique(np.linspace(0, len(stamps), POINTS_PER_BLOCK + 1).astype(int)[:-1])
        self.stamps += stamps[starts].tolist()
        self.lowest += np.minimum.reduceat(values, starts).tolist()
        self.highest += np.maximum.reduceat(values, starts).tolist()
        if len(self.stamps) > MAX_POINTS:
            even = len(self.stamps) // 2 * 2
            self.stamps = self.stamps[:even:2]
            self.lowest = np.minimum(self.lowest[:even:2], self.lowest[1:even:2]).tolist()
            self.highest = np.maximum(self.highest[:even:2], self.highest[1:even:2]).tolist()
