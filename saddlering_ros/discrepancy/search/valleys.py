"""Effects tried alone from starts that the search of one effect after another does not reach.

An effect can change nothing about the base fit: a tank that is taken for half full does not
overflow. A fit can also end in a wrong valley. Late in a run, the path of a wrong law is far from
the measured one, and its slopes lead the fit astray. At the start of the run both paths are close.
So a fit to the start of each run is followed while the part that counts grows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from saddlering_ros.discrepancy.problem import fits as fitting
from saddlering_ros.discrepancy.problem.fits import Candidate, Fit, refit, run_refits
from saddlering_ros.discrepancy.problem.metric import Metric
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, Effect
from saddlering_ros.discrepancy.search.signatures import MIN_LENGTH, Signature
from saddlering_ros.discrepancy.search.space import ModelSpace

MAX_LEFT = 0.15
"""Share of the misfit of the base that a fit may leave before others are tried over growing time.
A cause that leaves more is not established."""

MAX_STARTS = 3
"""First guesses of a silent effect for each start of the base: the sizes on one side."""


def silent_effects(signatures: Sequence[Signature]) -> list[tuple[Effect, int]]:
    """Effects and variants whose starts change the prediction by less than the noise hides."""
    effects = {signature.key: signature.effect for signature in signatures}
    heard = {signature.key for signature in signatures
             if signature.share > 0.0 and signature.length / signature.share >= MIN_LENGTH}
    return [(effect, key[1]) for key, effect in effects.items() if key not in heard]


def fit_from_all_over(space: ModelSpace, effects: Sequence[tuple[Effect, int]]) -> list[Fit]:
    """Each effect alone, the best of several starts; the best effect first.

    A start receives a few rounds if the effect has influence there.
    """
    if not effects:
        return []
    metric, problem, single_fits = space.metric, space.problem, []
    base = problem.system.base_parameters
    thetas = fitting.spread_starts(base, space.settings.seed)
    alone = problem.predict([Candidate().point(base, theta) for theta in thetas])
    for effect, variant in effects:
        space.watch.check()
        candidate = Candidate(((effect, variant),))
        wholes = [np.concatenate([theta, start])
                  for start in effect.first_guesses[:MAX_STARTS] for theta in thetas]
        seen = problem.predict([candidate.point(base, whole) for whole in wholes])
        changed = seen - np.tile(alone, seen.shape[1] // alone.shape[1])
        acts = np.flatnonzero(np.isfinite(changed).all(axis=0) & changed.any(axis=0))
        if not acts.size:
            continue
        lengths = np.linalg.norm(metric.whiten(changed[:, acts]), axis=0)
        left = metric.whiten(seen[:, acts] - problem.measured[:, None])
        misfits = np.where(lengths > MIN_LENGTH, (left**2).sum(axis=0), np.inf)
        fits = run_refits(metric, [
            refit(metric, candidate, wholes[acts[number]], rounds=fitting.COARSE_BASE)
            for number in np.argsort(misfits)[:fitting.MAX_BASE_STARTS]
            if np.isfinite(misfits[number])])
        single_fits += _refined(space, fits)
    return sorted(single_fits, key=space.penalised)


def fit_at_told_sizes(space: ModelSpace) -> list[Fit]:
    """Effects of sizes that the data tell: a base that imitates them would lead the sizes away."""
    system, single_fits = space.problem.system, []
    for name, variant, size in getattr(system, 'told', ()):
        for effect in (one for one in system.effects if one.id == name):
            begun = run_refits(space.metric, [refit(
                space.metric, Candidate(((effect, variant),)), np.concatenate([
                    fitting.declared_start(system.base_parameters), [effect.size.to_unit(size)],
                    [one.first_guess for one in effect.ordered[1:]]]), rounds=0)])
            single_fits += _refined(space, [fitting.refit_base(
                space.metric, begun[0], [name], space.settings.rounds)])
    return single_fits


def _refined(space: ModelSpace, fits: Sequence[Fit]) -> list[Fit]:
    """The best of several fits of one candidate, refined, if none is known that is as good."""
    best = min(fits, key=lambda fit: fit.misfit, default=None)
    known = space.fits.get(best.candidate.key) if best else None
    if not best or (known and known.misfit <= best.misfit):
        return []
    return [space.keep(fit) for fit in space.refine([best])]


GROWING = (0.125, 0.25, 0.5)
"""Parts of each run, from its start, to which a fit is fitted in turn before the whole."""

FOLLOWED = 2
"""Fits to the longest part that are followed to the whole. With two from the shortest part on the
ripple of a drive was lost."""

APART = 0.01
"""Distance of two places, as a share of a range, from which on a fit may lead elsewhere."""


@dataclass(frozen=True)
class _Start:
    """A metric in which only a part of each run counts, from its start."""

    metric: Metric
    part: float

    @property
    def problem(self) -> Problem:
        return self.metric.problem

    @cached_property
    def counts(self) -> Array:
        """1 for each sample (n,) that counts, else 0."""
        counts = np.zeros(self.problem.size)
        for index, _, place in self.problem.slices:
            time = self.problem.runs[index].time
            counts[place] = time <= time[0] + self.part * (time[-1] - time[0])
        return counts

    def whiten(self, columns: Array) -> Array:
        """Columns (n, B) or (n,) in units of the usual size, 0 where nothing counts."""
        return self.metric.whiten((columns.T * self.counts).T)


def fit_over_growing_time(space: ModelSpace, effects: Sequence[tuple[Effect, int]]) -> list[Fit]:
    """Each effect alone, fitted from the declared start to a growing part of each run."""
    start, single_fits = fitting.declared_start(space.problem.system.base_parameters), []
    growing = [_Start(space.metric, part) for part in GROWING]
    for effect, variant in effects:
        space.watch.check()
        candidate = Candidate(((effect, variant),))
        places = [np.concatenate([start, guess]) for guess in effect.first_guesses]
        for metric in growing:
            fits = run_refits(metric, [
                refit(metric, candidate, place, rounds=fitting.COARSE_BASE) for place in places])
            places = []  # those that differ from the places of better fits, the best first
            for fit in sorted(fits, key=lambda fit: fit.misfit):
                if np.isfinite(fit.misfit) and all(
                        np.abs(fit.theta_unit - place).max() > APART for place in places):
                    places.append(fit.theta_unit)
        fits = run_refits(space.metric, [
            refit(space.metric, candidate, place, rounds=fitting.COARSE_BASE)
            for place in places[:FOLLOWED]])
        single_fits += _refined(space, fits)
    return sorted(single_fits, key=space.penalised)
