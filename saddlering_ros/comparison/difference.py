"""What differs between two sessions beside the causes, and the verdict on the change by it."""

from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.comparison.sessions import SETTINGS, TwoSessions
from saddlering_ros.discrepancy import Diagnosis, RunBlocks

Array = NDArray[np.float64]

ESTABLISHED_SHARE, ESTABLISHED_P = 0.85, 1e-6
"""Share of the power of the misfit, and largest p-value, of a main cause that leaves a rest."""

DEFINITION = 0.03
"""Standard uncertainty of the size of a cause by its definition (JCGM 200, 2.27), as a share.

Laws of one name differ: a sine for a parabola, a stiffening for a constant spring. The residual
hardly shows it. Sizes of such rings were 3 to 7 % wrong, where noise allows 1.0 to 1.6 % (docs/
benchmarks/changes.md).
"""


def with_main_cause(found: Diagnosis, left: float) -> Diagnosis:
    """The verdict by what differs between the sessions, `left` of it beside the causes.

    A misfit that both sessions have is no change. The one cause is established if it takes nearly
    all of the power of the difference. The rest may be a part of this cause: its share of the
    change is an error of the size. A stand-in for a law that the catalogue lacks took at most 0.80
    of the power of the misfit on other machines (docs/benchmarks/real_machines.md).
    """
    largest = max([left, *(cause.visible for cause in found.causes)])
    if found.verdict == 'unknown' and largest < SETTINGS.materiality:
        return replace(found, verdict='none', causes=(), complete=True, remainder=())
    if len(found.causes) != 1 or found.verdict == 'none':
        return found
    cause = found.causes[0]
    share = 1.0 - (left / cause.visible) ** 2
    if found.verdict == 'unknown' and (share < ESTABLISHED_SHARE or cause.p_value > ESTABLISHED_P):
        return found
    name, size = next(iter(cause.parameters.items()))
    std = math.hypot(size.std, abs(size.value) * math.hypot(left / cause.visible, DEFINITION))
    widened = {**cause.parameters, name: replace(size, std=std)}
    return replace(found, verdict='named' if len(cause.group) == 1 else 'ambiguous',
                   causes=(replace(cause, parameters=widened, partial=False),),
                   complete=left < SETTINGS.materiality)


def in_doubt(found: Diagnosis) -> Diagnosis:
    """The verdict if the sessions differ in more than the ring: no cause is established."""
    partial = tuple(replace(cause, partial=True) for cause in found.causes)
    return replace(found, verdict='unknown', causes=partial, complete=False)


def left_between(found: Diagnosis, system: TwoSessions) -> float:
    """Largest rms, as a share of range, of what differs between the sessions beside the causes.

    Each run is compared with the run of the other session under the same course of the load; a
    run without one counts whole. The noise of both is subtracted.
    """
    problem = found.fits.metric.problem
    residual = found.fits.metric.without_nuisances(problem.measured - found.fits.after.prediction)
    largest = 0.0
    for view, weights in problem.system.views.items():
        seen = problem.view_residuals(residual, view)
        for run, own in zip(problem.runs, seen, strict=True):
            other = next((number for number, one in enumerate(problem.runs)
                          if system.session_of(one) != system.session_of(run)
                          and _same_course(run, one)), None)
            noise = noise_power(found, run, weights)
            if other is not None:
                one = problem.runs[other]
                own = own - np.interp(run.time - run.time[0], one.time - one.time[0], seen[other])
                noise += noise_power(found, one, weights)
            power = problem.mean_square(own, run, view) - noise
            largest = max(largest, math.sqrt(max(power, 0.0)) / problem.view_ranges[view])
    return largest


SAME_COURSE = 0.01
"""Largest median difference of two loads under one course, as a share of the largest load."""


def _same_course(run: RunBlocks, other: RunBlocks) -> bool:
    """Whether two runs are of one elevation and have nearly the same load at every time."""
    if run.group != other.group:
        return False
    first, second = run.inputs['load'], other.inputs['load']
    along = np.interp(run.time - run.time[0], other.time - other.time[0], second)
    return bool(np.median(np.abs(first - along)) < SAME_COURSE * np.abs(first).max())


def noise_power(found: Diagnosis, run: RunBlocks, weights: Array) -> float:
    """Mean square noise of the blocks of a run in a view."""
    metric = found.fits.metric
    return float(sum(
        weight**2 * np.mean(metric.noise[run.name, channel].variances(run.width))
        for channel, weight in enumerate(weights) if weight))
