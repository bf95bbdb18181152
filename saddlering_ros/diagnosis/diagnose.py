"""Bags in, verdict out: records, ring system, engine, and the JSON that interfaces.md promises."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags import read_run, TestRun
from saddlering_ros.diagnosis import next_test
from saddlering_ros.diagnosis.proposals import course_of, propose
from saddlering_ros.diagnosis.records import (
    Array,
    build_record,
    check_set,
    DiagnosisError,
    Record,
    rigs_of,
)
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.diagnosis.wording import shape_words, swing_words
from saddlering_ros.discrepancy import Cause, diagnose, Diagnosis, Run, Settings
from saddlering_ros.discrepancy.engine import Evidence
from saddlering_ros.discrepancy.lack_of_fit import ShapeTest
from saddlering_ros.effects import catalogue
from saddlering_ros.provenance import Provenance
from saddlering_ros.rig import (
    CHANNELS,
    ContactParameters,
    ParameterSet,
    ParameterSource,
    probes_to_displacement,
    Rig,
)
from saddlering_ros.thresholds import is_left, MATERIAL

__all__ = ['DiagnosisError', 'Verdict', 'diagnose_bags', 'diagnose_runs']


@dataclass(frozen=True)
class ChannelFigures:
    """One channel of one run: rms misfit over the channel's measured range, and the noise's."""

    nrmse_before: float
    nrmse_after: float
    noise_floor: float


@dataclass(frozen=True)
class RunFigures:
    """One run with its channels, and its arrays: displacement (4, N) in the order of CHANNELS."""

    record: Record
    channels: Mapping[str, ChannelFigures]
    measured: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class Verdict:
    """The verdict on a set of bags: the engine's diagnosis with what the ring adds to it."""

    diagnosis: Diagnosis
    runs: tuple[RunFigures, ...]
    notes: tuple[str, ...]
    next_test: str | None
    rig: Rig
    seed: int

    @property
    def verdict(self) -> str:
        return self.diagnosis.verdict

    def extended_parameters(self) -> ParameterSet:
        """Contact parameters after the diagnosis, with the effects found.

        Steady lines stay out: their phase starts anew with every run.
        """
        found = self.diagnosis
        values = np.array([estimate.value for estimate in found.base_after.values()])
        effects = (
            {
                cause.effect.id: {name: item.value for name, item in cause.estimates.items()}
                for cause in found.causes
                if not cause.effect.line
            }
            if found.verdict in ('named', 'ambiguous')
            else {}
        )
        made = self.provenance(held_out=False)
        source = ParameterSource(
            method='diagnose',
            bags=tuple(origin.path for origin in made.bags),
            objective=float(found.after.misfit),
            covariance=found.base_covariance,
            note=f'verdict {found.verdict}, seed {self.seed}',
            sha256=tuple(origin.sha256 for origin in made.bags),
            versions=made.versions_in_words,
        )
        return ParameterSet(ContactParameters.from_array(values), effects, source)

    def provenance(self, *, held_out: bool = True) -> Provenance:
        """Its bags (those held out too, if asked) and what computed it."""
        return Provenance(tuple(
            figures.record.test_run.origin for figures in self.runs
            if held_out or not figures.record.run.held_out))

    def to_json(self) -> dict[str, Any]:
        """The contract of interfaces.md, with additions beside it."""
        found = self.diagnosis
        after: dict[str, float] = {}
        for name, estimate in found.base_after.items():
            after[name], after[f'{name}_std'] = estimate.value, estimate.std
        document = {
            'verdict': found.verdict,
            'causes': self._causes(),
            'runs': [_run_json(figures) for figures in self.runs],
            'parameters': {
                'before': {name: item.value for name, item in found.base_before.items()},
                'after': after,
            },
            'next_test': self.next_test,
            'detection_limits': [
                {
                    'effect': item.effect,
                    'limit': item.limit,
                    'best_limit': item.best_limit,
                    'material_limit': item.material_limit,
                    'unit': item.unit,
                    'share': item.share,
                    'testable': item.testable,
                    'places': [
                        {
                            'values': dict(place.values),
                            'limit': place.limit,
                            'material_limit': place.material_limit,
                        }
                        for place in item.places
                    ],
                }
                for item in found.detectability
            ],
            'immaterial': [_evidence_json(item) for item in found.immaterial],
            'unexplained': [_shape_json(item) for item in found.shapes_after[:8]],
            'candidates': [_candidate_json(item) for item in found.evidence],
            'shapes': {
                'before': [_shape_json(item) for item in found.shapes_before],
                'after': [_shape_json(item) for item in found.shapes_after],
            },
            'signature_cosines': _cosines(found),
            'gain': {
                'fit': found.total_gain.fit,
                'held_out': found.total_gain.held_out,
                'how': found.total_gain.how,
            },
            'notes': list(self.notes),
            'provenance': self.provenance().as_dict(),
            'seed': self.seed,
            'seconds': found.seconds,
        }
        answer: dict[str, Any] = _finite(document)
        return answer

    def _causes(self) -> list[dict[str, Any]]:
        found = self.diagnosis
        if found.verdict == 'none':
            return []
        causes = [_cause_json(cause) for cause in found.causes]
        if found.verdict != 'unknown':
            return causes
        shapes = [_shape_json(shape) for shape in found.shapes_after
                  if is_left(shape.p_value, shape.visible)]
        described = [{'shape': shape_words(shape), **shape} for shape in shapes[:4]]
        swift = found.ripple_after
        if swift.visible >= MATERIAL:
            described.append({
                'shape': swing_words(swift.view, swift.frequency, swift.run, swift.visible),
                'channel': swift.view, 'coordinate': 'time', 'p_value': swift.p_value,
                'share_of_range': swift.visible,
            })
        return [*described, *({**cause, 'partial': True} for cause in causes)]


