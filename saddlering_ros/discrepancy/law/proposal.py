"""A law proposed for a misfit that no effect of the catalogue explains.

Families of shapes on every target are fitted to the whitened residual without the base parameters.
The family that predicts most of runs held out in turn is chosen, and a second one if it adds
enough. A family counts only if it passes the likelihood ratio test of a cause, with the number of
families counted. The curve is matched to simple laws. The verdict stays `unknown`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.law import families
from saddlering_ros.discrepancy.law.families import BlockFit, DIRECTION, LOAD, Misfit, ObservedRun
from saddlering_ros.discrepancy.law.matching import match_law, Term
from saddlering_ros.discrepancy.problem.system import Array

MIN_SHARE = 0.1
"""Smallest share of the misfit that the first family must predict to describe it."""

MIN_SECOND_SHARE = 0.1
"""The same share of the remaining misfit for a second family."""

ALIKE = 0.9
"""Share of the best at which another coordinate or target is a doubt, told as 10 %."""

BEYOND = 0.02
"""Share of the range by which a held-out run may exceed it: full scales differ a little."""

BACKFITS = 3
"""Rounds in which two families are fitted in turn. Chosen for cost."""

MeanSquare = Callable[[ObservedRun, Array], float]
"""Mean square of a plain residual (C, N) of a run over the ranges, as in the gain."""

Outcomes = Mapping[str, tuple[float, float]]
"""Mean squares without and with a law, by the name of the run."""


@dataclass(frozen=True)
class LawProposal:
    """A law that would explain the residual.

    terms: one or two additions, the one that explains most first. share: explained share of the
    whitened misfit. p_value: with all families counted. reasons: reasons not to trust it, one
    sentence each. fit, held_out: gain as 1 - rms with / rms without; negative if the law predicts
    worse. worse: runs that it predicts worse.
    """

    terms: tuple[Term, ...]
    share: float
    p_value: float
    reasons: tuple[str, ...]
    fit: float = 0.0
    held_out: float | None = None
    worse: tuple[str, ...] = ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Every reason not to trust it, one sentence each."""
        return (*(f'the law makes {name} worse' for name in self.worse), *self.reasons)

    def addition(self, run: ObservedRun) -> Array:
        """The part of the law in the channels (C, N) of a run."""
        return np.asarray(np.zeros(run.residual.shape) + sum(
            run.added(term.target, term.evaluate(run.coordinates)[:, None])[:, :, 0]
            for term in self.terms))

    def judged_by(self, fitted: Outcomes, held_out: Outcomes) -> LawProposal:
        """The same law with the gains of these mean squares."""
        def gain(outcomes: Outcomes) -> float:
            before, after = np.mean(list(outcomes.values()), axis=0)
            return 1.0 - float(np.sqrt(after / max(float(before), 1e-300)))

        worse = [name for name, (before, after) in fitted.items() if after > before]
        worse += [f'{name} (held out)' for name, (before, after) in held_out.items()
                  if after > before]
        return replace(self, fit=gain(fitted), held_out=gain(held_out) if held_out else None,
                       worse=tuple(worse))


