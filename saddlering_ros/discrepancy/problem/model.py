"""A declared model: its parameters, channels, causes and runs, and the engine's `System` of it.

Every channel is divided by its range over the fitted runs, so that results do not depend on units.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from saddlering_ros.discrepancy.noise import Noise, noise_of_channel
from saddlering_ros.discrepancy.problem import system
from saddlering_ros.discrepancy.problem.problem import Assumptions
from saddlering_ros.discrepancy.problem.system import Array, DiscrepancyError, Effect, Parameter
from saddlering_ros.errors import counted
from saddlering_ros.estimation.process import ChannelNoise, EstimationError
from saddlering_ros.estimation.record_noise import ChannelRecord
from saddlering_ros.quantities import percent

Outputs = Mapping[str, ArrayLike]

MAX_READING = 1e100
"""Largest reading: the squares of larger ones overflow, and no quantity is as large."""

OUTCOMES = ('none', 'unknown')
"""Names in the probabilities, beside those of effects and of groups, 'a or b'."""


@dataclass(frozen=True)
class Channel:
    """A measured quantity that the simulator predicts.

    offset: 'none' if a constant in the reading is a misfit, 'free' if it has no meaning, or
    the standard deviation of a constant that any such sensor may have [unit]. model_error:
    share of the channel's range by which a sound simulator may be wrong.
    """

    unit: str = ''
    offset: Literal['free', 'none'] | float = 'none'
    noise: Noise = field(default_factory=Noise.unknown)
    model_error: float = 0.0

    def __post_init__(self) -> None:
        system.must_be(Noise, 'channel: noise', self.noise, 'Noise.white(std) or another Noise')
        system.must_be(str, 'channel: unit', self.unit, 'a text')
        numbers = (int, float, np.number)
        is_std = isinstance(self.offset, numbers) and 0.0 <= self.offset < np.inf
        if not is_std and self.offset not in ('free', 'none'):
            raise DiscrepancyError(
                f"channel: offset is {self.offset}: give 'free', 'none' or a standard deviation")
        if not (isinstance(self.model_error, numbers) and 0.0 <= self.model_error < 1.0):
            raise DiscrepancyError(
                f'channel: model_error is {self.model_error}: a share of the range, 0 to 1')


def _numbers(what: str, values: ArrayLike) -> Array:
    """The values as floats, NaN where masked; DiscrepancyError if they are no real numbers."""
    try:
        if np.iscomplexobj(values):
            raise TypeError('they are complex: give their parts as two channels')
        if np.asarray(values).dtype.kind in 'mM':  # As numbers, counts of a unit of their own.
            raise TypeError('they are dates or durations: give numbers, such as '
                            "(time - time[0]) / np.timedelta64(1, 's')")
        if np.ma.isMaskedArray(values):
            return np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan)
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as problem:
        raise DiscrepancyError(f'{what} is no array of numbers: {problem}') from problem


def _usable(values: Any, samples: int) -> object:
    """An input as it is; as an array if it is masked, or a list of a number for each sample."""
    is_course = isinstance(values, list) and len(values) == samples and all(
        isinstance(value, (int, float)) for value in values)
    return _numbers('an input', values) if is_course or np.ma.isMaskedArray(values) else values


@dataclass(frozen=True)
class Run:
    """One record: `outputs` by channel (N,) at `time` (N,), NaN where a sample is missing.

    inputs: data for the simulator; coordinates (N,) by name: quantities that a residual may
    depend on (default: the inputs of the same length).
    """

    name: str
    time: Array
    inputs: Mapping[str, object] = field(default_factory=dict)
    outputs: Mapping[str, Array] = field(default_factory=dict)
    coordinates: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not system.is_name(self.name):
            raise DiscrepancyError(f'run: its name is {self.name!r}: give a text in one line')
        time = _numbers(f'run {self.name}: time', self.time)
        if time.ndim != 1 or time.size < system.MIN_SAMPLES:
            raise DiscrepancyError(f'run {self.name}: time has shape {time.shape}: give one row '
                                   f'of at least {system.MIN_SAMPLES} samples')
        if not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0.0):
            raise DiscrepancyError(f'run {self.name}: time must rise from sample to sample')
        for kind in ('inputs', 'outputs', 'coordinates'):
            if not hasattr(given := getattr(self, kind), 'items'):
                system.must_be(Mapping, f'run {self.name}: {kind}', given,
                               'a mapping from names to values')
        if not len(self.outputs):
            raise DiscrepancyError(f'run {self.name}: no outputs: give at least one channel')
        object.__setattr__(self, 'time', time)
        object.__setattr__(self, 'inputs', {
            name: _usable(values, time.size) for name, values in self.inputs.items()})
        for kind in ('outputs', 'coordinates'):
            arrays = {name: _numbers(f'run {self.name}: {kind} {name}', values)
                      for name, values in getattr(self, kind).items()}
            for name, array in arrays.items():
                if array.shape != time.shape:
                    raise DiscrepancyError(f'run {self.name}: {kind} {name} has shape '
                                           f'{array.shape}, time {time.shape}')
                if kind == 'coordinates' and not np.all(np.isfinite(array)):
                    raise DiscrepancyError(f'run {self.name}: coordinate {name} has a value that '
                                           'is not a number: leave its sample out')
            object.__setattr__(self, kind, arrays)


Simulate = Callable[[dict[str, float], Run], Outputs]
SimulateMany = Callable[[list[dict[str, float]], Run], Sequence[Outputs]]


@dataclass(frozen=True)
class Model:
    """A simulator, its fitted parameters (`base`), possible causes (`effects`), its channels.

    simulate(parameters, run) returns every channel at run.time. The parameters hold the base
    by name and those of every effect as 'effect.parameter', neutral if the effect is not in
    the model. simulate_many(list of parameters, run) replaces `simulate` if it is given.
    time_unit: of run.time, on the page and in sentences.
    """

    simulate: Simulate
    base: Mapping[str, Parameter]
    effects: Mapping[str, Effect] = field(default_factory=dict)
    channels: Mapping[str, Channel] = field(default_factory=dict)
    simulate_many: SimulateMany | None = None
    time_unit: str = ''

    def __post_init__(self) -> None:
        for name, wanted in (('base', Parameter), ('effects', Effect), ('channels', Channel)):
            given, kind = getattr(self, name), wanted.__name__
            system.must_be(Mapping, f'model: {name}', given, f'a mapping from names to {kind}')
            for key, value in given.items():
                if not system.is_name(key) or (
                        wanted is Effect and (key in OUTCOMES or ' or ' in key)):
                    raise DiscrepancyError(f'model: {name} has the name {key!r}: give another one')
                system.must_be(wanted, f'model: {name} {key}', value, f'{kind}(...)')
        system.must_be(str, 'model: time_unit', self.time_unit, 'a text')
        if not self.channels:
            raise DiscrepancyError('model: no channels: declare the quantities that the '
                                   'simulator predicts')
        if not self.base:
            raise DiscrepancyError('model: no base parameters: declare the parameters that are '
                                   'always fitted')
        names = Counter([*self.base, *(
            f'{key}.{name}' for key, effect in self.effects.items()
            for name in (*effect.parameters, *effect.variants[0]))])
        twice = sorted(name for name, count in names.items() if count > 1)
        if twice:
            raise DiscrepancyError(f'model: two parameters are called {", ".join(twice)}: give '
                                   'each its own name')
        titles = [effect.title for effect in self.effects.values()]
        if len({*titles}) < len(titles):
            title = max(titles, key=titles.count)
            raise DiscrepancyError(f'model: two effects have the title {title!r}: give others')
        for key, effect in self.effects.items():
            size = effect.size
            is_never_zero = size.low > 0.0 or size.high < 0.0
            if size.neutral is None and size.scale == 'linear' and is_never_zero:
                raise DiscrepancyError(
                    f'effect {key}: its size {size.name} is never 0 between {size.low:g} and '
                    f'{size.high:g}: give Parameter(..., neutral=) the value at which the effect '
                    'does nothing')
        effects = {key: replace(effect, id=key) for key, effect in self.effects.items()}
        base = {name: replace(parameter, name=name) for name, parameter in self.base.items()}
        object.__setattr__(self, 'effects', effects)
        object.__setattr__(self, 'base', base)

    def neutral(self) -> dict[str, float]:
        """The parameters of every effect that is not in the model."""
        values = {}
        for key, effect in self.effects.items():
            for number, parameter in enumerate(effect.ordered):
                absent = parameter.neutral
                if absent is None:
                    absent = 0.0 if number == 0 else parameter.from_unit(parameter.first_guess)
                values[f'{key}.{parameter.name}'] = absent
            values.update({f'{key}.{name}': value for name, value in effect.variants[0].items()})
        return values


COORDINATE_WAVES = 40
"""Half waves along each coordinate, so that fine ripples such as cogging are seen."""

DIVERGED = 1e6
"""Ranges at which a prediction has diverged: none is near, and its square is finite."""


class ModelSystem:
    """A `System` of a model and the runs to which it is fitted."""

    def __init__(self, model: Model, fitted: Sequence[Run]) -> None:
        self.model = model
        self.channel_names = tuple(model.channels)
        self.base_parameters: tuple[Parameter, ...] = tuple(model.base.values())
        self.effects: tuple[Effect, ...] = tuple(model.effects.values())
        self.scales = np.array([_range(name, fitted) for name in model.channels])
        self.time_unit = model.time_unit
        self.failures: Counter[str] = Counter()
        self.failed_at: dict[str, str] = {}
        self.calls = 0
        self._first: dict[str, _First] = {}
        self._neutral = model.neutral()

    @cached_property
    def views(self) -> Mapping[str, Array]:
        """Each channel by itself."""
        return dict(zip(self.channel_names, np.eye(len(self.channel_names)), strict=True))

    @property
    def units(self) -> Mapping[str, str]:
        return {name: channel.unit for name, channel in self.model.channels.items()}

    def blocks(self, run: Run, *, held_out: bool) -> system.RunBlocks:
        """A run in the form of the engine: shares of range, 0 where a sample is missing."""
        missing = [name for name in self.channel_names if name not in run.outputs]
        if missing:
            raise DiscrepancyError(
                f'run {run.name}: no output {missing[0]}; it has {", ".join(run.outputs)}')
        readings = np.array([run.outputs[name] for name in self.channel_names])
        readings = readings / self.scales[:, None]
        present = np.isfinite(readings)
        for name, there, scale in zip(self.channel_names, present, self.scales, strict=True):
            if there.sum() < system.MIN_SAMPLES:
                number = counted(there.sum(), 'sample that is a number|samples that are numbers')
                raise DiscrepancyError(f'run {run.name}: channel {name} has {number}; give at '
                                       f'least {system.MIN_SAMPLES}')
            values = run.outputs[name]
            wild = np.flatnonzero(np.abs(values - np.median(values[there])) > DIVERGED * scale)
            if wild.size:
                raise DiscrepancyError(
                    f'run {run.name}: channel {name} reads {values[wild[0]]:.3g} at time '
                    f'{run.time[wild[0]]:.6g} (such readings: {wild.size} of {run.time.size}): '
                    'give NaN where a sample is missing')
        coordinates = dict(run.coordinates)
        if not coordinates:  # The inputs that can serve as coordinates.
            inputs = {name: np.asarray(values) for name, values in run.inputs.items()}
            coordinates = {
                name: array.astype(np.float64) for name, array in inputs.items()
                if array.shape == run.time.shape and array.dtype.kind in 'fiu'
                and np.all(np.isfinite(array)) and np.ptp(array) > 0.0}
        # What a simulator writes into a run changes neither the caller's arrays nor the readings.
        own = replace(run, time=run.time.copy(), inputs=system.copied(run.inputs),
                      outputs=system.copied(run.outputs),
                      coordinates=system.copied(run.coordinates))
        # Weight of each sample as a time, at most three times the usual one.
        width = np.gradient(run.time)
        width = np.minimum(width, 3.0 * np.median(width))
        return system.RunBlocks(
            run.name, '', run.time.copy(), width, np.where(present, readings, 0.0), coordinates,
            held_out=held_out, payload=own, present=None if present.all() else present)

    def values(self, point: system.Point) -> dict[str, float]:
        """All parameters by the names that `simulate` uses."""
        values = dict(zip(self.model.base, map(float, point.base), strict=True))
        values.update(self._neutral)
        for effect, own in point.effects.items():
            values.update({f'{effect}.{name}': value for name, value in own.items()})
        return values

    def predict_many(self, run: system.RunBlocks, points: Sequence[system.Point]) -> Array:
        """Channels (B, C, N); NaN at a point at which the simulator failed."""
        source: Run = run.payload
        asked = [self.values(point) for point in points]
        self.calls += len(asked)
        answers = np.full((len(asked), *run.channels.shape), np.nan)
        for number, outputs in enumerate(self._simulated(asked, source)):
            if outputs is None:
                continue
            rows = self._rows(outputs, source)
            if isinstance(rows, str):
                self._lost(source, asked[number], rows)
                continue
            rows = rows / self.scales[:, None]
            if run.present is not None:
                rows = np.where(run.present, rows, 0.0)
            near = np.abs(rows - run.channels) < DIVERGED
            if not near.all():
                why = 'its result is a million ranges off the readings: see to the units' if (
                    np.isfinite(rows).all()) else 'no finite result'
                self._lost(source, asked[number], why, self._where(near, source))
                continue
            answers[number] = rows
            if source.name not in self._first:
                alone = self.model.simulate_many is None
                self._first[source.name] = _First(
                    source, [asked[number]] if alone else asked, 0 if alone else number, rows)
                if (change := self._change(source.name)) > REPEATED:
                    raise DiscrepancyError(
                        CHANGED.format('simulator: it', percent(change), source.name))
        return answers

    def _change(self, name: str) -> float:
        """Largest difference of a new result from the first one of a run, in ranges."""
        first = self._first[name]
        outputs = next(islice(self._simulated(first.asked, first.run), first.number, None))
        rows = 'none' if outputs is None else self._rows(outputs, first.run)
        if isinstance(rows, str):
            return 0.0
        there = np.isfinite(np.array([first.run.outputs[name] for name in self.channel_names]))
        return float(np.abs(rows / self.scales[:, None] - first.rows)[there].max())

    def _where(self, near: np.ndarray, run: Run) -> str:
        """Where a result (C, N) is not finite, and which inputs of the run are not."""
        channel = int(np.argmin(near.all(axis=1)))
        lost = np.flatnonzero(~near[channel])
        inputs = [f'; input {name} has values that are no finite numbers: fill them'
                  for name, values in run.inputs.items() if isinstance(values, np.ndarray)
                  and values.dtype.kind == 'f' and not np.isfinite(values).all()]
        return ''.join([
            f'; {self.channel_names[channel]} in {lost.size} of {run.time.size} samples, from '
            f'time {run.time[lost[0]]:.6g} on', *inputs])

    def nuisances(self, runs: Sequence[system.RunBlocks], point: system.Point) -> list[Array]:
        """No nuisance parameters of its own."""
        return [np.zeros((*run.channels.shape, 0)) for run in runs]

    def assumptions(self) -> Assumptions:
        """Noise, offsets and model error as the channels declare them."""
        channels = self.model.channels.values()
        kinds = {'free': system.FREE_OFFSET, 'none': 0.0}
        return Assumptions(
            learn_noise=self.learn_noise, relearns=True, many_valleys=True,
            offsets=tuple(
                kinds[channel.offset] if isinstance(channel.offset, str)
                else channel.offset / scale
                for channel, scale in zip(channels, self.scales, strict=True)),
            allowed_error=tuple(channel.model_error for channel in channels),
            model_error=None, exact_laws=True,
            coordinate_waves=(COORDINATE_WAVES, COORDINATE_WAVES),
            proposes_law=False)  # Its numbers would be shares of range.

    def learn_noise(
        self, runs: Sequence[system.RunBlocks], residuals: Sequence[Array] | None = None
    ) -> dict[tuple[str, int], ChannelNoise]:
        """The noise of every channel in shares of its range, as declared or learnt."""
        noise: dict[tuple[str, int], ChannelNoise] = {}
        for number, (name, channel) in enumerate(self.model.channels.items()):
            scale = float(self.scales[number])
            readings = [_record(run, number, run.channels[number] * scale) for run in runs]
            left = None if residuals is None else [
                _record(run, number, residual[number] * scale)
                for run, residual in zip(runs, residuals, strict=True)]
            try:
                own = noise_of_channel(channel.noise, readings, left, scale)
            except EstimationError as error:
                raise DiscrepancyError(f'channel {name}: {error}') from None
            for run, record in zip(runs, readings, strict=True):
                whole = own[run.name]
                # Samples at their own rate, not that of the run, are no means of their width.
                if record.time.size < run.time.size:
                    whole = replace(
                        whole, white=0.0, floor=whole.floor + whole.white / record.step)
                noise[run.name, number] = whole.times(1.0 / scale**2)
        return noise

    def _simulated(self, asked: list[dict[str, float]], run: Run) -> Iterator[Outputs | None]:
        """Results of the simulator, None where it raises an error; each holds until the next.

        If a batch fails, each of its points is asked alone.
        """
        together = self.model.simulate_many
        if together is None and len(asked) > 1:
            for one in asked:
                yield from self._simulated([one], run)
            return
        try:
            with np.errstate(all='ignore'):
                answers: list[Outputs | None] = (
                    [self.model.simulate(dict(asked[0]), run)] if together is None
                    else list(together([dict(one) for one in asked], run)))
            if len(answers) != len(asked):
                raise ValueError(f'{len(answers)} answers to {len(asked)} points')
            given = [one for one in answers if isinstance(one, Mapping)]
            if len({tuple(map(_memory, one.values())) for one in given}) < len(given):
                raise ValueError('several points share their arrays')
        except (Exception, SystemExit) as error:  # One that exits loses this point, too.
            if len(asked) > 1:
                for one in asked:
                    yield from self._simulated([one], run)
                return
            words = [*str(error).splitlines(), 'no message'][0]
            self._lost(run, asked[0], f'{type(error).__name__}: {words}', ''.join(
                f'; input {name} has shape {values.shape}, time {run.time.shape}'
                for name, values in run.inputs.items() if isinstance(values, np.ndarray)
                and values.ndim == 1 and values.shape != run.time.shape))
            yield None
            return
        for values, outputs in zip(asked, answers, strict=True):
            if outputs is None and together is not None:
                self._lost(run, values, 'it returned None')
            elif not isinstance(outputs, Mapping):
                raise DiscrepancyError(
                    f'simulator: it returned {type(outputs).__name__} for run {run.name}: return '
                    'a mapping from channel to values')
            yield outputs

    def _rows(self, outputs: Outputs, run: Run) -> Array | str:
        """Channels (C, N) of one result, or the reason why there are none."""
        missing = [name for name in self.channel_names if name not in outputs]
        if missing:
            raise DiscrepancyError(
                f'simulator: no channel {", ".join(missing)} in its result for run {run.name}: '
                'return every declared channel')
        try:
            rows = [_numbers(f'channel {name}', outputs[name]) for name in self.channel_names]
        except DiscrepancyError as error:
            return str(error)
        for name, row in zip(self.channel_names, rows, strict=True):
            if row.shape != run.time.shape:
                return f'channel {name} has shape {row.shape}, time {run.time.shape}'
        return np.array(rows)

    def _lost(self, run: Run, values: Mapping[str, float], why: str, detail: str = '') -> None:
        self.failures[why] += 1
        where = self.failed_at[why] = f'run {run.name} at ' + ', '.join(
            f'{name} = {value:.4g}' for name, value in values.items()
            if value != self._neutral.get(name)) + detail
        if self.failures.total() == self.calls and self.calls >= MAX_LOST:
            raise DiscrepancyError(f'simulator: it failed at all {self.calls} points; the last: '
                                   f'{why}, {where}')

    def failure_sentences(self) -> list[str]:
        """Warnings about a simulator that changed, and the points at which it failed."""
        changes = {name: self._change(name) for name in self._first}
        return [CHANGED.format('since its first call, the simulator', percent(change), name)
                for name, change in changes.items() if change > REPEATED] + [
            f'the simulator failed at {count} of {self.calls} points, which were left out: '
            f'{why}; the last in {self.failed_at[why]}'
            for why, count in self.failures.most_common(3)
        ]


@dataclass(frozen=True)
class _First:
    """The first result (C, N) of a run, in ranges, and the points with which it was asked."""

    run: Run
    asked: list[dict[str, float]]
    number: int
    rows: Array


REPEATED = 1e-5
"""Share of range by which results for the same parameters may differ: single precision."""

CHANGED = (
    '{} gives another result for the same parameters, by {} of range in run {}: let each call '
    'begin from the same state, draw no random numbers, and leave run.inputs unchanged')

MAX_LOST = 25
"""Failed points after which a simulator is abandoned: all starts of the base failed by then."""


def _memory(values: ArrayLike) -> int:
    """Where an array lies in memory: equal for two names of one array."""
    return int(getattr(values, '__array_interface__', {'data': [id(values)]})['data'][0])


def _range(name: str, fitted: Sequence[Run]) -> float:
    """Largest range of a channel in a fitted run. DiscrepancyError if it never varies."""
    seen = [run.outputs[name] for run in fitted if name in run.outputs]
    values = [readings[np.isfinite(readings)] for readings in seen if np.isfinite(readings).any()]
    size = max((float(np.abs(readings).max()) for readings in values), default=0.0)
    span = max((float(np.ptp(readings)) for readings in values), default=0.0)
    if size > MAX_READING or 0.0 < span < 1.0 / MAX_READING:
        raise DiscrepancyError(f'channel {name} has readings up to {size:.3g}: give NaN where a '
                               'sample is missing, or another unit')
    if values and span == 0.0:
        raise DiscrepancyError(
            f'channel {name} does not vary in any fitted run: leave it out of the model, or give '
            'a run in which it moves')
    return span if span > 1e-12 * size else size or 1.0


def _record(run: system.RunBlocks, channel: int, values: Array) -> ChannelRecord:
    """One channel's values with NaN where a sample is missing, or at the channel's own rate."""
    there = np.isfinite(values) if run.present is None else run.present[channel]
    return ChannelRecord(run.name, run.time, np.where(there, values, np.nan)).at_own_rate()