def diagnose_bags(
    bags: Sequence[Path | str],
    hold_out: Sequence[Path | str] = (),
    rig: Rig | None = None,
    parameters: ParameterSet | None = None,
    on_progress: Callable[[str, float], None] | None = None,
    is_cancelled: Callable[[], bool] | None = None,
    seed: int = 0,
) -> Verdict:
    """What the simulation gets wrong in `bags`, judged on `hold_out` where given."""
    from saddlering_ros.rig import default_rig

    if not bags:
        raise DiagnosisError('no bags to diagnose: give at least one')
    rig = rig or default_rig()
    return diagnose_runs(
        [read_run(bag, rig=rig) for bag in bags],
        [read_run(bag, rig=rig) for bag in hold_out],
        rig,
        parameters,
        on_progress,
        is_cancelled,
        seed,
    )


def diagnose_runs(
    runs: Sequence[TestRun],
    hold_out: Sequence[TestRun] = (),
    rig: Rig | None = None,
    parameters: ParameterSet | None = None,
    on_progress: Callable[[str, float], None] | None = None,
    is_cancelled: Callable[[], bool] | None = None,
    seed: int = 0,
    settings: Settings | None = None,
) -> Verdict:
    """The same for runs that have been read."""
    from saddlering_ros.rig import default_rig

    rig = rig or default_rig()
    if not runs:
        raise DiagnosisError('no runs to diagnose: give at least one')
    records = [build_record(rig, run, held_out=False) for run in runs]
    records += [build_record(rig, run, held_out=True) for run in hold_out]
    records = _named_apart(records)
    start = None
    if parameters is not None:
        start = dict(
            zip(ContactParameters.__dataclass_fields__, parameters.contact.to_array(), strict=True)
        )
    system = RingSystem(rig)
    found = diagnose(
        system,
        [record.run for record in records],
        settings or Settings(seed=seed),
        start=start,
        proposals=propose(rig, [record.run for record in records if not record.run.held_out]),
        on_progress=on_progress,
        is_cancelled=is_cancelled,
    )
    figures = tuple(
        _figures(rig, found, record, residual.before, residual.after)
        for record, residual in zip(records, found.runs, strict=True)
    )
    notes = [*check_set(records, rig), *found.notes]
    notes += [f'{record.run.name}: {note}' for record in records for note in record.test_run.notes]
    sentence = _next_test(found)
    rigs = rigs_of(records)
    if len(rigs) > 1 and found.verdict != 'none':
        # What parts one rig from another would get the name of a cause.
        found = replace(found, verdict='unknown')
        sentence = f'Diagnose the bags of each rig apart: {", ".join(rigs)}.'
    return Verdict(found, figures, tuple(notes), sentence, rig, seed)


def _named_apart(records: list[Record]) -> list[Record]:
    """Records whose runs have different names."""
    seen: dict[str, int] = {}
    answer = []
    for record in records:
        count = seen.get(record.run.name, 0)
        seen[record.run.name] = count + 1
        if count:
            run = replace(record.run, name=f'{record.run.name} ({count + 1})')
            record = replace(record, run=run)
        answer.append(record)
    return answer


def _figures(
    rig: Rig, found: Diagnosis, record: Record, before: Array, after: Array
) -> RunFigures:
    run = record.run
    seen = [_displacement(rig, item) for item in (run.channels, before, after)]
    channels = {}
    for index, name in enumerate(CHANNELS):
        measured, first, last = (item[index] for item in seen)
        span = max(float(np.ptp(measured)), 1e-12)
        weights = found.likelihood.system.views[name]
        noise = _noise_floor(found, run, weights)
        channels[name] = ChannelFigures(
            _rms(first - measured) / span, _rms(last - measured) / span, noise / span
        )
    return RunFigures(record, channels, *seen)


