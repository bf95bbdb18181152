"""A law proposed for a misfit that no effect of the catalogue explains.

Families of shapes on every target are fitted to the whitened residual without the base parameters.
The family that predicts most of runs held out in turn is chosen, and a second one if it adds
enough. A family counts only if it passes the likelihood ratio test of a cause, with the number of
families counted. The curve is matched to simple laws. The verdict stays `unknown`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.proposal.blocks import blocks_of, own_curves, ShapeFamily, span_of
from saddlering_ros.discrepancy.proposal.matching import match_law, Term
from saddlering_ros.discrepancy.proposal.misfit import (
    DIRECTION,
    HYSTERESIS,
    LOAD,
    Misfit,
    ObservedRun,
    RATE,
    stacked,
    TIME,
)
from saddlering_ros.discrepancy.proposal.selection import BlockFit, fit_block, rank_blocks
from saddlering_ros.discrepancy.system import Array

MAX_BLOCKS = 2
MIN_SHARE = 0.1
"""Smallest share of the misfit that the first family must predict."""

MIN_SECOND_SHARE = 0.1
"""Smallest share of the remaining misfit that a second family must predict."""

OWN_CURVES = 0.3
"""Predicted share below which a curve of its own is tried for each run."""

ALIKE = 0.9
"""Predicted share, relative to the best, at which another coordinate or target is a doubt."""

BEYOND = 0.02
"""Share of the observed range by which a held-out run may exceed it."""

BACKFITS = 3

MeanSquare = Callable[[ObservedRun, Array], float]
"""Mean square of a plain residual (C, N) of a run over the ranges, as in the gain."""


@dataclass(frozen=True)
class Alternative:
    """Another target and coordinate, with the share of the misfit that its family predicts."""

    target: str
    coordinate: str
    share: float


@dataclass(frozen=True)
class Outcome:
    """Residuals (C, N) of one run without and with a law."""

    run: ObservedRun
    before: Array
    after: Array


@dataclass(frozen=True)
class LawProposal:
    """A law that would explain the residual.

    terms: one or two additions. share: explained share of the whitened misfit. p_value: with
    all families counted. fit, held_out: gain as 1 - rms with / rms without; negative if the
    law predicts worse. move (P,): change of base parameters beside the law. worse: runs that it
    predicts worse. reasons: further reasons not to trust it, one sentence each.
    """

    terms: tuple[Term, ...]
    share: float
    p_value: float
    fit: float
    held_out: float | None
    move: Array
    worse: tuple[str, ...]
    reasons: tuple[str, ...]
    alternatives: tuple[Alternative, ...]

    @property
    def term(self) -> Term:
        """The term that explains most."""
        return self.terms[0]

    @property
    def predicts(self) -> bool:
        """Whether it predicts a run that it was not fitted to."""
        return all(term.law != 'own curve' for term in self.terms)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Every reason not to trust it, one sentence each."""
        return (*(f'the law makes {name} worse' for name in self.worse), *self.reasons)

    def addition(self, run: ObservedRun) -> Array:
        """The part of the law in the channels (C, N) of a run."""
        added = np.zeros(run.residual.shape)
        for term in self.terms:
            added += run.added(term.target, term.evaluate(run.coordinates)[:, None])[:, :, 0]
        return added

    def judged_by(self, fitted: Sequence[Outcome], held_out: Sequence[Outcome],
                  mean_square: MeanSquare) -> LawProposal:
        """The same law with the gains of these residuals."""
        fit, worse = _gain_of(fitted, mean_square)
        held = None
        if held_out and self.predicts:
            held, more = _gain_of(held_out, mean_square)
            worse += [f'{name} (held out)' for name in more]
        return replace(self, fit=fit, held_out=held, worse=tuple(worse))


