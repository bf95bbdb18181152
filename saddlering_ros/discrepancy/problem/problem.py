"""The fitted runs and their simulator as stacked vectors.

The order of a stacked vector is runs, then channels, then samples.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
import time as clock

import numpy as np

from saddlering_ros.discrepancy.noise import learn_noise
from saddlering_ros.discrepancy.problem import system as systems
from saddlering_ros.discrepancy.problem.system import Array, DiscrepancyError, Point, RunBlocks
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.progress import TELL_EVERY, Watch
from saddlering_ros.quantities import lowered, percent

ROUNDING = 1e-9
"""Share of its bounds by which a first guess may exceed them: files hold ten digits."""

EMPTY_VIEW = 0.1
"""A view is empty except for faults if its range is below this share of its neighbours' range.
Chosen for parity, which holds only noise and small errors in a sound ring."""

MIN_VIEW_SHARE = 0.2
"""Smallest range of a view over its neighbours': a view at rest has no large misfit."""

AWAY = (0.9, 0.1)
"""Bound-scaled places away from a first guess below and above the middle."""

NoiseByRun = Mapping[tuple[str, int], ChannelNoise]
LearnNoise = Callable[[Sequence[RunBlocks], Sequence[Array] | None], NoiseByRun]
"""Noise by run name and channel, from runs and, if there are some, residuals (C, N) per run."""


@dataclass(frozen=True)
class Assumptions:
    """Noise, offsets and model error of a system.

    learn_noise: source of the noise; relearns: whether the noise is learnt again from the
    residual of a model with the causes; offsets: spread of the constant of each channel, None
    if it is free; allowed_error: share of the range of each channel under which a residual is
    nothing, whatever its shape, None for 0; model_error: smooth error over the drive, None for
    none; exact_laws: whether every residual beyond noise is a doubt, because the laws of the
    effects are exact; else a residual within Settings.form_error of them is none;
    coordinate_waves: half waves that are tested along the first coordinate and along each
    other one; proposes_law: whether a law is proposed if no cause explains the misfit;
    many_valleys: whether the base may have several minima, so that the best one without an
    effect may be far from the best one with it; is_persistent: whether nuisance parameters are
    properties of this machine that its runs measure, so that the published sizes allow for them.
    """

    learn_noise: LearnNoise = learn_noise
    relearns: bool = False
    offsets: tuple[float, ...] | None = None
    allowed_error: tuple[float, ...] | None = None
    model_error: systems.ModelErrorPrior | None = field(default_factory=systems.ModelErrorPrior)
    exact_laws: bool = False
    coordinate_waves: tuple[int, int] = (6, 3)
    proposes_law: bool = True
    many_valleys: bool = False
    is_persistent: bool = False

    @property
    def has_small_errors(self) -> bool:
        """Whether everything may err a little, as on a ring that runs of one session measure."""
        return not (self.exact_laws or self.is_persistent)

    def frees_constant(self, channel: int) -> bool:
        """Whether a constant in a channel has no meaning."""
        return self.offsets is None or self.offsets[channel] >= systems.FREE_OFFSET


SEARCHED = 55.0
"""Simulated points of a search that ends with a name, for each parameter and each effect. Eight
machines needed 25 to 147 (median 64), 19 to 46 where nothing is wrong, 36 to 460 where no cause
fits (median 141)."""


