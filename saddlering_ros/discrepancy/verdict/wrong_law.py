"""Signs that the law of a cause is another one than that of the catalogue.

A cause can be of the right kind with a law of another form: Coulomb's friction takes most of the
misfit of friction that falls with speed. What such a law leaves goes along the coordinate over
which the cause acts, and predicts runs left out. What a cause changes lasts where the system has
a memory, so that the rest is no curve over the coordinate in itself. How a curve lasts is read
from what the cause changes, which has no noise. A cause can also act in the right channels by the
wrong shares, or act in one view only where it should act in several.
"""

from collections.abc import Sequence

import numpy as np

from saddlering_ros.discrepancy.law import families
from saddlering_ros.discrepancy.law.families import OTHER_PIECES, ShapeFamily
from saddlering_ros.discrepancy.problem.fits import Fit, plain_fits, stepped_misfit, tangent
from saddlering_ros.discrepancy.problem.system import Array
from saddlering_ros.discrepancy.search.selection import error_process, Search
from saddlering_ros.discrepancy.search.signatures import orthonormal
from saddlering_ros.discrepancy.search.space import ModelSpace
from saddlering_ros.discrepancy.verdict import wording
from saddlering_ros.discrepancy.verdict.published import Publication
from saddlering_ros.discrepancy.verdict.results import AnotherLaw
from saddlering_ros.quantities import percent

MAX_ALIKE = 0.9
"""Share of the power of what a cause changes beyond the base from which another listed effect
acts as it does: on development draws, such effects had 94 to 99 % of that of stand-ins, and up to
88 % of that of true laws, but for one of 96 %."""

ONE_CHANNEL = 0.99
"""Share of the power of what a cause changes that is in one channel: a gauge's error has all."""

MIN_REPEATED = 0.95
"""Share of the power of what a cause changes that one curve over a coordinate repeats, for the
coordinate to count as that of its law. With less, nothing is told."""

MIN_FREED, MIN_BENT = 0.2, 0.21
"""Share of the rest of left-out runs that the freed law predicts beyond the base, and its change
over the law itself (rms), from which on the law is too narrow. In draws of docs/benchmarks,
stand-ins had 0.28 and 0.23 at least; true laws that bend as much predict 0.16 at most, and those
beside a rest along the same coordinate bend by 0.19 at most, but for a gap with 0.25."""

TOLD_FREED = 0.5
"""The same share from which on a reader is told, however little a law bends: half of the rest."""

MIN_UNLIKE, MIN_UNLIKE_BENT = 0.1, 1.0 / 3.0
"""Share of the rest of left-out runs, noise included, that a cause with a size for each channel
predicts, and what it changes then over what it changed beyond the base (rms), from which on its
channels are those of another law. Stand-ins of docs/benchmarks (a leak on the other side) had 0.11
and 0.42 at least. Right laws had 0.02 and 0.11 at most, beside pipes unlike by 6 % 0.40 and 0.24.
A cause three times as large as the rest, which is over the limit there, bends by a third at most.
A second cause that predicts this share more than such sizes is no patch of the first one's law."""

MAX_SAMPLES = 4000
"""Samples of a run, evenly chosen, in which the change is followed. Chosen for cost."""


def shown_in_one_view(space: ModelSpace, fit: Fit, name: str) -> list[str]:
    """A sentence if the law of a ring's main cause explains as much in one view alone."""
    if space.problem.assumptions.exact_laws:
        return []

    def misfit(slopes: Array, residual: Array) -> float:
        white = np.column_stack([slopes, residual])
        return stepped_misfit(white.T @ white)

    least = misfit(space.tangent_of(fit).white, fit.whitened) + space.real_gain()
    whiten, measured = space.metric.whiten, space.problem.measured
    return [wording.ONE_VIEW.format(space.problem.titles[name], view)
            for view, plain, prediction in space.confined(fit, name, space.settings.materiality)
            if misfit(whiten(plain), whiten(prediction - measured)) < least]