def propose_law(
    misfit: Misfit,
    mean_square: MeanSquare,
    held_out: Sequence[ObservedRun] = (),
    error_rate: float = 0.01,
) -> LawProposal | None:
    """The best law of at most two families, or None if none passes the test."""
    blocks = blocks_of(misfit.runs)
    targets = list(misfit.runs[0].targets)
    wanted = misfit.residual
    total = float(wanted @ wanted)
    ranked = rank_blocks(misfit, blocks, targets, wanted)
    if ranked[0].predicted < OWN_CURVES * total:
        own = own_curves(misfit.runs)
        ranked = sorted(
            [*ranked, *rank_blocks(misfit, [own], targets, wanted)],
            key=lambda fit: -fit.predicted,
        )
    trials = len(ranked)
    first = ranked[0]
    p_value = first.p_value(misfit.degrees, trials)
    if p_value > error_rate or first.predicted < MIN_SHARE * total:
        return None
    chosen = [first]
    left = _left(wanted, chosen)
    second = rank_blocks(misfit, blocks, targets, left)[0]
    enough = second.predicted >= MIN_SECOND_SHARE * float(left @ left)
    if enough and second.p_value(misfit.degrees, trials * trials) < error_rate:
        chosen = _backfitted(misfit, [first, second], wanted)
    terms = _matched(misfit, chosen, wanted)
    change = _changes(misfit, terms, chosen)
    move, white_left = _base_move(misfit, change)
    others = tuple(
        Alternative(item.target, item.block.coordinate, item.predicted / total)
        for item in ranked[1:6]
        if item.predicted > 0.0
    )
    reasons = _reasons(misfit, ranked, terms, held_out)
    share = 1.0 - float(white_left @ white_left) / total
    law = LawProposal(
        terms=terms, share=share, p_value=p_value, fit=0.0, held_out=None, move=move, worse=(),
        reasons=tuple(reasons), alternatives=others)
    fitted = [
        Outcome(run, run.residual, run.residual - part - run.slopes @ move)
        for run, part in zip(misfit.runs, change, strict=True)
    ]
    held = [
        Outcome(run, run.residual, run.residual - law.addition(run) - run.slopes @ move)
        for run in held_out if law.predicts
    ]
    return law.judged_by(fitted, held, mean_square)


def _left(wanted: Array, fits: Sequence[BlockFit]) -> Array:
    left = wanted.copy()
    for item in fits:
        left -= item.white @ item.coefficients
    return left


def _backfitted(misfit: Misfit, fits: list[BlockFit], wanted: Array) -> list[BlockFit]:
    """Families fitted together, each to the residual of the other, in turn; the larger first."""
    for _ in range(BACKFITS):
        for number, item in enumerate(fits):
            rest = [other for place, other in enumerate(fits) if place != number]
            fits[number] = fit_block(misfit, item.target, item.block, _left(wanted, rest))
    return sorted(fits, key=lambda item: -item.taken)


def _matched(misfit: Misfit, fits: list[BlockFit], wanted: Array) -> tuple[Term, ...]:
    terms = []
    for number, item in enumerate(fits):
        rest = [other for place, other in enumerate(fits) if place != number]
        terms.append(match_law(misfit, item, _left(wanted, rest)))
    return tuple(terms)


def _changes(misfit: Misfit, terms: tuple[Term, ...], fits: list[BlockFit]) -> list[Array]:
    """Plain change (C, N) of each run's channels by all terms."""
    total = np.zeros(misfit.size)
    for term, item in zip(terms, fits, strict=True):
        if term.law == 'own curve':
            shapes = tuple((part @ item.coefficients)[:, None] for part in item.block.shapes)
        else:
            shapes = tuple(term.evaluate(run.coordinates)[:, None] for run in misfit.runs)
        total += stacked(misfit.runs, term.target, shapes)[:, 0]
    return [
        total[rows].reshape(run.residual.shape)
        for rows, run in zip(misfit.rows, misfit.runs, strict=True)
    ]


def _base_move(misfit: Misfit, change: list[Array]) -> tuple[Array, Array]:
    """Change of base parameters (P,) beside the law, and the whitened residual (n,)."""
    plain = np.concatenate(
        [(run.residual - part).ravel() for run, part in zip(misfit.runs, change, strict=True)]
    )
    slopes = np.concatenate([run.slopes.reshape(-1, run.slopes.shape[2]) for run in misfit.runs])
    joined = misfit.whiten(np.column_stack([plain, slopes]))
    white, columns = joined[:, 0], joined[:, 1:]
    # Bound-scaled parameters have a prior of one range, so that idle ones stay.
    gram = columns.T @ columns + np.eye(columns.shape[1])
    move = np.linalg.solve(gram, columns.T @ white)
    return np.asarray(move), np.asarray(white - columns @ move)


