"""Runs in, verdict out: records, ring system and engine joined."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from saddlering_ros import discrepancy
from saddlering_ros.diagnosis import records as prepared
from saddlering_ros.diagnosis import verdict
from saddlering_ros.diagnosis.next_test import next_test, propose, repeated_laws
from saddlering_ros.diagnosis.raceways import explained_by_waves, waves_beside
from saddlering_ros.diagnosis.records import build_record, DiagnosisError, PreparedRecord
from saddlering_ros.diagnosis.rig_dimensions import certificate_notes
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Diagnosis, Settings
from saddlering_ros.doubts.wiring import units_of_notes, wiring_first
from saddlering_ros.effects import catalogue, LawEffect
from saddlering_ros.errors import Cancelled
from saddlering_ros.identification.methods import identify_plain, law_beside_errors
from saddlering_ros.identification.prepared import small_load
from saddlering_ros.identification.result import Identification
from saddlering_ros.identification.settings import IdentificationError
from saddlering_ros.identification.uncertainty import distinct_elevations, MAX_SOUND
from saddlering_ros.progress import IsCancelled, LAST_SHARE, OnProgress, Watch
from saddlering_ros.quantities import lowered, own_names, told_once
from saddlering_ros.record.record import Record
from saddlering_ros.rig import PARAMETER_NAMES, ParameterSet, Rig

BESIDE_WAVES = 40.0
"""Size over the spread of small errors from which a cause stands out beside fitted waves, whatever
it takes. Without the law of its friction, a ring had another friction of 38 times."""

MAX_ASKED = 12.0
"""Misfit over that of noise and a sound ring up to which usual small errors are tried. Rings with
such errors had 2 to 12. Of twelve laws that are not listed six had more."""

SOUND = 0.75
"""Probability that nothing is wrong where usual small errors explain all runs, if a quarter of the
rings is sound. They did on 24 of 25 sound rings, and on 12 of 16 that hid a cause, most with less
than half of what all errors move, of 120 of which the others had a name. Of 31 laws that are not
listed they explain none."""

USUAL = (
    'usual small errors of ring and rig do not explain the misfit of all runs together',
    'usual small errors of ring and rig explain the misfit of all runs together, so that there '
    'need be no single cause')
NEXT_OF_USUAL = (
    'saddlering identify states the contact law beside usual small errors. saddlering compare '
    'with a later session shows what changes.')


def diagnose_ring(
    runs: Sequence[Record], hold_out: Sequence[Record] = (), *, rig: Rig,
    parameters: ParameterSet | None = None, seed: int = 0, on_progress: OnProgress | None = None,
    is_cancelled: IsCancelled | None = None,
) -> verdict.Verdict:
    """Diagnosis of the simulation of `rig` on runs, judged on `hold_out` if given.

    parameters: start of the fit of the contact law (None: its identification from the runs). No
    two runs may be one recording, which the reading of bags refuses.
    """
    if not runs:
        raise DiagnosisError('no runs to diagnose: give at least one')
    top = max(float(np.nanmax(run.load)) for run in runs)
    if top <= rig.limits.identification_min:
        raise DiagnosisError(str(small_load(runs[0], rig, top)))
    records = _records_of(runs, hold_out, rig)
    watch = Watch('diagnose', on_progress, is_cancelled)
    watch.progress('contact parameters', 0.0)
    alone = _law_alone(runs, rig, is_cancelled)
    if not isinstance(alone, str):
        parameters = parameters or alone.parameters
    system = RingSystem(rig, told=prepared.cut_off_probes(
        [record.run for record in records if not record.run.held_out], rig))
    diagnosis, of_waves = _diagnosed(system, records, parameters, seed, watch)
    if diagnosis.verdict == 'none' and all(run.test == 'static' for run in runs):
        diagnosis = _with_own_damping(diagnosis, records)
    figures = tuple(
        verdict.run_figures(rig, diagnosis, record, prediction.before, prediction.after)
        for record, prediction in zip(records, diagnosis.runs, strict=True))
    if diagnosis.verdict == 'none':  # what `validate` would not allow
        diagnosis = diagnosis.unpredicted(verdict.unpredicted(figures, system.units))
    law = verdict.contact_law(diagnosis, alone, distinct_elevations(run.elevation for run in runs))
    notes = [*of_waves, *_notes(records, rig, diagnosis, law.refusal)]
    if diagnosis.verdict == 'unknown' and _is_rounding(figures):
        diagnosis = diagnosis.as_none()
        notes.append('the misfit does not exceed the noise, which includes the rounding of the '
                     'coarse probes')
    rigs, is_usual = prepared.rigs_of(records), None
    if diagnosis.verdict == 'unknown' and len(rigs) == 1 and not isinstance(alone, str):
        is_usual = _is_usual([*runs, *hold_out], rig, alone, watch)
    watch.progress('notes', 1.0)
    if is_usual is not None:
        notes.append(USUAL[is_usual])
    if is_usual:
        diagnosis = _perhaps_sound(diagnosis)
    factor = 0.0 if isinstance(alone, str) else alone.sound_factor
    if factor > MAX_SOUND and diagnosis.verdict == 'none':
        notes.append(
            f'identify finds {factor:.2f} times the misfit of noise and small errors '
            'of a sound ring: smooth errors of the contact law, delays and noise of the load can '
            'explain this here, and so could a small cause')
    sentence = ' '.join(filter(None, (
        wiring_first(rig, [record.test_run for record in records]),
        'None is needed for a cause.' if is_usual and not diagnosis.separations else next_test(
            diagnosis, runs, hold_out, rig), NEXT_OF_USUAL if is_usual else '')))
    if len(rigs) > 1 and diagnosis.verdict != 'none':
        # A difference between the rigs would be named as a cause.
        diagnosis = diagnosis.in_doubt()
        sentence = f'Diagnose the bags of each rig separately: {", ".join(rigs)}.'
    return verdict.Verdict(diagnosis, figures, tuple(notes), sentence, rig, seed, law)


def _records_of(runs: Sequence[Record], hold_out: Sequence[Record],
                rig: Rig) -> list[PreparedRecord]:
    """Fitted and held-out runs in the form of the engine, each with a name of its own."""
    records = [*(build_record(rig, run, held_out=False) for run in runs),
               *(build_record(rig, run, held_out=True) for run in hold_out)]
    return [replace(record, run=replace(record.run, name=name)) for record, name in zip(
        records, own_names(record.run.name for record in records), strict=True)]


def _law_alone(runs: Sequence[Record], rig: Rig,
               is_cancelled: IsCancelled | None) -> Identification | str:
    """The contact law of runs without causes, or why there is none."""
    try:
        alone = identify_plain(runs, rig, is_cancelled=is_cancelled)
    except IdentificationError as refusal:
        return str(refusal)
    if alone.cancelled:
        raise Cancelled('diagnose: cancelled')
    return alone


def _diagnosed(
    system: RingSystem, records: Sequence[PreparedRecord], parameters: ParameterSet | None,
    seed: int, watch: Watch,
) -> tuple[Diagnosis, list[str]]:
    """The diagnosis from a start of the contact law; with notes if raceways may wave."""
    fitted = [record.run for record in records if not record.run.held_out]
    start = None if parameters is None else dict(
        zip(PARAMETER_NAMES, parameters.contact.to_array(), strict=True))
    diagnose = partial(
        discrepancy.diagnose, runs=fitted,
        hold_out=[record.run for record in records if record.run.held_out],
        proposals=propose(system.rig, fitted), is_cancelled=watch.is_cancelled)
    even = diagnose(system, start=start, settings=Settings(seed=seed),
                    on_progress=watch.on_progress)
    if even.verdict == 'none':
        return even, []
    on_progress = watch.on_progress
    return _beside_waves(system, records, even, partial(
        diagnose, settings=Settings(seed=seed, nearly_all_times=BESIDE_WAVES),
        on_progress=on_progress and (lambda report: on_progress(
            replace(report, stage=f'beside waves: {report.stage}')))), watch)


def _with_own_damping(diagnosis: Diagnosis, records: Sequence[PreparedRecord]) -> Diagnosis:
    """Predictions of dynamic held-out runs with D of each, which static runs do not determine."""
    problem = diagnosis.fits.metric.problem
    dynamic = {one.run.name for one in records if one.test_run.test == 'dynamic'}
    own = {run.name: problem.simulate(run, [fit.point])[0] for run, _, fit in
           discrepancy.refits_to_held_out(problem, diagnosis.fits.after) if run.name in dynamic}
    return replace(diagnosis, runs=tuple(
        replace(one, before=own[one.run.name], after=own[one.run.name])
        if one.run.name in own else one for one in diagnosis.runs))


def _is_rounding(runs: Sequence[verdict.RunFigures]) -> bool:
    """Whether a residual may be the rounding of a coarse probe: all of it is within noise."""
    is_coarse = any(one.is_coarse for run in runs for one in run.record.test_run.quality.values())
    return is_coarse and all(misfit.nrmse_before <= misfit.noise_floor
                             for run in runs for misfit in run.channels.values())


def _is_usual(
    runs: Sequence[Record], rig: Rig, alone: Identification, watch: Watch,
) -> bool | None:
    """Whether usual small errors of ring and rig explain runs; None where this is not asked.

    alone: the law of some of these runs without errors.
    """
    if not MAX_SOUND < alone.sound_factor < MAX_ASKED:
        return None
    watch.progress('usual small errors', LAST_SHARE)
    try:
        return law_beside_errors(
            runs, rig, alone, is_cancelled=watch.is_cancelled,
            on_progress=lambda _: watch.advance(LAST_SHARE)) is not None
    except IdentificationError:  # of a held-out run
        return None


def _perhaps_sound(diagnosis: Diagnosis) -> Diagnosis:
    """An open verdict if usual small errors explain all runs: no law is proposed."""
    share = (1.0 - SOUND) / max(1.0 - diagnosis.probabilities.get('none', 0.0), 1e-12)
    return replace(diagnosis, law=None, probabilities={
        **{name: share * one for name, one in diagnosis.probabilities.items()}, 'none': SOUND})


def _beside_waves(
    system: RingSystem, records: Sequence[PreparedRecord], even: Diagnosis,
    diagnose: Callable[..., Diagnosis], watch: Watch,
) -> tuple[Diagnosis, list[str]]:
    """The diagnosis beside waves of the raceways, if even raceways leave what waves explain.

    With it what the waves do, in a note. No cause of even raceways is established or excluded
    then. Readings that look like another unit, which no waves explain, establish no cause either.
    """
    doubted = even if even.verdict == 'unknown' else even.in_doubt()
    if any(units_of_notes(one.test_run.notes) for one in records):
        return doubted, []
    fitted = [record.run for record in records if not record.run.held_out]
    found = waves_beside(system, fitted, even, watch)
    if found is None:
        return even, []
    wavy, law = found
    beside = diagnose(wavy, start=dict(zip(PARAMETER_NAMES, law, strict=True)))
    if beside.verdict in ('named', 'ambiguous'):
        return beside, [
            'waves of the raceways are fitted beside the contact law, with and without causes, '
            'because even raceways leave a misfit that waves explain: an offset or a gain that '
            'does what waves do is not seen']
    best = [f'beside waves of the raceways the best explanation is '
            f'{lowered(cause.definition.title)}, which is not established'
            for cause in beside.causes[:1]]
    # Held-out runs part causes of even raceways, and none of these need be the cause.
    return replace(doubted, held_out_evidence=()), [*best, *explained_by_waves(
        wavy, [record.run for record in records], law, even.fits.before.point.base)]


def _notes(
    records: Sequence[PreparedRecord], rig: Rig, diagnosis: Diagnosis, refusal: str,
) -> list[str]:
    """Notes of the set, of the diagnosis and of each run; refusal: why no law was identified."""
    notes = [*prepared.check_set(records, rig), *diagnosis.warnings]
    if refusal:
        notes.append('the contact parameters are those of the diagnosis, not of an '
                     f'identification: {refusal}')
    named = {name for cause in diagnosis.causes for name in cause.group}
    laws_of_user = sorted(name for name in named if isinstance(catalogue().get(name), LawEffect))
    return [*notes, *certificate_notes(rig, diagnosis.causes),
            *repeated_laws(laws_of_user, verdict.signature_cosines(diagnosis)),
            *told_once((record.run.name, note) for record in records
                       for note in record.test_run.notes)]