def shared_directions(search: Search) -> list[str]:
    """A sentence for a cause if another effect, of any size and sign, would act beside it alike.

    Where these data show one direction beyond the base, an effect that is in no catalogue acts
    along it too. Alternatives and laws that contain each other are one cause. What the base
    imitates acts beside a cause as the cause: a gain of a gauge scales it, and adds nothing.
    """
    space, fit, problem = search.space, search.fit, search.space.problem
    testable = {signature.effect.id for signature in search.begun.usable}
    white, base = space.tangent_of(fit).white, problem.system.base_parameters
    beyond = orthonormal(white[:, : len(base)])
    sentences = []
    for effect, _, indices in fit.parts:
        same = {*fit.candidate.ids}
        same.update(*(other.candidate.ids for other in search.alternatives.get(effect.id, ())))
        tried = [(other, fit.candidate.plus(other, variant), start)
                 for other in problem.system.effects
                 if other.id in testable - same and not effect.overlaps(other)
                 for variant in range(len(other.variants)) for start in other.first_guesses]
        if not tried:
            continue
        changes = problem.predict([
            candidate.point(base, np.concatenate([fit.theta_unit, start]))
            for _, candidate, start in tried]) - fit.prediction[:, None]
        left = np.column_stack([white[:, indices.start], space.metric.whiten(
            np.where(np.isfinite(changes).all(axis=0), changes, 0.0))])
        left -= beyond @ (beyond.T @ left)
        left /= np.maximum(np.linalg.norm(left, axis=0), 1e-9)
        shares = (left[:, 0] @ left[:, 1:]) ** 2
        share = float(shares.max())
        if share > MAX_ALIKE:
            other = tried[int(shares.argmax())][0]
            sentences.append(wording.SHARED_DIRECTION.format(
                problem.titles[effect.id], problem.titles[other.id], percent(share)))
    return sentences