def propose_law(
    misfit: Misfit, mean_square: MeanSquare, held_out: Sequence[ObservedRun] = (),
    error_rate: float = 0.01,
) -> LawProposal | None:
    """The best law of at most two families, or None if none passes the test."""
    wanted = misfit.residual
    total = float(wanted @ wanted)
    # Every family on every target, the one that predicts most first.
    ranked = sorted(
        (families.fit_block(misfit.folds, wanted, target, block,
                            misfit.columns(target, block.shapes))
         for block in families.blocks_of(misfit.runs) for target in misfit.runs[0].targets),
        key=lambda fit: -fit.predicted)
    trials, first = len(ranked), ranked[0]
    p_value = first.p_value(misfit.degrees, trials)
    if p_value > error_rate or first.predicted < MIN_SHARE * total:
        return None
    chosen = [first]
    left = _left(wanted, chosen)
    second = max((families.fit_block(misfit.folds, left, fit.target, fit.block, fit.white)
                  for fit in ranked), key=lambda fit: fit.predicted)
    enough = second.predicted >= MIN_SECOND_SHARE * float(left @ left)
    if enough and second.p_value(misfit.degrees, trials * trials) < error_rate:
        # Both are fitted together, each to the residual of the other, in turn; the larger first.
        chosen = [first, second]
        for _ in range(BACKFITS):
            for number, fit in enumerate(chosen):
                chosen[number] = families.fit_block(
                    misfit.folds, _left(wanted, chosen, number), fit.target, fit.block, fit.white)
        chosen.sort(key=lambda fit: -fit.taken)
    terms = tuple(match_law(misfit, fit, _left(wanted, chosen, number))
                  for number, fit in enumerate(chosen))
    law = LawProposal(terms, 0.0, p_value, tuple(_reasons(misfit, ranked, terms, held_out)))
    # The change of base parameters (P,) beside the law. Bound-scaled parameters have a prior of
    # one range, so that idle ones stay.
    plain = np.concatenate([(run.residual - law.addition(run)).ravel() for run in misfit.runs])
    white, columns = np.split(misfit.whiten(np.column_stack([plain, misfit.slopes])), [1], axis=1)
    gram = columns.T @ columns + np.eye(columns.shape[1])
    move = np.linalg.solve(gram, columns.T @ white[:, 0])
    left = white[:, 0] - columns @ move

    def outcomes(runs: Sequence[ObservedRun]) -> Outcomes:
        return {run.name: (
            mean_square(run, run.residual),
            mean_square(run, run.residual - law.addition(run) - run.slopes @ move))
            for run in runs}

    return replace(law, share=1.0 - float(left @ left) / total).judged_by(
        outcomes(misfit.runs), outcomes(held_out))


def _left(wanted: Array, chosen: Sequence[BlockFit], without: int | None = None) -> Array:
    """What families, all but that at an index, leave of a whitened residual (n,)."""
    left = wanted.copy()
    for number, fit in enumerate(chosen):
        if number != without:
            left -= fit.white @ fit.coefficients
    return left


def _reasons(
    misfit: Misfit, ranked: list[BlockFit], terms: tuple[Term, ...],
    held_out: Sequence[ObservedRun],
) -> list[str]:
    best = ranked[0]
    reasons: list[str] = []
    for term in terms:
        along = LOAD if term.coordinate in (DIRECTION, families.HYSTERESIS) else term.coordinate
        low, high = families.span_of(misfit.runs, along)
        slack = BEYOND * (high - low)
        reasons += [
            f'{run.name} (held out) has a {along} outside the fitted range' for run in held_out
            if run.coordinates[along].min() < low - slack
            or run.coordinates[along].max() > high + slack]
    as_good = [fit for fit in ranked
               if fit is not best and fit.predicted >= ALIKE * best.predicted]
    along = best.block.coordinate
    coordinates = {other.block.coordinate for other in as_good} - {along}
    reasons += [
        f'{name} explains nearly as much as {along} (within 10 %): these runs do not tell the two '
        'apart' for name in sorted(coordinates)]
    targets = {other.target for other in as_good if other.block.coordinate == along}
    targets -= {best.target, *(term.target for term in terms)}
    reasons += [
        f'an addition to {name} explains nearly as much as an addition to {best.target} (within '
        '10 %): these runs do not tell the two apart' for name in sorted(targets)]
    fastest = [float(np.abs(run.coordinates.get(families.RATE, np.zeros(1))).max())
               for run in misfit.runs]
    moving = [rate for rate in fastest if rate > 0.0]
    if len(moving) < 2 or max(moving) < 1.5 * min(moving):
        reasons.append('all runs have one rate of loading: whether the law depends on the rate is '
                       'open')
    if len(misfit.runs) == 1:
        reasons.append('the law was fitted to one run')
    return reasons


def describe(term: Term) -> str:
    """One sentence on a term."""
    words = {
        LOAD: 'the load', DIRECTION: 'the direction of the load times a curve over the load',
        families.RATE: 'the rate of the load', families.TIME: 'time',
        families.HYSTERESIS: 'the history of the load'}
    along = words.get(term.coordinate, term.coordinate)
    return f'{term.target} has an addition that follows {along}: {term.law} ({term.words})'