@dataclass(eq=False)
class Problem:
    """A system, its runs, and everything that a diagnosis assumes about them.

    all_runs: the fitted and the held-out runs; start: first guesses of base parameters by name,
    in their units, None for the declared starts; proposals: tests of which one is chosen if
    causes cannot be told apart; simulations: number of points that were simulated. runs: those
    that are fitted; measured (n,): all their channels; slices: run index, channel, slice of it.
    """

    system: systems.System
    all_runs: Sequence[RunBlocks]
    settings: systems.Settings = field(default_factory=systems.Settings)
    assumptions: Assumptions = field(default_factory=Assumptions)
    start: Mapping[str, float] | None = None
    proposals: Sequence[systems.Proposal] = ()
    watch: Watch = field(default_factory=lambda: Watch('diagnose'))
    simulations: int = field(default=0, init=False)
    _at_once: int = field(default=1, init=False)

    def __post_init__(self) -> None:
        self.runs = tuple(run for run in self.all_runs if not run.held_out)
        self.held_out = [run for run in self.all_runs if run.held_out]
        if not self.runs:
            raise DiscrepancyError('diagnose: every run is held out: leave at least one to fit')
        self.measured = np.concatenate([run.channels.ravel() for run in self.runs])
        self.size = self.measured.size
        self.slices: list[tuple[int, int, slice]] = []
        start = 0
        for index, run in enumerate(self.runs):
            for channel, row in enumerate(run.channels):
                self.slices.append((index, channel, slice(start, start + row.size)))
                start += row.size

    def with_runs(self, runs: Sequence[RunBlocks]) -> 'Problem':
        """The same problem with other runs."""
        return replace(self, all_runs=runs)

    @cached_property
    def titles(self) -> dict[str, str]:
        """Titles of effects and inputs by id, as in a sentence; a user's own are not changed."""
        form = str if self.assumptions.exact_laws else lowered
        return {effect.id: form(effect.title) for effect in (
            *self.system.effects, *getattr(self.system, 'inputs', ()))}

    @property
    def time_unit(self) -> str:
        """Unit of the time of runs; '' if a model does not state it."""
        return str(getattr(self.system, 'time_unit', 's'))

    @cached_property
    def usual_simulations(self) -> float:
        """Number of points that a search simulates until a cause is named, roughly."""
        return SEARCHED * (len(self.system.base_parameters) + sum(
            1 + len(effect.parameters) for effect in self.system.effects))

    def first_guess(self) -> Array | None:
        """First guesses of base parameters, bound-scaled; None if none are given.

        A guess outside the bounds by rounding alone is the bound.
        """
        if self.start is None:
            return None
        parameters = {parameter.name: parameter for parameter in self.system.base_parameters}
        for name, value in self.start.items():
            if name not in parameters:
                raise DiscrepancyError(f'start: there is no base parameter {name!r}; there are '
                                       f'{", ".join(parameters)}')
            given: object = value
            if not isinstance(given, Real):
                raise DiscrepancyError(f'start: {name} is {value!r}: give a number')
            bounds = parameters[name]
            slack = ROUNDING * max(abs(bounds.low), abs(bounds.high))
            inside = bounds.low - slack <= value <= bounds.high + slack
            if not (np.isfinite(value) and (bounds.periodic or inside)):
                raise DiscrepancyError(
                    f'start: {name} = {value:g} is outside {bounds.low:g} to {bounds.high:g}')
        return np.array([
            one.to_unit(self.start[name]) if name in self.start else one.first_guess
            for name, one in parameters.items()])

    def refuse_acting_when_absent(self) -> None:
        """DiscrepancyError if a parameter that is not neutral anywhere acts at a neutral size.

        Where an effect is absent, such a parameter has its start. As a second amplitude it would
        put the effect into every fit: a sound machine had a cause of size 0.
        """
        point = Point(np.array([
            one.from_unit(one.first_guess) for one in self.system.base_parameters]))
        for effect in self.system.effects:
            shapes = [one for one in effect.ordered[1:] if one.neutral is None]
            moved = [replace(point, effects={effect.id: {
                one.name: one.from_unit(AWAY[one.first_guess > 0.5])}}) for one in shapes]
            answers = self.predict([point, *moved]) if moved else np.zeros((self.size, 1))
            for one, change in zip(shapes, (answers[:, 1:] - answers[:, :1]).T, strict=True):
                if (share := float(np.abs(change).max())) > self.settings.materiality:
                    raise DiscrepancyError(
                        f'effect {effect.id}: {one.name} moves the simulation by {percent(share)} '
                        f'of range where the effect is absent, {effect.size.name} = '
                        f'{effect.neutral:g}: give {one.name} the value at which it does nothing, '
                        'Parameter(..., neutral=)')

    @cached_property
    def channel_ranges(self) -> Array:
        """Largest range (C,) of each channel in any run."""
        return np.max([np.ptp(run.channels, axis=1) for run in self.runs], axis=0)

    @cached_property
    def view_ranges(self) -> dict[str, float]:
        """Range that a misfit in each view is compared with.

        A view that should be empty (parity) is compared with the widest view that uses its
        channels.
        """
        views = self.system.views
        ranges = {name: max(float(np.ptp(weights @ run.channels)) for run in self.runs)
                  for name, weights in views.items()}
        scaled: dict[str, float] = {}
        for name, weights in views.items():
            alike = max(ranges[other] * float(np.abs(weights).sum() / np.abs(vector).sum())
                        for other, vector in views.items() if np.any(weights * vector != 0.0))
            empty = ranges[name] <= EMPTY_VIEW * alike
            scaled[name] = alike if empty else max(ranges[name], MIN_VIEW_SHARE * alike)
        return scaled

    @cached_property
    def allowed_sizes(self) -> dict[str, float]:
        """Size by view, as a share of range, under which a residual is declared to be nothing."""
        declared = self.assumptions.allowed_error
        if declared is None:
            return dict.fromkeys(self.system.views, 0.0)
        return {view: max(declared[channel] for channel in np.flatnonzero(weights))
                for view, weights in self.system.views.items()}

    def simulate(self, run: RunBlocks, points: Sequence[Point]) -> Array:
        """Channels (B, C, N) of a run at `points`, in batches that are short enough to report."""
        answer, done = np.empty((len(points), *run.channels.shape)), 0
        while done < len(points):
            self.watch.check()
            part, began = points[done : done + self._at_once], clock.monotonic()
            batch = self.system.predict_many(run, part)
            if batch.shape != (len(part), *run.channels.shape):
                raise DiscrepancyError(
                    f'simulator: wrong shape {batch.shape} for run {run.name}: return '
                    f'{(len(part), *run.channels.shape)}')
            answer[done : done + len(part)] = batch
            each, done = (clock.monotonic() - began) / len(part), done + len(part)
            self._at_once = int(np.clip(TELL_EVERY / max(each, 1e-9), 1, 1e9))
            self.watch.work(len(part) / (len(self.runs) * self.usual_simulations))
        return answer

    def predict(self, points: Sequence[Point]) -> Array:
        """Stacked channels (n, B) at `points`."""
        parts = [self.simulate(run, points).reshape(len(points), run.channels.size)
                 for run in self.runs]
        self.simulations += len(points)
        return np.ascontiguousarray(np.concatenate(parts, axis=1).T)

    def predict_neighbours(self, groups: Sequence[Sequence[Point]]) -> list[Array]:
        """Stacked channels (n, B) of each group: a point, and others a small step away.

        A system with tangents of its own computes the others from them; any other system
        simulates every point.
        """
        ends = np.cumsum([len(group) for group in groups])
        if not isinstance(self.system, systems.SystemWithTangents):
            answers = self.predict([point for group in groups for point in group])
            return np.split(answers, ends[:-1], axis=1)
        self.simulations += int(ends[-1])
        prepared = self.system.neighbourhood(groups)
        runs = [prepared(run) for run in self.runs]
        self.watch.work(int(ends[-1]) / self.usual_simulations)
        return [np.concatenate([answer.reshape(len(answer), -1) for answer in parts], axis=1).T
                for parts in zip(*runs, strict=True)]

    def changes_of_effects(self, point: Point, prediction: Array) -> Array:
        """Change (n, E) of a prediction (n,) by each effect of its point; 0 where a run fails."""
        effects = point.effects
        if not effects:
            return np.zeros((self.size, 0))
        changes = prediction[:, None] - self.predict([
            Point(point.base, {name: own for name, own in effects.items() if name != less})
            for less in effects])
        return np.asarray(np.where(np.isfinite(changes), changes, 0.0))

    def by_run(self, stacked: Array) -> list[Array]:
        """A stacked vector (n,) or columns (n, B) as one (C, N) or (C, N, B) block per run."""
        ends = np.cumsum([run.channels.size for run in self.runs])[:-1]
        return [part.reshape(*run.channels.shape, *stacked.shape[1:])
                for part, run in zip(np.split(stacked, ends), self.runs, strict=True)]

    def sample_weights(self, run: RunBlocks, view: str) -> Array:
        """Weight (N,) of each sample in a view as a time; 0 if one of its channels is missing."""
        if run.present is None:
            return run.width
        channels = np.flatnonzero(self.system.views[view])
        return np.asarray(run.width * run.present[channels].all(axis=0))

    def view_residuals(self, residual: Array, view: str) -> list[Array]:
        """Stacked residuals (n,) or (n, B) in one view, run by run.

        A mean that has no meaning is subtracted.
        """
        weights = self.system.views[view]
        return [self.freed(np.tensordot(weights, block, axes=1), run, view)
                for run, block in zip(self.runs, self.by_run(residual), strict=True)]

    def in_one_view(self, stacked: Array, view: str) -> Array:
        """The part of stacked columns (n,) or (n, B) that moves one view and no other one."""
        weights = self.system.views[view]
        pattern = np.outer(weights, weights) / float(weights @ weights)
        return np.concatenate([
            np.tensordot(pattern, block, axes=1).reshape(-1, *stacked.shape[1:])
            for block in self.by_run(stacked)])

    def freed(self, seen: Array, run: RunBlocks, view: str) -> Array:
        """Values of one view (N,) or (N, k), minus their mean if a constant is free."""
        channels = np.flatnonzero(self.system.views[view])
        if not any(self.assumptions.frees_constant(int(channel)) for channel in channels):
            return seen
        weights = self.sample_weights(run, view)
        return np.asarray(seen - weights @ seen / weights.sum())

    def in_views(self, columns: Array) -> Array:
        """Stacked columns (n, B) or (n,) in every view and run, over the range of the view.

        The squares of a column add up to the mean squares over time of all views and runs.
        """
        parts = []
        for view in self.system.views:
            for run, seen in zip(self.runs, self.view_residuals(columns, view), strict=True):
                weights = self.sample_weights(run, view)
                parts.append(
                    (seen.T * (np.sqrt(weights / weights.sum()) / self.view_ranges[view])).T)
        return np.concatenate(parts)

    def view_sizes(self, residual: Array, view: str) -> Array:
        """Rms (R,) of stacked residuals (n,) in one view by run, as shares of its range."""
        squares = [self.mean_square(seen, run, view) for run, seen in zip(
            self.runs, self.view_residuals(residual, view), strict=True)]
        return np.sqrt(squares) / self.view_ranges[view]

    def run_along(self, residual: Array, shape: Array, view: str) -> int:
        """Index of the run in which stacked residuals (n,) go most along a shape (n,)."""
        return int(np.argmax([
            np.average(seen * along, weights=self.sample_weights(run, view))
            for run, seen, along in zip(self.runs, self.view_residuals(residual, view),
                                        self.view_residuals(shape, view), strict=True)]))

    def mean_square(self, seen: Array, run: RunBlocks, view: str) -> float:
        """Mean square over time of the values (N,) of a view, without missing samples."""
        return float(np.average(seen**2, weights=self.sample_weights(run, view)))

    def squared_misfit(self, runs: Sequence[RunBlocks], residuals: Sequence[Array]) -> float:
        """Mean over runs and views of squared residuals (C, N), relative to range."""
        squares = [
            self.mean_square(self.freed(weights @ residual, run, view), run, view)
            / self.view_ranges[view] ** 2
            for run, residual in zip(runs, residuals, strict=True)
            for view, weights in self.system.views.items()]
        return float(np.mean(squares))


def shares_of_range(values: Sequence[Array]) -> list[Array]:
    """Where each value (N,) of each run lies in the range of all runs, 0 to 1."""
    low = min(float(one.min()) for one in values)
    span = max(float(one.max()) for one in values) - low
    return [(one - low) / max(span, 1e-300) for one in values]
