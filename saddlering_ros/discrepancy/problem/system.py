"""Inputs of the engine: parameters, effects, runs, the simulator, and the strictness."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, product
import math
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import counted, SaddleringError
from saddlering_ros.estimation.rest import RestSegment
from saddlering_ros.quantities import CHANCE, MATERIAL, WIDTH_95

Array = NDArray[np.float64]
EffectValues = Mapping[str, Mapping[str, float]]


class DiscrepancyError(SaddleringError):
    """Runs or a simulator that the engine cannot use."""


def must_be(kind: type | tuple[type, ...], what: str, given: object, words: str) -> None:
    """DiscrepancyError if a declared value is of another kind."""
    if not isinstance(given, kind):
        shown = repr(given) if isinstance(given, (str, tuple, int, float, type(None))) else (
            f'a {type(given).__name__}')
        raise DiscrepancyError(f'{what} is {shown}: give {words}')


def is_name(value: object) -> bool:
    """Whether a value is a text that fits into a line."""
    return isinstance(value, str) and bool(value) and value.isprintable()


def copied(given: Mapping[str, Any]) -> dict[str, Any]:
    """The same values, with arrays of their own."""
    return {name: values.copy() if isinstance(values, np.ndarray) else values
            for name, values in given.items()}


MIN_SENSITIVITY = 12.0**0.5
"""Change of the residual by the whole range of a parameter, in standard deviations of the noise,
below which it is not determined: its bounds alone, if all values between them are as likely, have
as small a standard deviation."""


@dataclass(frozen=True)
class Parameter:
    """A fitted number, searched between `low` and `high` on a linear or logarithmic scale.

    start: first guess (default: the middle); neutral: the value at which an effect of this
    size does nothing (default: 0), or the natural end of a shape; step: share of the range by
    which sensitivities are differenced; periodic: `high` equals `low`, as for an angle;
    limiting_case: values of a shape at which the effect is another one, or none; whole: the bound
    of a size that nature sets, such as a share of 1, where a size at any other bound is no name.
    The name comes from the mapping that holds the parameter.
    """

    low: float
    high: float
    unit: str = ''
    start: float | None = None
    scale: Literal['linear', 'log'] = 'linear'
    neutral: float | None = None
    step: float = 2e-3
    periodic: bool = False
    limiting_case: float | tuple[float, ...] | None = None
    whole: float | None = None
    name: str = ''

    def __post_init__(self) -> None:
        label = f'parameter {self.name}'.rstrip()
        numbers = (int, float, np.number)
        are_numbers = isinstance(self.low, numbers) and isinstance(self.high, numbers)
        if not (are_numbers and -math.inf < self.low < self.high < math.inf):
            raise DiscrepancyError(f'{label}: low must be below high, and both finite, not '
                                   f'{self.low!r} and {self.high!r}')
        must_be(str, f'{label}: unit', self.unit, 'a text')
        for what in ('start', 'neutral', 'whole'):
            must_be((*numbers, type(None)), f'{label}: {what}', getattr(self, what), 'a number')
        for value in self.limiting_cases:
            must_be(numbers, f'{label}: limiting_case', value, 'a number, or a tuple of them')
        if self.scale not in ('linear', 'log'):
            raise DiscrepancyError(f'{label}: scale is {self.scale!r}: give linear or log')
        if self.scale == 'log' and self.low <= 0.0:
            raise DiscrepancyError(f'{label}: a log scale needs a low above zero')
        if not (self.periodic or self.start is None or self.low <= self.start <= self.high):
            raise DiscrepancyError(
                f'{label}: start {self.start:g} is outside {self.low:g} to {self.high:g}')

    @classmethod
    def angle(cls, unit: str = 'rad', start: float | None = None) -> Parameter:
        """An angle or phase of any value; a full turn returns to the start."""
        if unit not in ('rad', 'deg'):
            raise DiscrepancyError(f'parameter: the unit of an angle is {unit!r}: give rad or deg')
        turn = 360.0 if unit == 'deg' else 2.0 * math.pi
        return cls(0.0, turn, unit=unit, start=start, periodic=True)

    def to_unit(self, value: float) -> float:
        """Bound-scaled coordinate of `value`, 0 to 1."""
        if self.scale == 'log':
            value = max(value, self.low * 1e-3)
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def from_unit(self, coordinate: float) -> float:
        """Value at a bound-scaled coordinate."""
        if self.scale == 'log':
            return float(self.low * (self.high / self.low) ** coordinate)
        if self.periodic:
            coordinate %= 1.0
        return float(self.low + coordinate * (self.high - self.low))

    def slope(self, coordinate: float) -> float:
        """Derivative of the value by its coordinate, which converts a standard error to units."""
        if self.scale == 'log':
            return self.from_unit(coordinate) * math.log(self.high / self.low)
        return self.high - self.low

    def is_determined(self, value: float, std: float) -> bool:
        """Whether an estimate says more than the bounds."""
        return MIN_SENSITIVITY * std < self.slope(self.to_unit(value))

    @property
    def first_guess(self) -> float:
        """Bound-scaled coordinate of the start (default: the middle)."""
        return 0.5 if self.start is None else self.to_unit(self.start)

    @property
    def limiting_cases(self) -> tuple[float, ...]:
        """Values of a shape at which the effect is another one, or none."""
        one = self.limiting_case
        return () if one is None else one if isinstance(one, tuple) else (one,)


@dataclass(frozen=True)
class Estimate:
    """A fitted number with its standard deviation."""

    value: float
    std: float
    unit: str

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval; None for a chosen value, which is not fitted."""
        if not self.std:
            return None
        half = WIDTH_95 * self.std
        return self.value - half, self.value + half


