"""Pictures of a validation as in figures 12 to 19 of the paper: simulated beside measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.identification.validation import RunValidation, Validation
from saddlering_ros.rig import CHANNELS, FORCE_UNITS, MICRO_UNITS
from saddlering_ros.writing import whole_file

SHOWN = ('delta_x', 'delta_y', 'gamma')


def plot_paths(validation: Validation, folder: Path) -> list[Path]:
    """Path of the PNG of each run in `folder`."""
    return [folder / f'{number:02d}_{Path(run.name).stem}.png'
            for number, run in enumerate(validation.runs, start=1)]


def save_plots(validation: Validation, folder: Path, force_unit: str = 't') -> list[Path]:
    """One PNG per run in `folder`; the paths written. force_unit: unit of loads."""
    matplotlib.use('Agg')
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [_save(run, path, force_unit) for run, path in zip(
            validation.runs, plot_paths(validation, folder), strict=True)]
    except OSError as problem:
        raise IdentificationError(
            f'{folder}: pictures cannot be written ({problem.strerror}): choose another place'
        ) from problem


def _save(run: RunValidation, path: Path, force_unit: str) -> Path:
    """Draw a run; `Figure.savefig` would draw it twice, once for the layout alone."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 9.0), dpi=110, layout='constrained')
    axes = figure.subplots(len(SHOWN), 3)
    figure.suptitle(f'{run.name}: {run.test}, {np.degrees(run.elevation):g} deg')
    for row, channel in enumerate(SHOWN):
        _draw(axes[row], run, channel, force_unit)
    with whole_file(path, IdentificationError) as temporary:
        FigureCanvasAgg(figure).print_png(temporary)
    return path


def _draw(axes: Any, run: RunValidation, channel: str, force_unit: str) -> None:
    """Over load, over time, and the residual over time, with the noise floor as a band."""
    position = CHANNELS.index(channel)
    unit, size = MICRO_UNITS[channel], FORCE_UNITS[force_unit]
    measured, simulated = 1e6 * run.measured[position], 1e6 * run.simulated[position]
    over_load, over_time, residual = axes
    if run.reading_load.size:
        loads = run.reading_load / size
        over_load.plot(loads, 1e6 * run.reading_measured[position], 'o', ms=4, mfc='none',
                       label='measured')
        over_load.plot(loads, 1e6 * run.reading_simulated[position], '-', label='simulated')
    else:
        over_load.plot(run.load / size, measured, lw=0.8, label='measured')
        over_load.plot(run.load / size, simulated, lw=1.2, label='simulated')
    over_load.set(xlabel=f'load / {force_unit}', ylabel=f'{channel} / {unit}')
    over_load.legend()
    over_time.plot(run.time, measured, lw=0.8)
    over_time.plot(run.time, simulated, lw=1.2)
    over_time.set(xlabel='time / s', ylabel=f'{channel} / {unit}')
    difference = np.where(run.compared, measured - simulated, np.nan)
    residual.plot(run.time, difference, lw=0.6, color='tab:gray')
    figures = run.channels[channel]
    if figures.noise_floor is not None:
        band = 2e6 * figures.noise_floor * figures.range
        residual.axhspan(-band, band, alpha=0.2, color='tab:green', label='2 x noise floor')
        residual.legend()
    residual.set(xlabel='time / s', ylabel=f'measured - simulated / {unit}')