def narrow_laws(space: ModelSpace, fit: Fit) -> tuple[dict[str, AnotherLaw], list[str]]:
    """For each cause, the freed law that predicts held-out runs, if there is one.

    With a sentence for each cause whose rest goes along its coordinate and bends its law little.
    space: without learnt model error. The rest is counted in units of the model error that it
    shows, line by line, beside the parameters of the model.
    """
    problem, runs = space.problem, space.problem.runs
    if len(runs) < 2:
        return {}, []
    every = [slice(None, None, -(-run.time.size // MAX_SAMPLES)) for run in runs]
    ranges = np.maximum(problem.channel_ranges, 1e-300)[:, None, None]
    stacked = problem.by_run(np.column_stack([
        problem.measured - fit.prediction, fit.prediction, tangent(space.metric, fit).plain,
        space.changes_of(fit),
        error_process(space.metric, fit)[0]]))
    ends = np.cumsum([1, 1, fit.theta_unit.size, len(fit.candidate.effects)])
    left, seen, slopes, changes, plain = zip(*(
        np.split(block[:, each] / ranges, ends, axis=2)
        for block, each in zip(stacked, every, strict=True)), strict=True)
    states = {name: [run[row, :, 0] for run in seen]
              for row, name in enumerate(problem.system.channel_names)}
    states.update({name: [run.inputs[name][each] for run, each in zip(runs, every, strict=True)]
                   for name in runs[0].inputs if all(name in run.inputs for run in runs)})
    # A missing sample weighs nothing.
    errors = [error if run.present is None else error * run.present[:, each, None]
              for run, each, error in zip(runs, every, plain, strict=True)]

    def in_errors(blocks: Sequence[Array]) -> list[Array]:
        """Columns (1, M, B) of each run in units of the model error."""
        return [np.vstack([np.linalg.lstsq(lines[:, lines.any(axis=0)], columns, rcond=1e-6)[0]
                           for lines, columns in zip(error, block, strict=True)])[None]
                for error, block in zip(errors, blocks, strict=True)]

    rest, base = in_errors(left), orthonormal(np.concatenate(in_errors(slopes), axis=1)[0])
    wanted = np.concatenate(rest, axis=1)[0, :, 0]
    wanted -= base @ (base.T @ wanted)
    ends = np.cumsum([block.size for block in rest])
    folds = list(map(slice, (0, *ends[:-1]), ends))
    family = ShapeFamily('', 'curve', (), families.roughness(OTHER_PIECES), (0.0, 1.0))
    narrow, sentences = dict[str, AnotherLaw](), list[str]()
    for number, name in enumerate(fit.candidate.ids):
        repeated, along, splines, law, responses = families.forced(
            [change[:, :, number] for change in changes], states)
        if repeated < MIN_REPEATED:
            continue
        white = np.concatenate(in_errors(responses), axis=1)[0]
        white -= base @ (base.T @ white)
        freed = families.fit_block(folds, wanted, '', family, white)
        bent = np.linalg.norm(splines @ freed.coefficients) / np.linalg.norm(splines @ law)
        share = freed.predicted / float(wanted @ wanted)
        if share > MIN_FREED and bent > MIN_BENT:
            narrow[name] = AnotherLaw(along=along, predicts=share)
        elif share > TOLD_FREED:
            sentences.append(wording.BENT_LAW.format(problem.titles[name], along, percent(share)))
    return narrow, sentences


def unlike_channels(space: ModelSpace, fit: Fit, patched: Fit | None = None) -> list[str]:
    """A sentence for every cause that predicts left-out runs with a size for each channel.

    A stand-in acts in the right channels by the wrong shares: a leak on the other side lowers
    every head, but not each by as much. space: without learnt model error; fit: in the metric of
    the gain. Beside an error that was learnt from what the stand-in leaves nothing would show.
    patched: with more causes, which are real if they predict these runs better than such sizes.
    """
    problem, settled = space.problem, len(space.problem.system.base_parameters)
    ranges = problem.channel_ranges
    if len(problem.runs) < 2 or ranges.size < 2:
        return []
    weights, owners = np.zeros((2, problem.size))
    for run, channel, rows in problem.slices:
        present = problem.runs[run].present
        weights[rows] = 1.0 if present is None else present[channel]
        weights[rows] /= max(ranges[channel], 1e-300)
        owners[rows] = run

    def fitted(columns: Array, rest: Array, others: Array) -> Array:
        """The rest (n,) as columns (n, k) that are fitted to some samples (n,) predict it."""
        return columns @ np.linalg.lstsq(columns[others], rest[others], rcond=1e-8)[0]

    def missed(columns: Array, rest: Array) -> float:
        """Misfit that the columns leave of runs held out in turn."""
        return sum(
            float(np.sum((rest - fitted(columns, rest, owners != run))[owners == run] ** 2))
            for run in range(len(problem.runs)))

    def about(one: Fit) -> tuple[Array, Array]:
        """Sensitivities (n, p) and the rest (n,) of a fit."""
        return (weights[:, None] * tangent(space.metric, one).plain,
                weights * (problem.measured - one.prediction))

    alike, rest = about(fit)
    changes = weights[:, None] * space.changes_of(fit)
    base, sentences = orthonormal(alike[:, :settled]), []
    before, beside = missed(alike, rest), missed(*about(patched)) if patched else np.inf
    for name, change in zip(fit.candidate.ids, changes.T, strict=True):
        unlike = np.column_stack([alike, np.zeros((problem.size, ranges.size))])
        for _, channel, rows in problem.slices:
            unlike[rows, alike.shape[1] + channel] = change[rows]
        after, every = max(missed(unlike, rest), 1e-300), np.ones(problem.size, bool)
        share = 1.0 - after / max(before, 1e-300)
        freed, law = (moved - base @ (base.T @ moved) for moved in (
            fitted(unlike, rest, every) - fitted(alike, rest, every), change))
        bent = float(np.linalg.norm(freed) / max(float(np.linalg.norm(law)), 1e-300))
        is_real = beside < (1.0 - MIN_UNLIKE) * after
        if share > MIN_UNLIKE and bent > MIN_UNLIKE_BENT and not is_real:
            sentences.append(wording.UNLIKE_CHANNELS.format(problem.titles[name], percent(share)))
    return sentences


def unlike_channels_unpatched(alone: ModelSpace, search: Search,
                              published: Publication) -> list[str]:
    """The same of the main cause without those in one channel, which can make up for its law."""
    problem, fit = alone.problem, search.fit
    squares = problem.in_views(search.space.changes_of(fit)) ** 2
    powers = squares.reshape(len(problem.system.views), -1, squares.shape[1]).sum(axis=1)
    for name, power in zip(search.fit.candidate.ids, powers.T, strict=True):
        if name != published.main.effect and power.max() > ONE_CHANNEL * power.sum():
            fit = search.space.without(fit, name)
    if fit is search.fit:
        return []
    [plain] = plain_fits(problem, [fit])
    return unlike_channels(alone, plain, published.plain)
