"""Whether the law of an established cause is too narrow: its shape is freed along its coordinate.

Where something is left, a cause can be of the right kind with a law of another form: Coulomb's
friction takes most of the misfit of friction that falls with speed. What such a law leaves goes
along the coordinate over which the cause acts, and predicts runs left out. What a cause changes
lasts where the system has a memory, so that the rest is no curve over the coordinate in itself.
How a curve lasts is read from what the cause changes, which has no noise.
"""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from saddlering_ros.discrepancy.law import families
from saddlering_ros.discrepancy.law.families import OTHER_PIECES, ShapeFamily
from saddlering_ros.discrepancy.problem.fits import Fit, tangent
from saddlering_ros.discrepancy.problem.system import Array
from saddlering_ros.discrepancy.search.selection import error_process
from saddlering_ros.discrepancy.search.signatures import orthonormal
from saddlering_ros.discrepancy.search.space import ModelSpace
from saddlering_ros.discrepancy.verdict import wording

MIN_REPEATED = 0.95
"""Share of the power of what a cause changes that one curve over a coordinate repeats, for the
coordinate to count as that of its law. With less, nothing is told."""

MIN_FREED, MIN_BENT = 0.2, 0.25
"""Share of the rest of left-out runs that the freed law predicts beyond the base, and its change
over the law itself (rms), from which on the law is too narrow. In draws of docs/benchmarks,
stand-ins had 0.28 and 0.31 at least; true laws that bend as much predict 0.10 at most, and those
beside a rest along the same coordinate bend by 0.19 at most."""

MAX_SAMPLES = 4000
"""Samples of a run, evenly chosen, in which the change is followed. Chosen for cost."""


def narrow_laws(space: ModelSpace, fit: Fit) -> list[str]:
    """A sentence for every cause whose law, freed along its coordinate, predicts left-out runs.

    space: without learnt model error. The rest is counted in units of the model error that it
    shows, line by line, beside the parameters of the model.
    """
    problem, runs = space.problem, space.problem.runs
    if len(runs) < 2:
        return []
    every = [slice(None, None, -(-run.time.size // MAX_SAMPLES)) for run in runs]
    ranges = np.ptp(np.hstack([run.channels for run in runs]), axis=1)[:, None, None]
    stacked = problem.by_run(np.column_stack([
        problem.measured - fit.prediction, fit.prediction, tangent(space.metric, fit).plain,
        problem.changes_of_effects(fit.point, fit.prediction),
        error_process(space.metric, fit)[0]]))
    ends = np.cumsum([1, 1, fit.theta_unit.size, len(fit.candidate.effects)])
    left, seen, slopes, changes, errors = zip(*(
        np.split(block[:, each] / np.maximum(ranges, 1e-300), ends, axis=2)
        for block, each in zip(stacked, every, strict=True)), strict=True)
    states = {name: [run[row, :, 0] for run in seen]
              for row, name in enumerate(problem.system.channel_names)}
    states.update({name: [run.inputs[name][each] for run, each in zip(runs, every, strict=True)]
                   for name in runs[0].inputs if all(name in run.inputs for run in runs)})
    # A missing sample weighs nothing.
    errors = [error if run.present is None else error * run.present[:, each, None]
              for run, each, error in zip(runs, every, errors, strict=True)]

    def in_errors(blocks: Sequence[Array]) -> list[Array]:
        """Columns (1, M, B) of each run in units of the model error."""
        return [np.vstack([np.linalg.lstsq(lines[:, lines.any(axis=0)], columns, rcond=1e-6)[0]
                           for lines, columns in zip(error, block, strict=True)])[None]
                for error, block in zip(errors, blocks, strict=True)]

    rest, base = in_errors(left), orthonormal(np.concatenate(in_errors(slopes), axis=1)[0])
    wanted = np.concatenate(rest, axis=1)[0, :, 0]
    wanted -= base @ (base.T @ wanted)
    ends = np.cumsum([own.size for own in rest])
    folds = list(map(slice, (0, *ends[:-1]), ends))
    family = ShapeFamily('', 'curve', (), families.roughness(OTHER_PIECES), (0.0, 1.0))
    sentences = []
    for number, name in enumerate(fit.candidate.ids):
        repeated, along, splines, law, responses = forced(
            [change[:, :, number] for change in changes], states)
        if repeated < MIN_REPEATED:
            continue
        white = np.concatenate(in_errors(responses), axis=1)[0]
        white -= base @ (base.T @ white)
        freed = families.fit_block(folds, wanted, '', family, white)
        bent = np.linalg.norm(splines @ freed.coefficients) / np.linalg.norm(splines @ law)
        share = freed.predicted / float(wanted @ wanted)
        if share > MIN_FREED and bent > MIN_BENT:
            sentences.append(wording.narrow_law_words(name, along, share))
    return sentences


def forced(
    changes: Sequence[Array], states: Mapping[str, Sequence[Array]]
) -> tuple[float, str, Array, Array, list[Array]]:
    """The coordinate over which one curve, added at every sample, repeats changes (C, N) by run.

    The share of their power that it repeats, the coordinate, its splines (n, K) in all runs, the
    curve (K,), and responses (C, N, K) to each spline by run. The next sample is linear in the
    last two of every channel, because two samples of a place hold its speed, and in the curve at
    this sample or at the next one.
    """
    count, none = 2 * len(changes[0]), np.zeros((0, 0))
    best: tuple[float, str, Array, Array, list[Array]] = -np.inf, '', none, none, []
    for (name, values), late in product(states.items(), (0, 1)):
        span = min(map(np.min, values)), max(map(np.max, values))
        if span[0] == span[1]:
            continue
        splines = [families.spline_columns(
            np.append(at[late:], at[at.size - late:]), span, OTHER_PIECES) for at in values]
        before = np.vstack([np.hstack([change.T[1:-1], change.T[:-2], spline[1:-1]])
                            for change, spline in zip(changes, splines, strict=True)])
        after = np.vstack([change.T[2:] for change in changes])
        lengths = np.maximum(np.linalg.norm(before, axis=0), 1e-300)
        solved = np.linalg.lstsq(before / lengths, after, rcond=1e-7)[0].T / lengths
        channels, sizes, curves = np.linalg.svd(solved[:, count:], full_matrices=False)
        step = np.vstack([solved[:, :count], np.eye(count // 2, count)])
        force = np.append(channels[:, 0], np.zeros(count // 2))[:, None]
        responses = []
        with np.errstate(over='ignore', invalid='ignore'):
            for spline in splines:
                state = np.zeros((len(spline), count, spline.shape[1]))
                for number in range(1, len(spline)):
                    state[number] = step @ state[number - 1] + force * spline[number - 1]
                responses.append(state[:, : count // 2].transpose(1, 0, 2))
            missed, whole = np.sum([
                (np.sum((response @ curves[0] * sizes[0] - change) ** 2), np.sum(change**2))
                for response, change in zip(responses, changes, strict=True)], axis=0)
        repeated = 1.0 - float(missed / max(whole, 1e-300))
        if repeated > best[0]:
            best = repeated, name, np.vstack(splines), sizes[0] * curves[0], responses
    return best