def _gain_of(outcomes: Sequence[Outcome], mean_square: MeanSquare) -> tuple[float, list[str]]:
    """Gain over some runs, and the names of those that get worse."""
    before = [mean_square(item.run, item.before) for item in outcomes]
    after = [mean_square(item.run, item.after) for item in outcomes]
    worse = [item.run.name for item, old, new in zip(outcomes, before, after, strict=True)
             if new > old]
    return _gain(before, after), worse


def _gain(before: list[float], after: list[float]) -> float:
    return 1.0 - float(np.sqrt(np.mean(after) / max(float(np.mean(before)), 1e-300)))


def _reasons(
    misfit: Misfit,
    ranked: list[BlockFit],
    terms: tuple[Term, ...],
    held_out: Sequence[ObservedRun],
) -> list[str]:
    best = ranked[0]
    reasons: list[str] = []
    for term in terms:
        reasons += _outside(misfit, term, held_out)
        if term.law == 'own curve':
            reasons.append(
                f'{term.target} follows a separate curve over time in each run, which predicts '
                'no other run'
            )
    reasons += [
        f'{name} explains nearly as much as {best.block.coordinate} (within 10 %): these runs do '
        'not tell the two apart' for name in _other_coordinates(best, ranked)]
    reasons += [
        f'an addition to {name} explains nearly as much as an addition to {best.target} (within '
        '10 %): these runs do not tell the two apart'
        for name in _other_targets(best, ranked, terms)]
    if _one_rate(misfit.runs):
        reasons.append('all runs have one rate of loading: whether the law depends on the rate is '
                       'open')
    if len(misfit.runs) == 1:
        reasons.append('the law was fitted to one run')
    return reasons


def _as_good(best: BlockFit, ranked: list[BlockFit]) -> list[BlockFit]:
    """Families that predict nearly as much as the best one."""
    return [item for item in ranked if item is not best
            and item.predicted >= ALIKE * best.predicted]


def _other_coordinates(best: BlockFit, ranked: list[BlockFit]) -> list[str]:
    return sorted({item.block.coordinate for item in _as_good(best, ranked)}
                  - {best.block.coordinate})


def _other_targets(best: BlockFit, ranked: list[BlockFit], terms: tuple[Term, ...]) -> list[str]:
    """Targets beside those of the law on which the coordinate of the best family is as good."""
    return sorted({item.target for item in _as_good(best, ranked)
                   if item.block.coordinate == best.block.coordinate}
                  - {term.target for term in terms} - {best.target})


def _outside(misfit: Misfit, term: Term, held_out: Sequence[ObservedRun]) -> list[str]:
    along = LOAD if term.coordinate in (DIRECTION, HYSTERESIS) else term.coordinate
    low, high = span_of(misfit.runs, along)
    slack = BEYOND * (high - low)
    beyond = []
    for run in held_out:
        seen = run.coordinates[along]
        if seen.min() < low - slack or seen.max() > high + slack:
            beyond.append(f'{run.name} (held out) has a {along} outside the fitted range')
    return beyond


def _one_rate(runs: tuple[ObservedRun, ...]) -> bool:
    """Whether all moving runs have about the same largest rate."""
    if any(RATE not in run.coordinates for run in runs):
        return True
    fastest = [float(np.abs(run.coordinates[RATE]).max()) for run in runs]
    moving = [rate for rate in fastest if rate > 0.0]
    return len(moving) < 2 or max(moving) < 1.5 * min(moving)


def describe(term: Term) -> str:
    """One sentence on a term."""
    words = {
        LOAD: 'the load',
        DIRECTION: 'the direction of the load times a curve over the load',
        RATE: 'the rate of the load',
        TIME: 'time',
        HYSTERESIS: 'the history of the load',
    }
    along = words.get(term.coordinate, term.coordinate)
    return f'{term.target} has an addition that follows {along}: {term.law} ({term.words})'


__all__ = ['Alternative', 'LawProposal', 'ShapeFamily', 'describe', 'propose_law']