SIZES, SHAPES, MAX_SHAPES = (0.03, 0.15, 0.6), (0.15, 0.85), 16
"""Sizes tried of an effect without starts, as shares of its reach, shapes as shares of their
range, and the largest number of combinations of shapes. The sizes are a factor of four to five
apart, so that one of them is near any true size."""

FAR = 0.9
"""A further size of a limit, which does nothing over much of its reach."""


@dataclass(frozen=True)
class Effect:
    """One possible cause. Its first parameter is its size, at whose neutral value it does nothing.

    `variants`: discrete choices of one cause, such as which of four sensors; each is a set of
    fixed values beside the fitted ones. `starts`: first guesses for the screening (default:
    several sizes and shapes between the bounds).

    `line`: the channels of each variant of a steady line, which is searched in stretches at
    rest and not fitted; its parameters are cosine, sine and frequency [Hz].

    `form`: standard deviation of the size, as a share, because the law is idealised; no
    residual shows it. The id comes from the mapping that holds the effect; an effect without
    an id is named by its title.

    `first_variant`: variants before it belong to an effect of the same id with fewer
    parameters, of which this one is a wider form. `contains`: effects of other ids that this
    one can imitate completely, so that it is no alternative to them.
    """

    title: str
    parameters: Mapping[str, Parameter]
    variants: tuple[Mapping[str, float], ...] = ({},)
    starts: tuple[Mapping[str, float], ...] = ()
    settled_by: str = ''
    line: tuple[tuple[int, ...], ...] = ()
    form: float = 0.0
    id: str = ''
    first_variant: int = 0
    contains: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not is_name(self.title):
            raise DiscrepancyError(f'effect: its title is {self.title!r}: give a text in one line')
        given = self.parameters
        if not (given and isinstance(given, Mapping)
                and all(is_name(name) and isinstance(one, Parameter)
                        for name, one in given.items())):
            raise DiscrepancyError(f'effect {self.title}: declare at least one parameter, the '
                                   'size, in a mapping from names to Parameter')
        for what in ('variants', 'starts'):
            for one in getattr(self, what):
                must_be(Mapping, f'effect {self.title}: one of its {what}', one,
                        'a mapping from names to values')
        if not self.id:
            object.__setattr__(self, 'id', self.title)
        for start in self.starts:
            unknown = [name for name in start if name not in self.parameters]
            if unknown:
                raise DiscrepancyError(f'effect {self.id}: a start names {", ".join(unknown)}, '
                                       f'which are not among {", ".join(self.parameters)}')

    def overlaps(self, other: Effect) -> bool:
        """Whether it is the other effect, or one of the two laws contains the other."""
        return self.id == other.id or self.id in other.contains or other.id in self.contains

    @cached_property
    def ordered(self) -> tuple[Parameter, ...]:
        """The parameters with their names, the size first."""
        return tuple(replace(parameter, name=name) for name, parameter in self.parameters.items())

    @property
    def size(self) -> Parameter:
        return self.ordered[0]

    @property
    def neutral(self) -> float:
        """Size at which the effect does nothing."""
        return 0.0 if self.size.neutral is None else self.size.neutral

    @property
    def can_be_small(self) -> bool:
        """Whether its sizes reach to the one at which it does nothing."""
        return self.size.low <= self.neutral <= self.size.high

    @property
    def one_sided(self) -> bool:
        return self.size.low >= self.neutral or self.size.high <= self.neutral

    @cached_property
    def first_guesses(self) -> list[Array]:
        """First guesses of the parameters, bound-scaled: as declared, or several of each."""
        if self.starts:
            return [np.array([
                one.to_unit(start[one.name]) if one.name in start else one.first_guess
                for one in self.ordered]) for start in self.starts]
        # Sizes on both sides of the neutral one, with the usual shape.
        size, sizes = self.size, [0.2, 0.5, 0.8]
        if size.scale != 'log':
            origin = min(max(self.neutral, size.low), size.high)
            sizes = [size.to_unit(origin + part * (end - origin)) for end in (size.high, size.low)
                     if end != origin
                     for part in (SIZES if size.neutral is None else (*SIZES, FAR))]
        shapes = self.ordered[1:]
        usual = [shape.first_guess for shape in shapes]
        # Other shapes of a middle size: all combinations of a few, or one parameter at a time.
        choices = [
            [(u + turn) % 1.0 for turn in (0.0, 0.25, 0.5, 0.75)]
            if shape.periodic else [u, *SHAPES] for shape, u in zip(shapes, usual, strict=True)]
        others = [[*usual[:number], value, *usual[number + 1 :]]
                  for number, values in enumerate(choices) for value in values]
        if np.prod([len(choice) for choice in choices]) <= MAX_SHAPES:
            others = [list(choice) for choice in product(*choices)]
        return [np.array([one, *usual]) for one in sizes] + [
            np.array([sizes[len(SIZES) // 2], *other]) for other in others if other != usual]


@dataclass(frozen=True)
class Point:
    """Input of one simulation: base values in order, and effects by id."""

    base: Array
    effects: EffectValues = field(default_factory=dict)


MIN_SAMPLES = 8
"""Smallest number of samples of a run: fewer cannot hold a trend, an offset and noise."""


@dataclass(frozen=True)
class RunBlocks:
    """One run: `channels` (C, N) are means over `width` (N,) about `time`.

    `group` names runs under one setting, which share their systematic model error. `inputs` are
    the coordinates that a residual may depend on, the first being the drive. Optional properties
    (N,) of the drive: `direction`, 1 while it rises and -1 while it falls; `rate` [unit / s];
    `hold`, the number of the level at which it is held. `payload` is for the simulator alone.
    `present` (C, N), if given, is false where a sample is missing; the channel is 0 there.
    """

    name: str
    group: str
    time: Array
    width: Array
    channels: Array
    inputs: Mapping[str, Array]
    rest: tuple[RestSegment, ...] = ()
    held_out: bool = False
    payload: Any = None
    present: NDArray[np.bool_] | None = None
    direction: Array | None = None
    rate: Array | None = None
    hold: Array | None = None

    @property
    def coordinates(self) -> dict[str, Array]:
        """Inputs and, if it is given, the rate of the drive."""
        return {**self.inputs, **({} if self.rate is None else {'rate': self.rate})}

    def __post_init__(self) -> None:
        if self.channels.ndim != 2 or self.channels.shape[1] != self.time.size:
            raise DiscrepancyError(f'run {self.name}: channels have shape {self.channels.shape}: '
                                   f'give (C, {self.time.size})')
        if self.time.size < MIN_SAMPLES:
            raise DiscrepancyError(f'run {self.name}: {counted(self.time.size, "sample")}, too '
                                   f'few: give at least {MIN_SAMPLES}')
        if not np.isfinite(self.channels).all():
            raise DiscrepancyError(f'run {self.name}: a channel has a value that is not a number: '
                                   'leave its sample out')


@dataclass(frozen=True)
class Reading:
    """A direct measurement of the size of an effect, with its standard deviation."""

    effect: str
    std: float


@dataclass(frozen=True)
class Proposal:
    """A possible test: its sentence, and a run with empty channels.

    kind: the kind of test; as_made: how the effects act in it, if not as before; readings:
    quantities that are measured directly; is_other_place: whether other units of the machine
    carry the load, so that small errors of the units in the old data do not apply.
    """

    sentence: str
    run: RunBlocks
    kind: str = ''
    as_made: Callable[[Point], Point] | None = field(default=None, compare=False)
    readings: tuple[Reading, ...] = ()
    is_other_place: bool = False


class System(Protocol):
    """A simulator with its base parameters and the causes that it could lack.

    A simulator whose inputs may be wrong, such as the dimensions in a file, has their errors as
    effects in `inputs` too, as possible causes where something is wrong. `units`, if it has them,
    are the units of the views by name, and `told` effects, variants and sizes that runs show.
    """

    @property
    def channel_names(self) -> tuple[str, ...]: ...

    @property
    def base_parameters(self) -> tuple[Parameter, ...]: ...

    @property
    def effects(self) -> tuple[Effect, ...]: ...

    @property
    def views(self) -> Mapping[str, Array]:
        """Combinations of channels for people: name to weights (C,)."""
        ...

    def predict_many(self, run: RunBlocks, points: Sequence[Point]) -> Array:
        """Channels (B, C, N) of `run` for every point; a constant per channel has no meaning."""
        ...

    def nuisances(self, runs: Sequence[RunBlocks], point: Point) -> Sequence[Array]:
        """Errors of any such system that are no cause: per run columns (C, N, k), with equal k.

        Each column is one standard deviation of one nuisance parameter at `point` (base values and
        found effects), shared by all runs. k = 0 for a simulator that is exact but for its causes.
        """
        ...


Neighbourhood = Callable[[RunBlocks], list[Array]]
"""Channels (B, C, N) of a run for every group of points, which are prepared once for all runs."""


@runtime_checkable
class SystemWithTangents(Protocol):
    """A `System` with sensitivities that are cheaper than a simulation per parameter."""

    def neighbourhood(self, groups: Sequence[Sequence[Point]]) -> Neighbourhood:
        """The groups, prepared for any run.

        The first point of a group is simulated. The others lie a small step away and need
        first-order accuracy only.
        """
        ...


@dataclass(frozen=True)
class Settings:
    """Strictness of a diagnosis. The values were chosen before the blind trials that check them.

    error_rate: chance of a false cause on clean data; materiality: share of a channel's range
    below which a finding is only listed; max_causes: largest number of causes; refits: candidates
    refitted at each step; min_partial: share of the remaining misfit that a member of a model must
    explain, in all or in one channel; min_total: share of the misfit that all causes together must
    explain to be named; alternative_rate: chance that noise alone puts the true cause so far
    behind an alternative that it leaves the group; alternative_share: an alternative stays in the
    group while its additional misfit is within this share of the residual; form_error: share of
    the misfit explained by an effect that its simplified law may leave: prior of the forms of a
    law, and misfit within which alternatives stay in the group; rounds: least-squares rounds of
    each candidate; max_rounds: least-squares rounds of the fits behind the verdict;
    nearly_all_times: size over the spread of small errors from which a cause stands out that takes
    85 % of what others leave; seed: of random starts.
    """

    error_rate: float = CHANCE
    materiality: float = MATERIAL
    max_causes: int = 3
    refits: int = 6
    min_partial: float = 0.5
    min_total: float = 0.85
    alternative_rate: float = 1e-4
    alternative_share: float = 0.33
    form_error: float = 0.1
    rounds: int = 8
    max_rounds: int = 60
    nearly_all_times: float = 20.0
    seed: int = 0


FREE_OFFSET = 1e7
"""Spread of a free constant, in ranges: an absolute pressure can be far from a simulated one, and
a constant of 1500 ranges with a spread of ten hid a cause."""


@dataclass(frozen=True)
class ModelErrorPrior:
    """Smooth error of the simulator that is no finding, as a share of range.

    smooth: over the drive; loop: with its direction; rate: at the fastest change of the drive.
    instants [s]: uncertainty of the time of a channel against the drive, per run.
    """

    smooth: float = 3e-4
    loop: float = 1e-4
    rate: float = 1.5e-3
    degree: int = 4
    instants: float = 7e-4


MIN_SHARED, MIN_SHARED_PART = 8, 0.1
"""Two runs share content if they share so many samples bit for bit, and this part of the shorter
run. Noise does not repeat in eight samples by chance."""


def refuse_repeats(runs: Sequence[RunBlocks]) -> None:
    """Refuse the same name or the same content twice: no run is both fitted and held out."""
    for other, run in combinations(runs, 2):
        if _shares_content(run.channels, other.channels):
            same = run.channels.shape == other.channels.shape
            how = 'are the same recording' if same else 'share a part of a recording'
            what = 'one is held out' if run.held_out != other.held_out else 'it counts once'
            raise DiscrepancyError(
                f'runs {other.name} and {run.name} {how}: give it once ({what})')
        if run.name == other.name:
            raise DiscrepancyError(f'two runs are called {run.name}: give each its own name')


def _shares_content(one: Array, other: Array) -> bool:
    """Whether a stretch of one run (C, N) is a stretch of the other, bit for bit.

    One run then contains the other, or begins in it and continues beyond its end.
    """
    least = max(MIN_SHARED, round(MIN_SHARED_PART * min(one.shape[1], other.shape[1])))
    for first, second in ((one, other), (other, one)):
        for begin in np.flatnonzero((first == second[:, :1]).all(axis=0)):
            length = min(first.shape[1] - int(begin), second.shape[1])
            is_same = length >= least and all(
                np.array_equal(first[:, begin : begin + end], second[:, :end])
                for end in (MIN_SHARED, length))
            if is_same and np.ptp(second[:, :length], axis=1).any():
                return True
    return False


MAX_SPREADS = 2.5
"""Largest nuisance parameter in standard deviations: 1 % of normal numbers are larger."""

FREE_STRENGTH = 1e3
"""Size of a nuisance parameter over noise that is free: the prior adds a millionth."""

JITTER = 1e-6
"""Noise added to every sample, as a share of the widest range: rounding of the simulator."""
