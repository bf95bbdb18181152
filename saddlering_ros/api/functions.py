"""The computations of the API: identify, validate, diagnose, compare, and the curves of a test."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros import diagnosis
from saddlering_ros.api import inputs
from saddlering_ros.api.inputs import Bag, BagLike, ParametersLike, RigLike, runs_of
from saddlering_ros.api.results import (
    ComparisonResult,
    DiagnosisResult,
    IdentificationResult,
    Plot,
    ValidationResult,
)
from saddlering_ros.bags.samples import displacement_columns, write_samples
from saddlering_ros.errors import Cancelled, Interrupted
from saddlering_ros.files import bag_folder, Provenance, spare_bags
from saddlering_ros.identification import methods, validation
from saddlering_ros.identification.settings import IdentificationSettings, SwarmSettings
from saddlering_ros.progress import IsCancelled, OnProgress, Watch
from saddlering_ros.record.batches import join
from saddlering_ros.record.displacement import measured_stretches
from saddlering_ros.record.residual import residual_stretches, simulated_stretches
from saddlering_ros.rig import CHANNELS, MICRO_UNITS, MOTION

Array = NDArray[np.float64]

MAX_DRAWN = 4000
"""Largest number of samples of a curve that a figure shows."""


def identify(bags: BagLike | Iterable[BagLike], *, rig: RigLike = None,
             settings: IdentificationSettings | None = None, method: str = 'default',
             bounds: Mapping[str, tuple[float, float]] | None = None, particles: int = 20,
             iterations: int = 50, accuracy: float | None = None, stagnation: int | None = None,
             log_stiffness: bool = False, use_delta_y: bool | None = None, seed: int = 0,
             trust_rig: bool = False, on_progress: OnProgress | None = None,
             is_cancelled: IsCancelled | None = None) -> IdentificationResult:
    """Identify the contact parameters K1, n1, D1, K2, n2, D2 from static and dynamic bags.

    bags: bags from `read_bag`, or paths. rig: a rig or a rig file; None for that with which the
    bags were read, or else for that of SADDLERING_RIG, or else for the shipped rig. settings: all
    options of the identification as one object; without it they are taken from the keywords
    `method` to `seed`:
    method: 'default' (joint fit of all channels) or 'paper' (two swarm steps as published).
    bounds: (low, high) in SI units by parameter, in place of those of the rig. particles,
    iterations, accuracy (objective) and stagnation (iterations without progress) control the
    swarm; seed is that of its random start.
    log_stiffness and use_delta_y change the paper's method.
    A bag that states another rig than `rig` is refused, unless trust_rig.
    on_progress is called with a `Progress`. If is_cancelled returns True, `Cancelled` is raised
    with the result so far as `partial`; a KeyboardInterrupt has it, too, once the first law is
    complete. Raises SaddleringError for input that cannot be used.
    """
    inputs.check_whole('seed', seed, 0)
    inputs.check_bounds({} if bounds is None else bounds)
    for name, value in (('particles', particles), ('iterations', iterations)):
        inputs.check_whole(name, value)
    if stagnation is not None:
        inputs.check_whole('stagnation', stagnation)
    if accuracy is not None:
        inputs.check_number('accuracy', accuracy)
    if settings is None:
        settings = IdentificationSettings(
            method=method, bounds=dict(bounds or {}), logarithmic_stiffness=log_stiffness,
            use_delta_y=use_delta_y, seed=seed, swarm=SwarmSettings(
                particles=particles, iterations=iterations, accuracy=accuracy,
                stagnation=stagnation))
    elif not isinstance(settings, IdentificationSettings):
        raise inputs.ApiError(f'settings is of type {type(settings).__name__}: give '
                              'IdentificationSettings, or None')
    settings.bounds_for(inputs.rig_of((), rig))  # a fault is reported before any bag is read
    given = inputs.inputs_of(bags, rig=rig, trust_rig=trust_rig, on_progress=on_progress,
                             is_cancelled=is_cancelled)
    fitted, _ = inputs.for_fits(given.bags)
    result_of = partial(IdentificationResult, tuple(fitted), given.rig, given.files)
    try:
        answer = methods.identify(runs_of(fitted), given.rig, settings, on_progress=on_progress,
                                  is_cancelled=is_cancelled)
    except Interrupted as stopped:
        raise Interrupted(result_of(stopped.partial)) from None
    if answer.cancelled:
        raise Cancelled('identify: cancelled', result_of(answer))
    return result_of(answer)


def validate(bags: BagLike | Iterable[BagLike], *, parameters: ParametersLike,
             rig: RigLike = None, trust_rig: bool = False, on_progress: OnProgress | None = None,
             is_cancelled: IsCancelled | None = None) -> ValidationResult:
    """Compare a simulation with bags, channel by channel, and the misfit with the noise.

    parameters: a `ParameterSet`, a parameter file, or the result of `identify` or `diagnose`.
    The other arguments are those of `identify`.
    """
    law = inputs.as_parameters(parameters)
    given = inputs.inputs_of(bags, rig=rig, trust_rig=trust_rig, parameters=parameters,
                             on_progress=on_progress, is_cancelled=is_cancelled)
    judged, _ = inputs.for_fits(given.bags)
    answer = validation.validate(
        runs_of(judged), given.rig, law, Watch('validate', on_progress, is_cancelled))
    return ValidationResult(tuple(judged), given.rig, given.files, answer)


def diagnose(bags: BagLike | Iterable[BagLike], *, hold_out: BagLike | Iterable[BagLike] = (),
             rig: RigLike = None, parameters: ParametersLike | None = None, seed: int = 0,
             trust_rig: bool = False, on_progress: OnProgress | None = None,
             is_cancelled: IsCancelled | None = None) -> DiagnosisResult:
    """Name the cause that the simulation lacks for these bags, and measure its misfit reduction.

    hold_out: bags that take no part in the diagnosis; the misfit reduction is measured on them.
    parameters: the start of the fit of the contact law (None: those that `identify` finds). The
    other arguments are those of `identify`.
    """
    inputs.check_whole('seed', seed, 0)
    given = inputs.inputs_of(bags, hold_out=hold_out, rig=rig, trust_rig=trust_rig,
                             parameters=parameters, on_progress=on_progress,
                             is_cancelled=is_cancelled)
    fitted, held_out = inputs.for_fits(given.bags, given.held_out)
    answer = diagnosis.diagnose_ring(
        runs_of(fitted), runs_of(held_out), rig=given.rig, parameters=given.parameters, seed=seed,
        on_progress=on_progress, is_cancelled=is_cancelled)
    return DiagnosisResult((*fitted, *held_out), given.rig, given.files, answer)


def compare(before: BagLike | Iterable[BagLike], after: BagLike | Iterable[BagLike], *,
            between: Sequence[Iterable[BagLike]] = (), rig: RigLike = None, seed: int = 0,
            trust_rig: bool = False, on_progress: OnProgress | None = None,
            is_cancelled: IsCancelled | None = None) -> ComparisonResult:
    """What changed in one ring from the bags of one session to those of a later one.

    What both sessions have (unequal rollers, waviness, errors of the rig file and of the
    simulator, gains of the instruments) is measured by the earlier session and cancels. The
    sessions may have different tests. between: sessions between the two, in order of time; the
    result then has the evidence of the whole series, which may be read after every session. The
    other arguments are those of `diagnose`.
    """
    from saddlering_ros.comparison.change import compare_records

    inputs.check_whole('seed', seed, 0)
    sessions = inputs.sessions_of('between', between)
    given = inputs.inputs_of(before, hold_out=after, rig=rig, trust_rig=trust_rig,
                             on_progress=on_progress, is_cancelled=is_cancelled,
                             names=('before', 'after'))
    both, _ = inputs.for_fits([*given.bags, *given.held_out])
    earlier, later = both[:len(given.bags)], both[len(given.bags):]
    others = [inputs.for_fits(inputs.inputs_of(
        bags, rig=given.rig, trust_rig=trust_rig, on_progress=on_progress,
        is_cancelled=is_cancelled).bags)[0] for bags in sessions]
    change = compare_records(
        runs_of(earlier), runs_of(later), rig=given.rig,
        between=[runs_of(bags) for bags in others], seed=seed,
        on_progress=on_progress, is_cancelled=is_cancelled)
    used = [*earlier, *(bag for bags in others for bag in bags), *later]
    return ComparisonResult(tuple(used), given.rig, given.files, change)


@dataclass(frozen=True, repr=False)
class Curves(inputs.Tabular):
    """The displacement of the ring in one test, sample by sample, as the live nodes give it.

    kind: 'measured', 'simulated' or 'measured minus simulated'; stamp_ns (N,) [ns]; time (N,) [s]
    since the first load of the record; load (N,) [N]; delta_x, delta_y, parity (N,) [m] and gamma
    (N,) [rad], NaN where not known; validity (N,): 0 where all four are known from sound readings;
    notes: what should make a reader doubt the curves.
    """

    bag: Bag
    kind: str
    stamp_ns: NDArray[np.int64]
    time: Array
    load: Array
    delta_x: Array
    delta_y: Array
    gamma: Array
    parity: Array
    validity: NDArray[np.uint8]
    notes: tuple[str, ...]
    provenance: Provenance

    def __len__(self) -> int:
        return len(self.time)

    def summary(self) -> str:
        """The test, the number of samples, and the extent of each channel."""
        lines = [f'{self.bag.name}: {self.kind} at {len(self)} load stamps']
        for name in CHANNELS:
            values = 1e6 * np.asarray(getattr(self, name))
            if np.isfinite(values).any():
                lines.append(f'  {name}: {np.nanmin(values):.2f} to {np.nanmax(values):.2f} '
                             f'{MICRO_UNITS[name]}')
        return '\n'.join([*lines, *(f'note: {note}' for note in self.notes)])

    def columns(self) -> dict[str, NDArray[Any]]:
        """The arrays by name, as the commands write them."""
        return {name: getattr(self, name)
                for name in ('stamp_ns', 'time', 'load', *CHANNELS, 'validity')}

    def save(self, path: Path | str) -> None:
        """Write the table; the suffix selects .csv or .parquet."""
        inputs.check_path('path', path)
        self._spare_bag(Path(path))
        write_samples(Path(path), [self.columns()], self.provenance)

    def plot(self) -> Plot:
        """delta_x, delta_y and gamma over time."""
        from saddlering_ros.report.figures import over_time

        kept = slice(None, None, max(1, len(self) // MAX_DRAWN))
        channels = {name: np.asarray(getattr(self, name))[kept] for name in MOTION}
        title = f'{self.bag.name}: {self.kind}'
        return Plot(over_time(self.time[kept], channels, title), self._spare_bag)

    def _spare_bag(self, output: Path) -> None:
        spare_bags(output, str(output), [(bag_folder(self.bag.path), str(self.bag.path))])


def displacement(bag: BagLike, *, rig: RigLike = None, trust_rig: bool = False,
                 on_progress: OnProgress | None = None,
                 is_cancelled: IsCancelled | None = None) -> Curves:
    """The measured displacement of the ring in a test; the arguments are those of `identify`."""
    return _curves('measured', measured_stretches, bag, None, rig, trust_rig, on_progress,
                   is_cancelled)


def simulate(bag: BagLike, *, parameters: ParametersLike, rig: RigLike = None,
             trust_rig: bool = False, on_progress: OnProgress | None = None,
             is_cancelled: IsCancelled | None = None) -> Curves:
    """The displacement that the model has under the load of a test.

    parameters: a `ParameterSet`, a parameter file, or the result of `identify` or `diagnose`.
    """
    if parameters is None:
        raise inputs.no_parameters(parameters)
    return _curves('simulated', simulated_stretches, bag, parameters, rig, trust_rig,
                   on_progress, is_cancelled)


def residual(bag: BagLike, *, parameters: ParametersLike, rig: RigLike = None,
             trust_rig: bool = False, on_progress: OnProgress | None = None,
             is_cancelled: IsCancelled | None = None) -> Curves:
    """Measured minus simulated displacement of a test; the arguments are those of `simulate`."""
    if parameters is None:
        raise inputs.no_parameters(parameters)
    return _curves('measured minus simulated', residual_stretches, bag, parameters, rig,
                   trust_rig, on_progress, is_cancelled)


def _curves(kind: str, stretches_of: Callable[..., Any], bag: BagLike,
            parameters: ParametersLike | None, rig: RigLike, trust_rig: bool,
            on_progress: OnProgress | None, is_cancelled: IsCancelled | None) -> Curves:
    given = inputs.inputs_of([bag], rig=rig, trust_rig=trust_rig, parameters=parameters,
                             on_progress=on_progress, is_cancelled=is_cancelled)
    of, model = given.bags[0], [] if given.parameters is None else [given.parameters]
    watch = Watch('simulate' if model else 'displacement', on_progress, is_cancelled)
    notes: list[str] = []

    def share_is_done(share: float) -> None:
        watch.check()
        watch.progress(of.name, share)

    stretches, _ = stretches_of(given.rig, of.run, *model, notes, share_is_done)
    columns = displacement_columns(of.run, join(list(stretches)))
    return Curves(of, kind, **columns, notes=(*of.run.notes, *notes),
                  provenance=Provenance((of.run.origin,), given.files))
