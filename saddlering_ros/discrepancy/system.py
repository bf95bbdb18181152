"""What the engine is told: parameters, effects, runs and the simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import SaddleringError

Array = NDArray[np.float64]
EffectValues = Mapping[str, Mapping[str, float]]


class DiscrepancyError(SaddleringError):
    """Runs or a simulator the engine cannot work with."""


@dataclass(frozen=True)
class Parameter:
    """A number that may be fitted, searched between `low` and `high` on a straight or log scale.

    `step` is the share of the range by which sensitivities are differenced.
    """

    name: str
    low: float
    high: float
    start: float | None = None
    scale: Literal['linear', 'log'] = 'linear'
    unit: str = ''
    step: float = 2e-3

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise DiscrepancyError(f'parameter {self.name}: low must lie under high')
        if self.scale == 'log' and self.low <= 0.0:
            raise DiscrepancyError(f'parameter {self.name}: a log scale needs a low above zero')

    def to_unit(self, value: float) -> float:
        """Place of `value` between the bounds, 0 to 1."""
        if self.scale == 'log':
            floor = self.low * 1e-3
            return math.log(max(value, floor) / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def from_unit(self, place: float) -> float:
        """Value at `place` between the bounds."""
        if self.scale == 'log':
            return float(self.low * (self.high / self.low) ** place)
        return float(self.low + place * (self.high - self.low))

    def slope(self, place: float) -> float:
        """Derivative of the value by its place: carries a standard error back to units."""
        if self.scale == 'log':
            return self.from_unit(place) * math.log(self.high / self.low)
        return self.high - self.low


@dataclass(frozen=True)
class Effect:
    """One possible cause: its first parameter is its size, `neutral` of it meaning absent.

    `variants` are discrete choices inside one cause, such as which of four sensors; each is a
    set of fixed values passed on with the fitted ones. `starts` are first guesses tried by the
    screening; left empty, three sizes between the bounds are tried.

    `line`, the channels that each variant acts on, makes it a steady line looked for in stretches
    at rest and not fitted; its parameters are then cosine, sine and frequency [Hz].

    `form`: standard deviation of the size, as a share of it, that comes from the law being an
    idealised one; no residual tells it.
    """

    id: str
    parameters: tuple[Parameter, ...]
    variants: tuple[Mapping[str, float], ...] = ({},)
    starts: tuple[Mapping[str, float], ...] = ()
    title: str = ''
    settled_by: str = ''
    neutral: float = 0.0
    line: tuple[tuple[int, ...], ...] = ()
    form: float = 0.0

    @property
    def size(self) -> Parameter:
        return self.parameters[0]

    @property
    def one_sided(self) -> bool:
        return self.size.low >= self.neutral or self.size.high <= self.neutral


@dataclass(frozen=True)
class Point:
    """What one simulation is run with: base values in order, and effects by id."""

    base: Array
    effects: EffectValues = field(default_factory=dict)


@dataclass(frozen=True)
class RestSegment:
    """A stretch of record with the system at rest, at its raw rate: where noise is learnt from.

    `values` (C, n) of all channels, `step` seconds between samples. Segments of one `label`
    share a systematic course (say, creep after a step up), whose mean is taken out before noise is
    measured.
    """

    values: Array
    step: float
    label: str = ''


@dataclass(frozen=True)
class Run:
    """One record: `channels` (C, N) are means over `width` (N,) seconds about `time` (N,).

    `group` names runs made under one setting (they share their systematic model error).
    `inputs` are the coordinates that a residual may depend on, the first being the drive;
    `payload` is for the simulator alone.
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

    def __post_init__(self) -> None:
        if self.channels.ndim != 2 or self.channels.shape[1] != self.time.size:
            raise DiscrepancyError(f'run {self.name}: channels must be (C, {self.time.size})')
        if self.time.size < 8:
            raise DiscrepancyError(f'run {self.name}: {self.time.size} samples are too few')
        if not np.isfinite(self.channels).all():
            raise DiscrepancyError(f'run {self.name}: a channel holds a value that is no number')


class System(Protocol):
    """A simulator with its base parameters and the causes that could be missing from it."""

    @property
    def channel_names(self) -> tuple[str, ...]: ...

    @property
    def base_parameters(self) -> tuple[Parameter, ...]: ...

    @property
    def effects(self) -> tuple[Effect, ...]: ...

    @property
    def views(self) -> Mapping[str, Array]:
        """Combinations of channels a person looks at: name to weights (C,)."""
        ...

    def predict_many(self, run: Run, points: Sequence[Point]) -> Array:
        """Channels (B, C, N) of `run` for every point; a constant per channel is of no account."""
        ...

    def disturbances(self, runs: Sequence[Run], point: Point) -> Sequence[Array]:
        """What is wrong with any such system and no cause: per run columns (C, N, k), k the same.

        Each column is one standard deviation of one small unknown at `point` (base values, and
        the effects found), shared by all runs; k = 0 for a simulator that is right but for its
        causes.
        """
        ...
