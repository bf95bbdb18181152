"""The verdict document: a verdict as the JSON of interfaces.md."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np

from saddlering_ros.diagnosis.contract import ShapeEntry, SimulatedTestEntry, VerdictDocument
from saddlering_ros.diagnosis.proposed_law import proposal_document
from saddlering_ros.diagnosis.wording import shape_words, swing_words
from saddlering_ros.discrepancy import Cause, Diagnosis, Evidence, Separation, ShapeTest
from saddlering_ros.quantities import finite_json, is_left, MATERIAL

if TYPE_CHECKING:
    from saddlering_ros.diagnosis.contact_law import ContactLaw
    from saddlering_ros.diagnosis.verdict import RunFigures, Verdict


def verdict_document(verdict: Verdict) -> VerdictDocument:
    """The contract of interfaces.md, with additions beside it."""
    found = verdict.diagnosis
    document = {
        'verdict': found.verdict,
        'causes': _causes(found),
        'runs': [_run_json(figures) for figures in verdict.runs],
        'parameters': _parameters(verdict.contact_law),
        'next_test': verdict.next_test,
        'simulated_tests': [_separation_json(item) for item in found.separations],
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
                    for place in item.configurations
                ],
            }
            for item in found.observability.limits
        ],
        'immaterial': [_evidence_json(item) for item in found.search.immaterial],
        'unexplained': [_shape_json(item) for item in found.residual_after.shapes[:8]],
        'candidates': [_candidate_json(item) for item in found.search.candidates],
        'shapes': {
            'before': [_shape_json(item) for item in found.residual_before.shapes],
            'after': [_shape_json(item) for item in found.residual_after.shapes],
        },
        'signature_cosines': signature_cosines(found),
        'gain': {
            'fit': found.gain.fit,
            'held_out': found.gain.held_out,
            'how': found.gain.how,
        },
        'proposal': proposal_document(found.law, verdict.effect_files),
        'notes': list(verdict.notes),
        'provenance': verdict.provenance().as_dict(),
        'seed': verdict.seed,
        'seconds': found.seconds,
    }
    answer: VerdictDocument = finite_json(document)
    return answer


def _causes(found: Diagnosis) -> list[dict[str, Any]]:
    if found.verdict == 'none':
        return []
    causes = [_cause_json(cause) for cause in found.causes]
    if found.verdict != 'unknown':
        return causes
    left = found.residual_after
    shapes = [
        _shape_json(shape) for shape in left.shapes if is_left(shape.p_value, shape.visible)
    ]
    described: list[dict[str, Any]] = [
        {'shape': shape_words(shape), **shape} for shape in shapes[:4]
    ]
    fast = left.fast
    if fast.visible >= MATERIAL:
        described.append(
            {
                'shape': swing_words(fast.view, fast.frequency, fast.run, fast.visible),
                'channel': fast.view,
                'coordinate': 'time',
                'p_value': fast.p_value,
                'share_of_range': fast.visible,
            }
        )
    return [*described, *({**cause, 'partial': True} for cause in causes)]


def _parameters(law: ContactLaw) -> dict[str, Any]:
    """Values and standard deviations, null for undetermined parameters, and the reasons."""
    after: dict[str, float | None] = {}
    for name, item in law.after.items():
        after[name] = item.value
        after[f'{name}_std'] = None if name in law.reasons_after else item.std
    return {
        'before': {name: item.value for name, item in law.before.items()},
        'after': after,
        'before_std': {
            name: None if name in law.reasons_before else item.std
            for name, item in law.before.items()
        },
        'undetermined': {'before': dict(law.reasons_before), 'after': dict(law.reasons_after)},
    }


def _run_json(figures: RunFigures) -> dict[str, Any]:
    record = figures.record
    return {
        'bag': str(record.test_run.path),
        'elevation_deg': float(np.degrees(record.test_run.elevation)),
        'test': record.test_run.test,
        'held_out': record.run.held_out,
        'channels': {name: vars(item) for name, item in figures.channels.items()},
    }


def _separation_json(separation: Separation) -> SimulatedTestEntry:
    return {
        'test': separation.proposal.sentence,
        'kind': separation.proposal.kind,
        'draws': separation.draws,
        'share_alone': separation.share,
        'interval_95': list(separation.interval),
        'share_kept': separation.kept / separation.draws,
        'by_truth': {' + '.join(ids): share for ids, share in separation.by_truth.items()},
    }


def _cause_json(cause: Cause) -> dict[str, Any]:
    return {
        'effect': cause.effect,
        'group': list(cause.group),
        'parameters': {
            name: {'value': item.value, 'std': item.std, 'unit': item.unit}
            for name, item in cause.parameters.items()
        },
        'evidence': {'p_value': cause.p_value, 'delta_bic': cause.delta_bic},
        'gain': {'fit': cause.gain.fit, 'held_out': cause.gain.held_out},
        'share_of_range': cause.visible,
        'title': cause.definition.title,
    }


def _evidence_json(item: Evidence) -> dict[str, Any]:
    return {'effects': list(item.effects), 'p_value': item.p_value, 'share_of_range': item.visible}


MIN_COSINE = 0.3
"""Cosine below which two signatures are left out of the verdict's JSON."""


def signature_cosines(found: Diagnosis) -> dict[str, dict[str, float]]:
    """Every signature with similar ones: 1 means that these data cannot separate them."""
    labels = found.observability.labels
    return {
        label: {
            other: round(float(value), 3)
            for other, value in zip(labels, row, strict=True)
            if other != label and value >= MIN_COSINE
        }
        for label, row in zip(labels, found.observability.cosines, strict=True)
    }


def _candidate_json(item: Evidence) -> dict[str, Any]:
    return {
        **_evidence_json(item),
        'step': item.step,
        'delta_bic': item.delta_bic,
        'misfit': item.misfit,
        'parameters': {effect: dict(values) for effect, values in item.values.items()},
    }


def _shape_json(item: ShapeTest) -> ShapeEntry:
    return {
        'channel': item.view,
        'coordinate': item.coordinate,
        'p_value': item.p_value,
        'share_of_range': item.visible,
    }