ZERO_SPAN = 0.5
"""Length of record [s] whose mean is a run's zero."""


def _noise_floor(found: Diagnosis, run: Run, weights: Array) -> float:
    """Rms noise of a view over the run's block means, the zero's own noise with it."""
    known = found.likelihood.noise
    fitted = run.name if (run.name, 0) in known else _alike(found, run)
    start = float(run.time[0])
    power = sum(
        float(weight) ** 2
        * float(
            np.mean(
                known[fitted, channel].since(run.time, run.width, start - ZERO_SPAN, ZERO_SPAN)
                ** 2
            )
        )
        for channel, weight in enumerate(weights)
        if weight
    )
    return math.sqrt(power)


def _alike(found: Diagnosis, run: Run) -> str:
    """The fitted run whose block means are as long as those of a run held out."""
    width = float(np.median(run.width))
    fitted = found.likelihood.runs
    return min(fitted, key=lambda item: abs(np.log(np.median(item.width) / width))).name


def _displacement(rig: Rig, increments: Array) -> NDArray[np.float64]:
    motion = probes_to_displacement(rig.probes, increments)
    return np.stack([np.asarray(getattr(motion, name)) for name in CHANNELS])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _run_json(figures: RunFigures) -> dict[str, Any]:
    record = figures.record
    return {
        'bag': str(record.test_run.path),
        'elevation_deg': float(np.degrees(record.test_run.elevation)),
        'test': record.test_run.test,
        'held_out': record.run.held_out,
        'channels': {name: vars(item) for name, item in figures.channels.items()},
    }


def _cause_json(cause: Cause) -> dict[str, Any]:
    return {
        'effect': cause.effect.id,
        'group': list(cause.group),
        'parameters': {
            name: {'value': item.value, 'std': item.std, 'unit': item.unit}
            for name, item in cause.estimates.items()
        },
        'evidence': {'p_value': cause.p_value, 'delta_bic': cause.delta_bic},
        'gain': {'fit': cause.gain.fit, 'held_out': cause.gain.held_out},
        'share_of_range': cause.visible,
        'title': cause.effect.title,
    }


def _evidence_json(item: Evidence) -> dict[str, Any]:
    return {'effects': list(item.effects), 'p_value': item.p_value, 'share_of_range': item.visible}


LEAST_COSINE = 0.3
"""Signatures further apart than this are left out of the verdict's JSON."""


def _cosines(found: Diagnosis) -> dict[str, dict[str, float]]:
    """Every signature with those that look like it: 1 means that these data cannot tell them."""
    return {
        label: {
            other: round(float(value), 3)
            for other, value in zip(found.angle_labels, row, strict=True)
            if other != label and value >= LEAST_COSINE
        }
        for label, row in zip(found.angle_labels, found.angles, strict=True)
    }


def _candidate_json(item: Evidence) -> dict[str, Any]:
    return {
        **_evidence_json(item),
        'step': item.step,
        'delta_bic': item.delta_bic,
        'misfit': item.misfit,
        'parameters': {effect: dict(values) for effect, values in item.values.items()},
    }


def _shape_json(item: ShapeTest) -> dict[str, Any]:
    return {
        'channel': item.view,
        'coordinate': item.coordinate,
        'p_value': item.p_value,
        'share_of_range': item.visible,
    }


def _next_test(found: Diagnosis) -> str | None:
    """The one test that is worth most now, with which outcome means which cause."""
    if found.verdict == 'unknown':
        return _test_for_shape(found)
    if found.verdict == 'none':
        return next_test.for_unseen(
            [item.effect for item in found.detectability if not item.testable])
    open_groups = [cause.group for cause in found.causes if len(cause.group) > 1]
    if not open_groups:
        named = found.causes[0].effect.id
        return next_test.confirming(named, next_test.look_alikes(named, _cosines(found)))
    course = course_of(found.next_test)
    sentence = next_test.between(open_groups[0], course)
    if sentence is None and course is not None:
        sentence = course.sentence
    return sentence or catalogue()[open_groups[0][0]].settled_by


def _test_for_shape(found: Diagnosis) -> str:
    """What to do about the largest part of the misfit that nothing explains."""
    shapes = [shape for shape in found.shapes_after if is_left(shape.p_value, shape.visible)]
    largest = max(shapes or found.shapes_after, key=lambda shape: shape.visible)
    swing = found.ripple_after
    if swing.visible >= max(MATERIAL, largest.visible):
        return next_test.for_swing(swing.view, swing.frequency)
    return next_test.for_shape(largest.view, largest.coordinate)


def _finite(value: Any) -> Any:
    """The same document with numbers JSON knows: infinite and undefined become null."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
