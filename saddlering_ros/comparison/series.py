"""A series of sessions of one ring: evidence of a change that stays valid however often one looks.

Each session is one more part of one vector of readings. Without a change it is normal, with the
noise of each session, the errors that all sessions share, and a small error of each session of
its own. With a change of one kind since one session, a shape of unknown size is added in it and
in every later one. The ratio of the two densities of all readings up to a session, averaged over
sizes, kinds and first sessions, is a martingale whose mean is 1 while nothing changes. It exceeds
1/alpha at any session with a chance of at most alpha (Ville, Étude critique de la notion de
collectif, 1939; Robbins, Ann. Math. Stat. 41 (1970) 1397; Ramdas and others, Stat. Sci. 38 (2023)
576). The base session alone gives the contact law about which the shapes are computed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from saddlering_ros import discrepancy
from saddlering_ros.comparison import sessions
from saddlering_ros.comparison.sessions import QUANTITIES
from saddlering_ros.diagnosis.records import PreparedRecord
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.estimation.process import Array
from saddlering_ros.progress import Watch
from saddlering_ros.quantities import compact, MAX_LOG, shares_in_words
from saddlering_ros.rig import PARAMETER_NAMES
from saddlering_ros.ring.small_errors import DIMENSIONS

CHANGED = 100.0
"""E-value from which the ring has changed: reached by one unchanged ring in a hundred at most,
however many sessions it has."""

CONTACT_STEP = 0.05
"""Spread of a change of K or D as a share, and the step by which its shape is differenced."""

UNSEEN = 1e-6
"""Information on a size that a session does not show at all; a thousand spreads are its error."""


@dataclass(frozen=True)
class SessionSums:
    """Products of the whitened columns of one session, over its readings.

    errors (m, m) and residual (m,): of errors in units of their spread, with each other and with
    the residual; cross (m, h), changes (h,), along (h,): of h shapes of a change with the errors,
    with themselves and with the residual.
    """

    errors: Array
    residual: Array
    cross: Array
    changes: Array
    along: Array

    @classmethod
    def of(cls, errors: Array, shapes: Array, residual: Array) -> 'SessionSums':
        """From whitened columns (n, m), (n, h) and (n,)."""
        return cls(errors.T @ errors, errors.T @ residual, errors.T @ shapes,
                   np.einsum('nh,nh->h', shapes, shapes), shapes.T @ residual)


@dataclass(frozen=True)
class Evidence:
    """e_values (S,) after each later session; moment (S,): chance that each was the first changed.

    kind: number of the shape with most evidence; sizes and deviations (S,): of this shape in each
    later session, in units of its spread.
    """

    e_values: Array
    moment: Array
    kind: int
    sizes: Array
    deviations: Array


def evidence_of(base: SessionSums, later: Sequence[SessionSums]) -> Evidence:
    """Evidence of a change since the base session."""
    e_values = []
    for count in range(1, len(later) + 1):
        numbers = np.arange(1.0, count + 1.0)
        # Prior chance that the change begins with each session; all that may come sum to 1.
        weights = 1.0 / (numbers * (numbers + 1.0))
        logs = _log_ratios(base, later[:count]) + np.log(weights)[:, None]
        mean = np.logaddexp.reduce(logs, axis=None) - math.log(logs.shape[1])
        e_values.append(math.exp(min(mean, MAX_LOG)) + 1.0 - float(weights.sum()))
    begun = np.logaddexp.reduce(logs, axis=1)
    kind = int(np.argmax(np.logaddexp.reduce(logs, axis=0)))
    # Size of this shape in each later session by itself, without a prior.
    inverse, residual = _without_change(base, later)
    cross = np.array([one.cross[:, kind] for one in later])
    information = np.diag([one.changes[kind] for one in later]) - cross @ inverse @ cross.T
    along = np.array([one.along[kind] for one in later]) - cross @ (inverse @ residual)
    covariance = np.linalg.inv(information + UNSEEN * np.eye(len(later)))
    return Evidence(np.array(e_values), np.exp(begun - np.logaddexp.reduce(begun)), kind,
                    covariance @ along, np.sqrt(np.diag(covariance)))


def _without_change(base: SessionSums, later: Sequence[SessionSums]) -> tuple[Array, Array]:
    """Covariance (m, m) of the errors given no change, and their residual products (m,)."""
    errors = base.errors + sum(one.errors for one in later)
    residual = base.residual + sum(one.residual for one in later)
    return np.asarray(np.linalg.inv(errors + np.eye(len(errors)))), np.asarray(residual)


def _log_ratios(base: SessionSums, later: Sequence[SessionSums]) -> Array:
    """Log ratio (S, h) of the densities with each shape since each later session, and without."""
    inverse, residual = _without_change(base, later)
    cross, information, along = (
        np.cumsum(np.array([getattr(one, name) for one in later])[::-1], axis=0)[::-1]
        for name in ('cross', 'changes', 'along'))
    information = information - np.einsum('smh,mn,snh->sh', cross, inverse, cross, optimize=True)
    along = along - np.einsum('smh,m->sh', cross, inverse @ residual)
    return np.asarray(0.5 * along**2 / (1.0 + information) - 0.5 * np.log1p(information))


@dataclass(frozen=True)
class ChangeSeries:
    """A series of sessions, the base session first.

    names (S + 1,): of the sessions; evidence: of the S later ones; effect, parameter, unit: of the
    change with most evidence; sizes, deviations (S,): of its size in each later session, minus
    that of the base session.
    """

    names: tuple[str, ...]
    evidence: Evidence
    effect: str
    parameter: str
    unit: str
    sizes: Array
    deviations: Array

    @property
    def headline(self) -> str:
        """Whether the ring has changed, and when, in one sentence."""
        last = float(self.evidence.e_values[-1])
        if last < CHANGED:
            return (f'The series of {len(self.names)} sessions shows no change (e-value '
                    f'{compact(last, 2)}, {CHANGED:g} is a change).')
        first = int(np.argmax(self.evidence.moment))
        last_sound = self.names[first] if first else 'the base session'
        chances = dict(zip(self.names[1:], self.evidence.moment.tolist(), strict=True))
        return (f'The ring has changed since {last_sound} (e-value {compact(last, 2)}); '
                f'{self.names[first + 1]} is the first changed session with a chance of '
                f'{shares_in_words(chances)[self.names[first + 1]]}.')

    def to_json(self) -> dict[str, Any]:
        """The series of the verdict document; sizes are those of later sessions minus the base."""
        return {
            'headline': self.headline, 'changed': bool(self.evidence.e_values[-1] >= CHANGED),
            'effect': self.effect, 'parameter': self.parameter, 'unit': self.unit,
            'sessions': [
                {'name': name, 'e_value': e_value, 'first_changed': chance, 'size': size,
                 'std': std}
                for name, e_value, chance, size, std in zip(
                    self.names[1:], self.evidence.e_values, self.evidence.moment, self.sizes,
                    self.deviations, strict=True)]}


def series_of(
    ring: RingSystem, prepared: Mapping[str, Sequence[PreparedRecord]], start: Mapping[str, float],
    watch: Watch, *, are_rollers_moved: bool,
) -> ChangeSeries:
    """The series of sessions by name, the base session first; start: its contact law.

    are_rollers_moved: whether the rollers of each session may stand elsewhere.
    """
    base, *later = prepared
    system = sessions.TwoSessions(ring, frozenset(record.run.name for record in prepared[base]))
    problem = discrepancy.Problem(
        system, [record.run for records in prepared.values() for record in records],
        sessions.SETTINGS,
        discrepancy.Assumptions(model_error=sessions.PERSISTENT_MODEL_ERROR), start, watch=watch)
    own_errors = problem.with_runs([
        replace(record.run, group=f'{name} {record.run.group}')
        for name, records in prepared.items() for record in records])
    law = np.array([start[name] for name in PARAMETER_NAMES])
    moved = [discrepancy.Point(law * (1.0 + CONTACT_STEP * (np.array(PARAMETER_NAMES) == name)))
             for name in PARAMETER_NAMES]
    kinds = [*system.persistent, *({name: {'change': dimension.usual}}
                                   for name, dimension in DIMENSIONS.items())]
    dimensions = [discrepancy.Point(law, values) for values in kinds[len(system.persistent):]]
    predicted = problem.predict([discrepancy.Point(law), *moved, *dimensions])
    prediction, (contact, rigs) = predicted[:, 0], np.split(
        predicted[:, 1:] - predicted[:, :1], [len(moved)], axis=1)
    nuisances = discrepancy.nuisance_columns(problem, discrepancy.Point(law), prediction)
    ranges = np.array([entry.high - entry.low for entry in system.base_parameters])
    shapes = np.hstack([
        nuisances[:, nuisances.shape[1] - len(system.persistent):], rigs,
        contact[:, [PARAMETER_NAMES.index(name) for name in QUANTITIES]]])
    errors = np.hstack([
        nuisances, discrepancy.model_error_columns(own_errors, discrepancy.ModelErrorPrior()),
        contact * ranges / (CONTACT_STEP * law)])
    rows = [np.concatenate([np.arange(part.start, part.stop)
                            for index, _, part in problem.slices
                            if problem.runs[index].name in {one.run.name for one in records}])
            for records in prepared.values()]
    if are_rollers_moved:
        rollers = math.sqrt(2.0) * np.concatenate([
            columns.reshape(-1, columns.shape[2]) for columns in ring.other_rollers(
                problem.runs, [discrepancy.Point(law)] * len(problem.runs))])
        own = np.zeros((len(later), *rollers.shape))
        for session, there in zip(own, rows[1:], strict=True):
            session[there] = rollers[there]
        errors = np.hstack([errors, *own])
    residual = problem.measured - prediction
    # The noise between tests, which rests do not show, is in what the errors leave.
    left = discrepancy.noise_metric(problem).marginalise(errors).without_nuisances(residual)
    metric = discrepancy.noise_metric(problem, problem.measured - left)
    errors, shapes, residual = map(metric.whiten_noise, (errors, shapes, residual))
    sums = [SessionSums.of(errors[there], shapes[there], residual[there]) for there in rows]
    evidence = evidence_of(sums[0], sums[1:])
    if evidence.kind < len(kinds):
        (effect, values), = kinds[evidence.kind].items()
        kind = next(one for one in (*system.effects, *system.inputs) if one.id == effect)
        parameter, unit = kind.size.name, kind.size.unit
        spread = values[parameter] - kind.neutral
    else:
        effect, unit, spread = sessions.CONTACT_CHANGE, '1', CONTACT_STEP
        parameter = QUANTITIES[evidence.kind - len(kinds)]
    deviations = np.hypot(evidence.deviations, sessions.DEFINITION * evidence.sizes)
    return ChangeSeries((base, *later), evidence, effect, parameter, unit, spread * evidence.sizes,
                        spread * deviations)
