"""Conditions that a run must meet for an identification, and notes on doubtful runs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.record import BagError, Plateaus, plateaus, Record
from saddlering_ros.record.measured import zero_of_run
from saddlering_ros.rig import Rig


def run_name(run: Record) -> str:
    """Name of a run in messages: its path, or its name if it has none."""
    return str(run.path) if getattr(run, 'path', None) else run.name


def warnings_of(run: Record, rig: Rig) -> list[str]:
    """Faults that make the result of a run doubtful, one line each."""
    name = run_name(run)
    warnings = [f'{name}: {note}' for note in run.notes]
    for probe, clipped in enumerate(saturated(run, rig), start=1):
        share = float(np.mean(clipped))
        if share > 0.001:
            warnings.append(
                f'{name}: probe {probe} is at a limit of its span in {100.0 * share:.1f} % of '
                'the record, which is left out'
            )
    noted = any('not near the preload' in note for note in run.notes)
    if not noted and not zero_of_run(rig, run).near_preload:
        warnings.append(f'{name}: the record does not start near the preload; its zero is at a '
                        'higher load')
    return warnings


def saturated(run: Record, rig: Rig) -> NDArray[np.bool_]:
    """Mask (4, N) of readings at a limit of the span, behind which the face may be farther."""
    margin = 1e-4 * (rig.probes.max_range - rig.probes.min_range)
    low, high = rig.probes.min_range + margin, rig.probes.max_range - margin
    with np.errstate(invalid='ignore'):
        return np.asarray((run.gaps <= low) | (run.gaps >= high))


def check_run(run: Record, rig: Rig) -> Plateaus | None:
    """The plateaus of a static run, None for a dynamic one.

    IdentificationError if the range of the run is too small for an identification.
    """
    name = run_name(run)
    if not np.isfinite(run.elevation):
        raise IdentificationError(f'{name}: its elevation is {run.elevation}: give it in degrees')
    if not np.all(np.isfinite(run.load)):
        raise IdentificationError(f'{name}: its load is not finite everywhere: cut the record')
    top = float(np.nanmax(run.load)) if len(run.load) else 0.0
    least = rig.limits.identification_min
    if not top > least:
        raise IdentificationError(
            f'{name}: the load never exceeds {rig.force_words(least)} (highest '
            f'{rig.force_words(top)}), a fifth of full scale '
            f'({rig.force_words(rig.full_scale_load)}'
            "): load the ring further, or correct the rig file's full_scale_load"
        )
    if run.test == 'static':
        return _check_static(run, rig, name)
    if float(np.nanmedian(run.load[-max(1, len(run.load) // 100) :])) > 0.5 * top:
        raise IdentificationError(
            f'{name}: there is no unloading branch (the record ends at '
            f'{rig.force_words(float(run.load[-1]))}): record the test until the load is removed'
        )
    return None


def _check_static(run: Record, rig: Rig, name: str) -> Plateaus:
    try:
        found = plateaus(run, errors=False)
    except BagError as problem:
        raise IdentificationError(f'{name}: {problem}') from problem
    levels = np.unique(np.round(found.load / rig.limits.level_step))
    if len(levels) < 2:
        raise IdentificationError(
            f'{name}: a static run with one plateau only: '
            'identification needs readings at several loads'
        )
    if not np.any(np.asarray(found.branch) < 0):
        raise IdentificationError(
            f'{name}: there is no unloading branch in this static run: '
            'record the steps down to zero as well'
        )
    return found


def clipped_words(name: str) -> str:
    """Message of a run whose probes read too little."""
    return (f'{name}: probes are missing or at a limit of their span in most of the record: '
            'adjust their gaps and repeat the test')
