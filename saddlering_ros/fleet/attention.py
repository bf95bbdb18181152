"""The judgement of a fleet: sessions, rings and rigs that need attention, with reasons."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.fleet import observations, statistics
from saddlering_ros.fleet.drifts import (
    Drift,
    histories_of,
    RingHistory,
    significant_drifts,
    words_of,
)
from saddlering_ros.fleet.history import History, remaining_life, RemainingLife
from saddlering_ros.fleet.observations import COORDINATES, FleetError, PARAMETERS, SessionFigures
from saddlering_ros.fleet.statistics import combined, Population, Unlikeness
from saddlering_ros.progress import one_blas_thread
from saddlering_ros.quantities import finite_json

Array = NDArray[np.float64]

@dataclass(frozen=True)
class RingJudgement:
    """One ring: its sessions, whether they hold a finding, and how it compares and drifts."""

    ring: str
    bench: str
    sessions: tuple[SessionFigures, ...]
    e_value: float
    finding: bool
    unlike: Unlikeness | None
    history: RingHistory
    drift: Drift | None
    life: Mapping[str, RemainingLife]

    @property
    def concern(self) -> float:
        """Order of the table: rings that need a person first."""
        return len(self.reasons) + min(math.log10(max(self.e_value, 1.0)), 99.0) / 100.0

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the ring needs a person, in words; none if it does not."""
        answer = []
        if self.finding:
            names = sorted({name for item in self.sessions for name in item.causes})
            answer.append('finding: ' + (', '.join(names).replace('_', ' ') or 'cause unknown'))
        if self.unlike is not None and self.unlike.stands:
            strongest = COORDINATES[int(np.argmax(np.abs(self.unlike.z_scores)))]
            answer.append(f'unlike the other rings in {words_of([strongest])}')
        if self.drift is not None:
            answer.append(f'drifts: {words_of(self.drift.group)}')
        answer += filter(None, [self.sessions[-1].change])
        return tuple(answer)


@dataclass(frozen=True)
class Fleet:
    """Everything found about a fleet."""

    sessions: tuple[SessionFigures, ...]
    session_stands: NDArray[np.bool_]
    rings: tuple[RingJudgement, ...]
    rigs: tuple[Drift, ...]
    population: Population | None
    inflation: float


@one_blas_thread()
def judge_fleet(
    sessions: Sequence[SessionFigures], limits: Mapping[str, float] | None = None,
) -> Fleet:
    """The judgement on all sessions; `limits`: of K and D (SI) by name, for remaining life."""
    judged = [item for item in sessions if item.verdict != 'failed']
    stands = statistics.benjamini_hochberg([item.p_value for item in judged])
    rings: dict[str, list[SessionFigures]] = {session.ring: [] for session in judged}
    for session in sorted(judged, key=lambda item: (math.isnan(item.time), item.time, item.name)):
        rings[session.ring].append(session)
    inflation = statistics.scatter_inflation([_measured(own) for own in rings.values()])
    unlike, population = _compared(rings, inflation)
    histories = {ring: histories_of(ring, [
        replace(one, covariance=inflation * one.covariance) for one in own])
        for ring, own in rings.items()}
    drifting, rigs = significant_drifts(list(histories.values()))
    of_ring = {item.owner: item for item in drifting}
    evidence = {ring: statistics.e_value([item.p_value for item in own])
                for ring, own in rings.items()}
    # e-BH: at any dependence between the rings.
    findings = dict(zip(evidence, statistics.benjamini_hochberg(
        [1.0 / max(value, 1e-300) for value in evidence.values()]), strict=True))
    answer = [
        RingJudgement(
            ring=ring, bench=own[-1].bench, sessions=tuple(own), e_value=evidence[ring],
            finding=bool(findings[ring]), unlike=unlike.get(ring), history=histories[ring],
            drift=of_ring.get(ring),
            life=_lives(histories[ring], own, limits or {}) if ring in of_ring else {})
        for ring, own in rings.items()
    ]
    answer.sort(key=lambda item: (-item.concern, item.ring))
    return Fleet(
        sessions=tuple(judged), session_stands=stands, rings=tuple(answer), rigs=tuple(rigs),
        population=population, inflation=inflation)


def _measured(sessions: Sequence[SessionFigures]) -> tuple[list[Array], list[Array]]:
    """Values and covariances of the sessions that measured every coordinate."""
    good = [session for session in sessions if np.isfinite(session.covariance).all()]
    return [session.value for session in good], [session.covariance for session in good]


