"""Prediction of given runs by given parameters, channel by channel, compared with the noise.

A dynamic run is compared sample by sample. A static run is compared at its plateaus (settled
samples for rmse and noise floor, plateau means for the shape figures), because the load moves
faster in between than the recorder samples.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from saddlering_ros import quantities
from saddlering_ros.errors import BagError
from saddlering_ros.estimation.noise import LEVEL_REACH, noise_alone, noise_by_class, RestSource
from saddlering_ros.estimation.process import Array, ChannelNoise, EstimationError, TIME_CONSTANTS
from saddlering_ros.estimation.rest import RestSegment, Stretches, stretches_at_rest
from saddlering_ros.files import Provenance
from saddlering_ros.identification.figures import channel_figures, ChannelFigures, RunValidation
from saddlering_ros.identification.prepared import MIN_REST, parity_at_rest
from saddlering_ros.identification.settings import IdentificationError
from saddlering_ros.identification.uncertainty import undetermined_words
from saddlering_ros.progress import Watch
from saddlering_ros.record.displacement import displacement_of_run, MeasuredRun
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.record.record import Record
from saddlering_ros.rig import CHANNELS, PARAMETER_NAMES, PARAMETER_UNITS, ParameterSet, Rig
from saddlering_ros.rig.geometry import MOTION
from saddlering_ros.ring.sensitivity import static_sensitivities
from saddlering_ros.ring.simulator import simulate, static_response
from saddlering_ros.ring.small_errors import sound_deviation

HARDLY_MOVES = ('noise is more than a tenth of the measured or the simulated motion in {}: '
                'figures of the curve that say nothing are left out; load the ring further')
"""The note on channels whose curves cannot be compared in full."""


@dataclass(frozen=True)
class Validation:
    """All runs of a validation."""

    runs: tuple[RunValidation, ...]
    parameters: ParameterSet

    def to_json(self) -> dict[str, Any]:
        """`runs` in the form of diagnose --json, each channel with all its figures."""
        contact = self.parameters.contact
        return {
            'runs': [{**run.to_json(), 'held_out': self.is_held_out(run.name)}
                     for run in self.runs],
            'parameters': {name: float(getattr(contact, name)) for name in PARAMETER_NAMES},
            'undetermined': dict(self.parameters.source.undetermined),
            'provenance': Provenance(tuple(run.origin for run in self.runs)).as_dict()}

    def is_held_out(self, path: Path | str) -> bool:
        """Whether the parameters come without this bag, which its name tells."""
        return Path(path).name not in {Path(bag).name for bag in self.parameters.source.bags}


def validate(runs: Sequence[Record], rig: Rig, parameters: ParameterSet,
             watch: Watch | None = None) -> Validation:
    """Compare simulation and measurement; IdentificationError if a run cannot be compared."""
    if not runs:
        raise IdentificationError('no runs to validate on: give at least one bag')
    compared, watch = [], watch or Watch('validate')
    for number, run in enumerate(runs):
        watch.check()
        watch.progress(run.name, number / len(runs))
        compared.append(_compare(run, rig, parameters))
    judged = []
    for one, noise in zip(compared, _noise_of(compared), strict=True):
        seen, zero = one.run, one.measured.zero
        variance = _input_variance(rig, parameters, seen, zero.load)
        sound = np.append(sound_deviation(
            rig, parameters.contact.to_array(), seen.elevation, seen.load[seen.compared],
            zero.load), 0.0)
        lasting = one.interval * max(1, zero.end - zero.start)
        for row, (channel, process) in enumerate(zip(one.channels, noise, strict=True)):
            seen.channels[channel] = channel_figures(
                seen, row, one.rests, process, one.interval, lasting, variance[row],
                float(sound[row]))
        still = [name for name in MOTION if seen.channels[name].slope_ratio is None]
        judged.append(replace(seen, notes=(*seen.notes, HARDLY_MOVES.format(', '.join(still)))
                              ) if still else seen)
    watch.progress(runs[-1].name, 1.0)
    return Validation(tuple(judged), parameters)


@dataclass(frozen=True)
class _Comparison:
    """A run beside its simulation, without figures."""

    run: RunValidation
    measured: MeasuredRun
    rests: Stretches  # its stretches at rest
    channels: tuple[str, ...]  # measured: no parity if a radial probe is absent

    @property
    def interval(self) -> float:
        """Usual spacing of the samples [s]."""
        return float(np.median(np.diff(self.run.time)))

    def at_rest(self) -> RestSource:
        """Sources of the noise of the channels: the residual at rest, and the parity."""
        rows = slice(len(self.channels))
        residual = self.run.measured[rows] - self.run.simulated[rows]
        segments = [residual[:, start:stop] for start, stop in self.rests]
        segments = [values[:, np.all(np.isfinite(values), axis=0)] for values in segments]
        segments = [values for values in segments if values.shape[1] >= MIN_REST]
        parity = parity_at_rest(self.measured)
        return RestSource.beside(
            [RestSegment(values, self.interval) for values in segments],
            [RestSegment(parity[None, :], self.interval)], [parity[a:b] for a, b in self.rests])


def _noise_of(compared: Sequence[_Comparison]) -> list[list[ChannelNoise]]:
    """Noise of the channels of each run.

    Runs whose parity is noise alone share their knowledge of slow noise. In other runs the
    misfit of the model may move a channel at rest, so that each run has its own noise.
    """
    sources = [one.at_rest() for one in compared]
    rows = range(len(compared[0].channels))
    still = {number: source for number, source in enumerate(sources)
             if source.ratios is not None and source.is_usable}
    learnt = noise_by_class(still, len(rows), LEVEL_REACH) if still else {}
    answers = []
    for number, source in enumerate(sources):
        if number in learnt:
            answers.append(learnt[number])
            continue
        # From its rests alone; none if they are too short.
        step = source.segments[0].step if source.segments else 1.0
        try:
            answers.append([
                noise_alone([segment.values[row] for segment in source.segments], step)
                for row in rows])
        except EstimationError:
            quiet = ChannelNoise(0.0, np.zeros(TIME_CONSTANTS.size), 0.0, 1)
            answers.append([quiet] * len(rows))
    return answers


def _compare(run: Record, rig: Rig, parameters: ParameterSet) -> _Comparison:
    name, run = str(run.path), run.without_spikes()
    try:
        measured = displacement_of_run(rig, run)
        levels = plateaus(run) if run.test == 'static' else None
    except BagError as problem:
        raise IdentificationError(str(problem)) from problem
    out = simulate(rig, parameters, run.elevation, measured.time, measured.load)
    actual, simulated = measured.displacement.channels, out.displacement.channels
    if not np.array_equal(out.time, measured.time):
        simulated = np.stack([np.interp(measured.time, out.time, row, left=np.nan, right=np.nan)
                              for row in simulated])
    channels = CHANNELS[:-1] if rig.probes.absent else CHANNELS
    compared = np.all(np.isfinite(actual + simulated)[:len(channels)], axis=0)
    if levels is None:
        rests = stretches_at_rest(measured.time, measured.load, rig.limits.rest_band)
        rests = rests or [(measured.zero.start, measured.zero.end)]
    else:
        rests = list(zip(levels.start.tolist(), levels.stop.tolist(), strict=True))
        inside = np.zeros(len(measured.time), dtype=bool)
        for start, stop in rests:
            inside[start:stop] = True
        compared &= inside
    if np.count_nonzero(compared) < 5:  # a zero, a slope and a loop take four
        raise IdentificationError(
            f'{name}: fewer than 5 samples can be compared: check that load and probes overlap')
    result = RunValidation(
        name=name, test=run.test, elevation=float(run.elevation), channels={}, time=measured.time,
        load=measured.load, measured=actual, simulated=simulated, compared=compared,
        notes=tuple(run.notes), origin=run.origin)
    return _Comparison(result, measured, rests, channels)


def _input_variance(rig: Rig, parameters: ParameterSet, run: RunValidation,
                    zero_load: float) -> Array:
    """Mean square uncertainty (4,) of the prediction from the parameters' covariance.

    From static sensitivities at about 25 loads of the run; zero where no covariance is given.
    """
    covariance = parameters.source.covariance
    variance = np.zeros(len(CHANNELS))
    if covariance is None or not np.all(np.isfinite(covariance)):
        return variance
    contact = parameters.contact.to_array()
    loads = np.quantile(run.load[run.compared], np.linspace(0.0, 1.0, 25))
    still = static_response(rig, contact, run.elevation, np.append(loads, zero_load))
    slopes = static_sensitivities(rig, contact, run.elevation, still)
    slopes = slopes[:, :, :-1] - slopes[:, :, -1:]
    determined = [PARAMETER_NAMES.index(name) for name in ('K1', 'n1', 'K2', 'n2')]
    inner = covariance[np.ix_(determined, determined)]
    spread = np.einsum('icl,ij,jcl->cl', slopes[determined], inner, slopes[determined])
    variance[:3] = np.mean(np.maximum(spread, 0.0), axis=1)
    return variance


@dataclass(frozen=True)
class Criterion:
    """A judged criterion: its demand, whether it is met, and its worst run and channel."""

    id: str
    words: str
    is_met: bool
    value: float  # in `unit`
    limit: float  # in `unit`
    unit: str
    bag: str  # where value over limit (or limit over value, if more is better) is largest
    channel: str
    undetermined: tuple[str, ...] = ()  # parameters that the value depends on

    @property
    def doubt(self) -> str:
        """What its failure may come from beside the ring, in words; '' for nothing."""
        return '' if self.is_met or not self.undetermined else (
            f'; it depends on {", ".join(self.undetermined)}, not determined '
            'by the data of the parameter file')

    @property
    def line(self) -> str:
        """'passed  rms misfit ...: worst delta_x of static_50, 0.31 % against 0.42 %'."""
        return (f'{"passed" if self.is_met else "FAILED"}  {self.words}: worst {self.channel} of '
                f'{self.bag}, {self.with_unit(self.value)} against {self.with_unit(self.limit)}'
                f'{self.doubt}')

    def with_unit(self, value: float) -> str:
        if self.unit == 'm':
            return quantities.quantity(value, self.unit)
        return quantities.percent(value, 3) if self.id == 'misfit' else quantities.compact(value)


def judge(runs: Sequence[RunValidation],
          undetermined: Collection[str] = ()) -> tuple[Criterion, ...]:
    """Every criterion for which these runs have figures, at its worst run and channel.

    undetermined: parameters that the data of the parameter file leave open.
    """
    good, error, rating = quantities.GOOD, quantities.MAX_COMPARISON_ERROR, quantities.MIN_RATING
    # Id, words, unit, channels, and what gives value and limit of a channel's figures.
    asked: tuple[tuple[str, str, str, Sequence[str], Callable[
        [ChannelFigures], tuple[float | None, float]]], ...] = (
        ('misfit', f'rms misfit at most {good:g} x noise and small errors of a sound ring, or '
         f'{100.0 * quantities.MATERIAL:g} % of range', '1', MOTION,
         lambda seen: (seen.nrmse, quantities.allowed_misfit(seen.noise_floor, seen.sound))),
        ('comparison_error', f'comparison error E at most {error:g} x its uncertainty u_val (ASME '
         'V&V 20)', '1', MOTION, lambda seen: (seen.e_over_uval, error)),
        ('iso18571', f'ISO 18571 rating at least {rating:g} (good)', '1', MOTION,
         lambda seen: (seen.iso18571, rating)),
        ('parity', f'parity at most {good:g} x noise (rigid ring, sound probes)', 'm',
         ('parity',), lambda seen: (seen.rmse, good * (seen.noise_floor or 0.0) * seen.range)))
    criteria = []
    for name, words, unit, channels, figures_of in asked:
        cases = []
        for run in runs:
            for channel in (one for one in channels if one in run.channels):
                value, limit = figures_of(run.channels[channel])
                if value is not None:
                    low, high = (value, limit) if name == 'iso18571' else (limit, value)
                    cases.append((high / max(low, 1e-300), value, limit, run.name, channel))
        if cases:
            over, value, limit, bag, channel = max(cases)
            is_static = all(run.test == 'static' for run in runs if run.name == bag)
            criteria.append(Criterion(
                name, words, over <= 1.0, value, limit, unit, bag.rstrip('/').rsplit('/', 1)[-1],
                channel, tuple(one for one in undetermined if name != 'parity'
                               and not (is_static and one.startswith('D')))))
    return tuple(criteria)


class Column(NamedTuple):
    """A column of the table of a validation: figure, title, factor of its unit, and content."""

    key: str
    title: str
    scale: float
    words: str


COLUMNS = (
    Column('rmse', 'rmse', 1e6,
           'rms of measured minus simulated, without the zero error, in µm or µrad'),
    Column('nrmse', 'nrmse %', 100.0, "rmse in % of the channel's measured range"),
    Column('noise_floor', 'noise %', 100.0, 'rms noise of the measurement in % of the same range'),
    Column('sound', 'sound %', 100.0,
           'rms that unequal rollers, clearances within 1 µm and a weight within 2 % may add in a '
           'sound ring, in % of the same range'),
    Column('maximum', 'max', 1e6,
           'largest difference, in a static test of a plateau, in µm or µrad'),
    Column('bias', 'bias', 1e6, 'mean of measured minus simulated, in µm or µrad'),
    Column('zero_error', 'zero', 1e6,
           'part of the bias that the noise of the zero explains, in µm or µrad'),
    Column('slope_ratio', 'slope', 1.0,
           'slope of measured over simulated; 1 if the stiffness is right'),
    Column('loop_area', 'loop %', 100.0,
           'area of the measured loop over load minus that of the simulated loop, in % of '
           'load range times channel range; shows friction and damping'),
    Column('zero_return', 'return', 1e6,
           'measured minus simulated at the end of the test, in µm or µrad'),
    Column('time_shift', 'shift ms', 1e3,
           'delay of the measurement after the simulation; dynamic tests only'),
    Column('iso18571', 'ISO', 1.0, 'overall rating of the curve after ISO 18571, 0 to 1'),
    Column('e_over_uval', 'E/u_val', 1.0,
           'comparison error over validation uncertainty after ASME V&V 20'))
"""The table of a validation."""


def validation_text(validation: Validation) -> str:
    """A table with a line per run and channel, its columns explained, and every criterion."""
    widths = [max(9, len(column.title)) for column in COLUMNS]
    head = f'{"channel":8s}  ' + '  '.join(
        column.title.rjust(width) for column, width in zip(COLUMNS, widths, strict=True))
    lines = []
    for run in validation.runs:
        lines += [f'{run.name}: {run.test}, {np.degrees(run.elevation):g} deg', f'  {head}']
        for channel, figures in run.channels.items():
            values = [getattr(figures, column.key) for column in COLUMNS]
            cells = [
                '-' if value is None or not np.isfinite(value)
                else quantities.significant(column.scale * value, 4)
                for column, value in zip(COLUMNS, values, strict=True)]
            lines.append(f'  {channel:8s}  ' + '  '.join(
                cell.rjust(width) for cell, width in zip(cells, widths, strict=True)))
        lines += [f'  note: {note}' for note in run.notes]
    contact, source = validation.parameters.contact, validation.parameters.source
    lines += [''] if source.undetermined else []
    for name, reason in source.undetermined.items():
        value = quantities.quantity(getattr(contact, name), PARAMETER_UNITS[name])
        lines.append(undetermined_words(name, value, reason))
    lines += ['', 'columns:', *(f'  {column.title:9s}  {column.words}' for column in COLUMNS)]
    lines += ['', 'criteria:', *(f'  {criterion.line}' for criterion in judge(
        validation.runs, source.undetermined))]
    return '\n'.join(lines)
