"""A law proposed for a fitted model: its residual, coordinates and targets combined."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from saddlering_ros.discrepancy import gain
from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.proposal.memory import direction_of
from saddlering_ros.discrepancy.proposal.misfit import (
    DIRECTION,
    LOAD,
    Misfit,
    ObservedRun,
    RATE,
    TIME,
)
from saddlering_ros.discrepancy.proposal.propose import LawProposal, Outcome, propose_law
from saddlering_ros.discrepancy.refit import neighbours, tangent
from saddlering_ros.discrepancy.system import Array, Point, RunBlocks, System
from saddlering_ros.progress import Watch

DIRECTION_BAND = 0.01
"""Smallest return of the drive that changes its direction, as a share of its range."""


@runtime_checkable
class HasTargets(Protocol):
    """A system with further targets of an addition besides its views and channels."""

    def targets(self, run: RunBlocks, point: Point) -> Mapping[str, Array]:
        """Change of the channels (C, N) per unit of the addition, by the name of the target."""
        ...

    def start_of(self, run: RunBlocks) -> float:
        """Start of the time [s] of a law."""
        ...


REFITS = 1
"""So many times the law is fitted again, about base parameters fitted beside the one before."""


@dataclass(frozen=True)
class Proposer:
    """The data in which a law is searched: the metric and all runs, fitted and held out.

    degrees: of freedom of the noise's level; max_rounds: of the fits of base parameters.
    """

    metric: Metric
    runs: Sequence[RunBlocks]
    degrees: int
    error_rate: float
    max_rounds: int
    watch: Watch

    def law_for(self, subject: Fit) -> LawProposal | None:
        """The law that would explain the residual of `subject`.

        Base parameters that were fitted without a law have taken a part of it. So they are fitted
        again beside the law, and the law about them; the gain is that of both together. Where
        their bounds do not allow that, the first law stays, with its linear change of them.
        """
        first = self._law_about(subject)
        if first is None or not first.predicts:
            return first
        found, law, fit = [first], first, subject
        for _ in range(REFITS):
            fit = self._beside(law, fit)
            again = self._law_about(fit)
            if again is None or not again.predicts:
                break
            law = again
            found.append(self._judged(law, subject, self._beside(law, fit)))
        return max(found, key=lambda item: item.fit)

    @property
    def _experiment(self) -> Experiment:
        return self.metric.experiment

    def _law_about(self, fit: Fit) -> LawProposal | None:
        misfit = Misfit(tuple(self._fitted(fit)), self.metric.whiten, self.degrees)
        held = [_with_slopes(self._experiment.system, run, fit) for run in self._held_out]
        return propose_law(misfit, self._mean_square, held, self.error_rate)

    @property
    def _held_out(self) -> list[RunBlocks]:
        return [run for run in self.runs if run.held_out]

    def _fitted(self, fit: Fit) -> Iterator[ObservedRun]:
        """Each fitted run with its residual and the slopes of its prediction."""
        plain = tangent(self.metric, fit).plain
        residuals = self._experiment.by_run(self._experiment.measured - fit.prediction)
        start = 0
        for run, residual in zip(self._experiment.runs, residuals, strict=True):
            slopes = plain[start : start + run.channels.size]
            start += run.channels.size
            yield _observed(self._experiment.system, run, fit.point, residual,
                            slopes.reshape(*run.channels.shape, -1))

    def _beside(self, law: LawProposal, fit: Fit) -> Fit:
        """The model of `fit`, fitted to the runs minus the part of the law."""
        experiment = self._experiment
        runs = [replace(run, channels=run.channels - law.addition(self._plain(run, fit)))
                for run in experiment.runs]
        without = Experiment(experiment.system, runs, experiment.assumptions)
        return gain.plain_fits(without, [fit], self.max_rounds, self.watch)[0]

    def _judged(self, law: LawProposal, subject: Fit, beside: Fit) -> LawProposal:
        """The law with the gains of both models' own predictions."""
        fitted: list[Outcome] = []
        held: list[Outcome] = []
        for run in [*self._experiment.runs, *self._held_out]:
            seen = self._plain(run, beside)
            both = self._experiment.system.predict_many(run, [subject.point, beside.point])
            before, after = run.channels - both[0], run.channels - both[1] - law.addition(seen)
            (held if run.held_out else fitted).append(Outcome(seen, before, after))
        move = beside.theta_unit - subject.theta_unit
        return replace(law.judged_by(fitted, held, self._mean_square), move=move)

    def _plain(self, run: RunBlocks, fit: Fit) -> ObservedRun:
        """A run with targets and coordinates only."""
        still = np.zeros((*run.channels.shape, 0))
        return _observed(self._experiment.system, run, fit.point, run.channels, still)

    def _mean_square(self, run: ObservedRun, residual: Array) -> float:
        own = next(item for item in self.runs if item.name == run.name)
        return gain.mean_square(self._experiment, [own], [residual])


def _with_slopes(system: System, run: RunBlocks, fit: Fit) -> ObservedRun:
    """A held-out run with the slopes of its prediction."""
    base = system.base_parameters
    parameters = fit.candidate.parameters(base)
    asked, steps = neighbours(parameters, fit.theta_unit, range(fit.theta_unit.size))
    answers = system.predict_many(run, [fit.candidate.point(base, place) for place in asked])
    slopes = (answers[1:] - answers[:1]) / np.array(steps)[:, None, None]
    residual = run.channels - answers[0]
    return _observed(system, run, fit.point, residual, np.moveaxis(slopes, 0, -1))


def _observed(
    system: System, run: RunBlocks, point: Point, residual: Array, slopes: Array
) -> ObservedRun:
    targets: dict[str, Array] = {}
    for name, weights in system.views.items():
        pattern = weights / float(weights @ weights)
        targets[name] = np.repeat(pattern[:, None], run.time.size, axis=1)
    for number, name in enumerate(system.channel_names):
        alone = np.zeros((len(system.channel_names), run.time.size))
        alone[number] = 1.0
        if not any(_alike(alone, other) for other in targets.values()):
            targets[name] = alone
    begin = float(run.time[0])
    from_start: frozenset[str] = frozenset()
    if isinstance(system, HasTargets):
        more = system.targets(run, point)
        targets.update(more)
        from_start = frozenset(more)
        begin = system.start_of(run)
    return ObservedRun(run.name, coordinates_of(run, begin), targets, residual, slopes,
                       from_start)


def coordinates_of(run: RunBlocks, begin: float) -> dict[str, Array]:
    """Coordinates of a run: the drive, its direction and rate, time, and any others."""
    if not run.inputs:
        return {TIME: run.time - begin}
    first, *others = run.inputs
    drive, direction, rate = run.inputs[first], run.direction, run.rate
    if direction is None:
        direction = direction_of(drive, DIRECTION_BAND * float(np.ptp(drive)))
    if rate is None:
        rate = np.gradient(drive, run.time)
    found = {name: run.inputs[name] for name in others}
    return {**found, LOAD: drive, TIME: run.time - begin, DIRECTION: direction, RATE: rate}


def _alike(one: Array, other: Array) -> bool:
    """Whether two targets are proportional."""
    return bool(np.allclose(one / np.abs(one).max(), other / np.abs(other).max()))
