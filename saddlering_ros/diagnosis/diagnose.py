"""Bags in, verdict out: records, ring system and engine joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from saddlering_ros.bags import read_run, refuse_other_rig, refuse_repeats, rig_in_words
from saddlering_ros.diagnosis import next_test
from saddlering_ros.diagnosis.contact_law import contact_law, identified
from saddlering_ros.diagnosis.document import signature_cosines
from saddlering_ros.diagnosis.proposals import propose
from saddlering_ros.diagnosis.records import (
    build_record,
    check_set,
    DiagnosisError,
    PreparedRecord,
    rigs_of,
)
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.diagnosis.verdict import run_figures, RunFigures, Verdict
from saddlering_ros.discrepancy import diagnose, Diagnosis, Settings
from saddlering_ros.effects import catalogue, LawEffect
from saddlering_ros.identification import Identification
from saddlering_ros.progress import IsCancelled, OnProgress, Progress
from saddlering_ros.quantities import is_left, MATERIAL
from saddlering_ros.record import condensed, fit_limit, Record
from saddlering_ros.rig import ContactParameters, ParameterSet, Rig

__all__ = ['DiagnosisError', 'Verdict', 'diagnose_bags', 'diagnose_runs']


def diagnose_bags(
    bags: Sequence[Path | str],
    hold_out: Sequence[Path | str] = (),
    rig: Rig | None = None,
    parameters: ParameterSet | None = None,
    on_progress: OnProgress | None = None,
    is_cancelled: IsCancelled | None = None,
    seed: int = 0,
) -> Verdict:
    """Diagnosis of the simulation on `bags`, judged on `hold_out` if given."""
    from saddlering_ros.rig import default_rig

    if not bags:
        raise DiagnosisError('no bags to diagnose: give at least one')
    rig = rig or default_rig()
    runs = [read_run(bag, rig=rig) for bag in bags]
    held_out = [read_run(bag, rig=rig) for bag in hold_out]
    refuse_other_rig([*runs, *held_out], rig, is_given=True)
    refuse_repeats(runs, held_out)
    limit = fit_limit([*runs, *held_out])
    runs, held_out = ([condensed(run, rig, limit) for run in some] for some in (runs, held_out))
    return diagnose_runs(runs, held_out, rig, parameters, on_progress=on_progress,
                         is_cancelled=is_cancelled, seed=seed)


def diagnose_runs(
    runs: Sequence[Record],
    hold_out: Sequence[Record] = (),
    rig: Rig | None = None,
    parameters: ParameterSet | None = None,
    *,
    on_progress: OnProgress | None = None,
    is_cancelled: IsCancelled | None = None,
    seed: int = 0,
    settings: Settings | None = None,
) -> Verdict:
    """The same for runs that have been read."""
    from saddlering_ros.rig import default_rig

    rig = rig or default_rig()
    if not runs:
        raise DiagnosisError('no runs to diagnose: give at least one')
    refuse_repeats(runs, hold_out)
    records = [build_record(rig, run, held_out=False) for run in runs]
    records += [build_record(rig, run, held_out=True) for run in hold_out]
    records = _named_apart(records)
    if on_progress is not None:
        on_progress(Progress('diagnose', 'contact parameters', 0.0))
    alone = identified(runs, rig, is_cancelled)
    if parameters is None and isinstance(alone, Identification):
        parameters = alone.parameters
    start = None
    if parameters is not None:
        start = dict(
            zip(ContactParameters.__dataclass_fields__, parameters.contact.to_array(), strict=True)
        )
    system = RingSystem(rig)
    fitted = [record.run for record in records if not record.run.held_out]
    found = diagnose(
        system,
        fitted,
        hold_out=[record.run for record in records if record.run.held_out],
        settings=settings or Settings(seed=seed),
        start=start,
        proposals=propose(rig, fitted),
        on_progress=on_progress,
        is_cancelled=is_cancelled,
    )
    figures = tuple(
        run_figures(rig, found, record, residual.before, residual.after)
        for record, residual in zip(records, found.runs, strict=True)
    )
    law = contact_law(found, runs, alone)
    notes = [*check_set(records, rig), *found.warnings, *law.notes]
    notes += next_test.repeated_laws(_own_laws(found), signature_cosines(found))
    notes += [f'{record.run.name}: {note}' for record in records for note in record.test_run.notes]
    if found.verdict == 'unknown' and _is_rounding(figures):
        found = replace(found, verdict='none', causes=())
        notes.append('the misfit does not exceed the noise, which includes the rounding of the '
                     'coarse probes')
    sentence = _geometry_first(_next_test(found), found, [*runs, *hold_out], rig)
    rigs = rigs_of(records)
    if len(rigs) > 1 and found.verdict != 'none':
        # A difference between the rigs would be named as a cause.
        found = replace(found, verdict='unknown')
        sentence = f'Diagnose the bags of each rig separately: {", ".join(rigs)}.'
    return Verdict(found, figures, tuple(notes), sentence, rig, seed, law)


def _own_laws(found: Diagnosis) -> list[str]:
    """Laws of the user's folder among the causes found and their alternatives."""
    named = {name for cause in found.causes for name in cause.group}
    return sorted(name for name in named if isinstance(catalogue().get(name), LawEffect))


def _named_apart(records: list[PreparedRecord]) -> list[PreparedRecord]:
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


def _is_rounding(figures: Sequence[RunFigures]) -> bool:
    """Whether probes are so coarse that the residual may be their rounding."""
    is_coarse = any(
        quality.is_coarse
        for run in figures for quality in run.record.test_run.quality.values())
    return is_coarse and all(
        item.nrmse_before <= item.noise_floor
        for run in figures for item in run.channels.values())


def _geometry_first(
    sentence: str | None, found: Diagnosis, runs: Sequence[Record], rig: Rig,
) -> str | None:
    """The advice with the rig file before the hardware, if no hash identifies the file.

    A wrong dimension causes a misfit with a shape of no cause. The drawing shows it without
    tools.
    """
    if found.verdict != 'unknown' or all(run.rig_hash == rig.digest for run in runs):
        return sentence
    first = (f'First compare the rig file with the ring ({rig_in_words(rig)}): saddlering rig '
             '--check BAG and its drawing show a wrong dimension, span, polarity or elevation.')
    return f'{first} {sentence}' if sentence else first


def _next_test(found: Diagnosis) -> str | None:
    """The most valuable next test, and the cause that each outcome means."""
    if found.verdict == 'unknown':
        return _test_for_shape(found)
    if found.verdict == 'none':
        return next_test.for_unseen(
            [item.effect for item in found.observability.limits if not item.testable])
    open_groups = [cause.group for cause in found.causes if len(cause.group) > 1]
    if not open_groups:
        named = found.causes[0].effect
        return next_test.confirming(named, next_test.look_alikes(named, signature_cosines(found)))
    sentence = next_test.for_group(open_groups[0], found.separations)
    return sentence or catalogue()[open_groups[0][0]].settled_by


def _test_for_shape(found: Diagnosis) -> str:
    """The test for the largest part of the misfit that no cause explains."""
    left = found.residual_after
    shapes = [shape for shape in left.shapes if is_left(shape.p_value, shape.visible)]
    largest = max(shapes or left.shapes, key=lambda shape: shape.visible)
    swing = left.fast
    if swing.visible >= max(MATERIAL, largest.visible):
        return next_test.for_swing(swing.view, swing.frequency)
    return next_test.for_shape(largest.view, largest.coordinate)
