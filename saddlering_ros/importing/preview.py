"""A picture of an import: load and gaps over time, one column for each run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from saddlering_ros.importing.clock import SECOND, words_of
from saddlering_ros.importing.convert import ImportedRun
from saddlering_ros.importing.errors import ImportingError
from saddlering_ros.writing import whole_file

MAX_RUNS = 6
_SHOWN = {'hydraulic_load': ('load [kN]', 1e3), 'elevation': ('elevation [deg]', np.pi / 180)}
_COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7')


def save_preview(path: Path, runs: Sequence[ImportedRun]) -> None:
    """Write the picture (PNG, SVG or PDF, by the suffix) of the first MAX_RUNS runs."""
    from matplotlib.figure import Figure

    shown = list(runs[:MAX_RUNS])
    figure = Figure(figsize=(max(7.5, 4.0 * len(shown)), 5.0), layout='constrained')
    axes = figure.subplots(2, len(shown), squeeze=False, sharex='col')
    for column, run in enumerate(shown):
        start = min(first for first, _ in run.spans.values())
        for name, envelope in run.envelopes.items():
            is_gap = name.startswith('eddy')
            label, factor = (name.replace('eddy_current_', 'probe '), 1e-3) if is_gap else \
                _SHOWN[name]
            if name == 'elevation':
                continue
            plot = axes[int(is_gap), column]
            time = (np.array(envelope.stamps) - start) / SECOND
            low, high = np.array(envelope.lowest) / factor, np.array(envelope.highest) / factor
            colour = _COLOURS[int(name[-1]) - 1] if is_gap else '#333333'
            plot.fill_between(time, low, high, color=colour, alpha=0.35, linewidth=0)
            plot.plot(time, (low + high) / 2, color=colour, linewidth=0.9,
                      label=label if is_gap else None)
        facts = run.metadata
        axes[0, column].set_title(f'{run.path.name}: {facts.test}, {facts.elevation_deg:g} deg\n'
                                  f'from {words_of(start)}', fontsize=9)
        axes[1, column].set_xlabel('time [s]')
    axes[0, 0].set_ylabel('load [kN]')
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