def _compared(
    rings: Mapping[str, Sequence[SessionFigures]], inflation: float,
) -> tuple[dict[str, Unlikeness], Population | None]:
    measured = {ring: _measured(sessions) for ring, sessions in rings.items()}
    measured = {ring: pair for ring, pair in measured.items() if pair[0]}
    if len(measured) < statistics.MIN_RINGS:
        return {}, None
    pairs = [combined(values, covariances, inflation) for values, covariances in measured.values()]
    means = np.array([mean for mean, _ in pairs])
    covariances = np.array([covariance for _, covariance in pairs])
    unlike, population = statistics.unlike_sisters(means, covariances)
    return dict(zip(measured, unlike, strict=True)), population


def _lives(
    history: RingHistory, sessions: Sequence[SessionFigures], limits: Mapping[str, float],
) -> dict[str, RemainingLife]:
    answer = {}
    for name, limit in limits.items():
        number = PARAMETERS.index(name)
        if COORDINATES[number] not in history.of:
            continue
        reached = math.log(limit)
        if name.startswith('K'):  # at the ring's own mean exponent
            exponent = float(np.nanmean([item.value[number + 1] for item in sessions]))
            reached += (exponent - 1.0) * math.log(observations.REFERENCE_PENETRATION)
        life = remaining_life(history.of[COORDINATES[number]], reached)
        if life is not None:
            answer[name] = life
    return answer


def limits_from_text(texts: Sequence[str]) -> dict[str, float]:
    """Limits given as NAME=VALUE; FleetError names the one that cannot be used."""
    limits = {}
    for text in texts:
        name, _, value = text.partition('=')
        allowed = [item for item in PARAMETERS if not item.startswith('n')]
        if name not in allowed:
            raise FleetError(f'--limit {text}: give one of {", ".join(allowed)} as K1=6e7')
        try:
            limits[name] = float(value)
        except ValueError:
            raise FleetError(f'--limit {text}: {value!r} is not a number') from None
        if not (math.isfinite(limits[name]) and limits[name] > 0.0):
            raise FleetError(f'--limit {text}: give a number above 0 (SI units)')
    return limits


def fleet_document(fleet: Fleet) -> dict[str, Any]:
    """fleet.json: plain data, numbers that are not finite as null."""
    document: dict[str, Any] = finite_json({
        'level': statistics.LEVEL,
        'sessions': {
            'total': len(fleet.sessions),
            'verdicts': dict(Counter(session.verdict for session in fleet.sessions)),
            'findings': [item.key for item, real in zip(
                fleet.sessions, fleet.session_stands, strict=True) if real],
        },
        'scatter_inflation': fleet.inflation,
        'coordinates': list(COORDINATES),
        'reference_penetration': observations.REFERENCE_PENETRATION,
        'population': None if fleet.population is None else {
            'mean': fleet.population.mean.tolist(),
            'mean_covariance': fleet.population.mean_covariance.tolist(),
            'between_rings': fleet.population.between.tolist()},
        'rigs': [_drift_document(item) for item in fleet.rigs],
        'rings': [_ring_document(item) for item in fleet.rings],
    })
    return document


def _ring_document(ring: RingJudgement) -> dict[str, Any]:
    return {
        'ring': ring.ring, 'rig': ring.bench, 'reasons': list(ring.reasons),
        'sessions': [session.key for session in ring.sessions],
        'e_value': ring.e_value, 'finding': ring.finding,
        'unlike_sisters': None if ring.unlike is None else {
            'p_value': ring.unlike.p_value, 'stands': ring.unlike.stands,
            'z_scores': dict(zip(COORDINATES, ring.unlike.z_scores.tolist(), strict=True)),
        },
        'drift': None if ring.drift is None else _drift_document(ring.drift),
        'history': {
            'clock': ring.history.clock,
            'coordinates': {name: _history_document(history)
                            for name, history in ring.history.of.items()},
        },
        'remaining_life': {name: {**vars(life), 'clock': ring.history.clock}
                           for name, life in ring.life.items()},
    }


def _history_document(history: History) -> dict[str, Any]:
    arrays = {**vars(history.series), 'level': history.level, 'level_std': history.level_std}
    numbers = ('slope', 'slope_std', 'drift_p_value', 'predictions', 'coverage')
    return {**{name: array.tolist() for name, array in arrays.items()},
            **{name: getattr(history, name) for name in numbers}}


def _drift_document(drift: Drift) -> dict[str, Any]:
    return {**vars(drift), 'slopes': {name: {'value': value, 'std': std}
                                      for name, (value, std) in drift.slopes.items()}}
