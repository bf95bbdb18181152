"""What changed in one ring between two sessions: the verdict, its sizes, and the contact law."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
import math
from typing import Any

import numpy as np

from saddlering_ros import discrepancy
from saddlering_ros.comparison import sessions
from saddlering_ros.comparison.series import ChangeSeries, series_of
from saddlering_ros.comparison.sessions import CONTACT_CHANGE, LATER, QUANTITIES, TwoSessions
from saddlering_ros.comparison.wear import figures_of_sessions, judged_wear, MakerFigures
from saddlering_ros.diagnosis import next_test, rig_dimensions, ring_wording
from saddlering_ros.diagnosis.raceways import with_raceways
from saddlering_ros.diagnosis.records import build_record, check_set, PreparedRecord
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.diagnosis.verdict import limit_entry
from saddlering_ros.discrepancy import Cause, Diagnosis, Estimate, Problem
from saddlering_ros.doubts.comparison import refuse_repeats
from saddlering_ros.doubts.wiring import wiring_first
from saddlering_ros.effects.raceway_waves import rms_of
from saddlering_ros.errors import SaddleringError
from saddlering_ros.estimation.process import Array
from saddlering_ros.files import Provenance
from saddlering_ros.identification.methods import identify_plain
from saddlering_ros.progress import IsCancelled, one_blas_thread, OnProgress, Watch
from saddlering_ros.quantities import finite_json, signed_percent, told_once
from saddlering_ros.record.record import Record
from saddlering_ros.rig import instruments, PARAMETER_NAMES, PARAMETER_UNITS, Rig

DRAWN_DATES = 'virtual rig'
"""Bags of the virtual rig state this as their rig; their dates are drawn."""

DOUBTS = {
    'rig_hash': ('the sessions state different rig files: a changed dimension looks like a '
                 'changed ring', 'Record one test with the rig of the earlier session.'),
    'slew_deg': ('the ring stood at another slewing angle: waviness of its raceways does not '
                 'cancel', 'Repeat the later session at the slewing angle of the earlier one.'),
}
"""Reason for doubt and the test that settles it, by the detail that differs between sessions."""

MOVED_ROLLERS = (
    'the rollers seem to stand elsewhere than in the earlier session, as after slewing: each '
    'session is judged with unequal rollers of its own, so that small changes do not show')


class ComparisonError(SaddleringError):
    """Sessions that cannot be compared; one line: fault, place, remedy."""


@dataclass(frozen=True)
class Change:
    """What changed between two sessions.

    diagnosis: the engine's result, whose causes state the size after minus the size before;
    before, after: the records; contact: per parameter the numbers before, after and of the change;
    limits_alone: detection limit of each effect in the later session alone; maker: figures of the
    first static test of each session at equal elevation, if there is a pair; series: evidence over
    all sessions, if there are more than two.
    """

    diagnosis: Diagnosis
    before: tuple[PreparedRecord, ...]
    after: tuple[PreparedRecord, ...]
    contact: Mapping[str, tuple[Estimate, Estimate, Estimate]]
    limits_alone: Mapping[str, float]
    maker: tuple[MakerFigures, MakerFigures] | None
    notes: tuple[str, ...]
    next_test: str | None
    rig: Rig
    seed: int
    series: ChangeSeries | None = None

    @property
    def verdict(self) -> str:
        """'none', 'named', 'ambiguous' or 'unknown'."""
        return self.diagnosis.verdict

    @property
    def wear_judged(self) -> list[dict[str, Any]]:
        """The wear beside the limits of the rig file."""
        return [] if self.maker is None else judged_wear(
            self.maker[1].wear_since(self.maker[0]), self.rig.wear_limits)

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        if self.verdict == 'none':
            return 'Nothing changed between the sessions that these tests could show.'
        words = '; '.join(map(change_words, self.diagnosis.causes))
        return {
            'named': f'Changed since the earlier session: {words}.',
            'ambiguous': f'Something changed, and several causes explain it equally: {words}.',
            'unknown': 'Something changed, and no cause of the catalogue is established'
                       f'{"; in part: " * bool(words)}{words}.'}[self.verdict]

    def to_json(self) -> dict[str, Any]:
        found, misfits = self.diagnosis, _misfits(self.diagnosis)
        return dict(finite_json({
            'verdict': self.verdict, 'headline': self.headline, **found.certainty(),
            'causes': [] if self.verdict == 'none' else [cause.entry() for cause in found.causes],
            'runs': [
                {'bag': str(record.test_run.path), 'session': session, 'held_out': False,
                 'elevation_deg': math.degrees(record.test_run.elevation),
                 'test': record.test_run.test, 'channels': misfits[record.run.name]}
                for session, records in (('before', self.before), ('after', self.after))
                for record in records],
            'parameters': {
                place: {name + ending: getattr(numbers[index], field)
                        for name, numbers in self.contact.items()
                        for ending, field in (('', 'value'), ('_std', 'std'))}
                for index, place in enumerate(('before', 'after', 'change'))},
            'next_test': self.next_test,
            'detection_limits': [
                {**limit_entry(limit), 'one_session': self.limits_alone.get(limit.effect)}
                for limit in found.observability.limits],
            'maker': None if self.maker is None else {
                'before': self.maker[0].as_dict(), 'after': self.maker[1].as_dict(),
                'wear': self.maker[1].wear_since(self.maker[0]), 'limits': self.wear_judged},
            'series': None if self.series is None else self.series.to_json(),
            'notes': list(self.notes), 'proposal': None,
            'provenance': Provenance(tuple(
                record.test_run.origin for record in (*self.before, *self.after))).as_dict(),
            'seed': self.seed, 'seconds': found.seconds}))


def name_of(effect_id: str) -> str:
    """The title of a cause, also of the one that only a comparison has."""
    if effect_id == CONTACT_CHANGE:
        return 'Change of a contact parameter'
    return rig_dimensions.changed_title(effect_id) or ring_wording.title_of(effect_id)


def change_words(cause: Cause) -> str:
    """A cause with the change of its size: 'dry friction ..., force by +1.50 ± 0.16 kN'."""
    name, size = next(iter(cause.parameters.items()))
    others = ' or '.join(effect for effect in cause.group if effect != cause.effect)
    value = signed_percent(size.value, size.std) if cause.effect == CONTACT_CHANGE else (
        ring_wording.value_words(cause.effect, name, size.value, size.unit, size.std))
    sign = '+' * (size.value > 0.0 and not value.startswith('+'))
    where = ' '.join(filter(None, (ring_wording.place_of(cause.entry()), name)))
    words = (f'{cause.definition.title.lower()}, {where} by {sign}{value}'
             f'{ring_wording.elsewhere_words(cause.entry())}')
    return f'{words} (or {ring_wording.lowered_titles(others, name_of)})' if others else words


@one_blas_thread()
def compare_records(
    before: Sequence[Record], after: Sequence[Record], *, rig: Rig,
    between: Sequence[Sequence[Record]] = (), seed: int = 0, on_progress: OnProgress | None = None,
    is_cancelled: IsCancelled | None = None,
) -> Change:
    """What changed from the records of one session to those of a later one, of one ring.

    between: sessions in order of time between the two, for the evidence of the whole series.
    ComparisonError (one line) if the sessions cannot be compared.
    """
    every = [before, *between, after]
    refuse_repeats([record for records in every for record in records])
    notes, doubts = check_sessions(before, after)
    for first, second in pairwise(every if between else ()):
        doubts |= check_sessions(first, second)[1]
    watch = Watch('compare', on_progress, is_cancelled)
    names = ['before', *(f'session {number + 2}' for number in range(len(between))), 'after']
    prepared: dict[str, tuple[PreparedRecord, ...]] = {}
    for session, records in zip(names, every, strict=True):
        built = (build_record(rig, record, held_out=False) for record in records)
        # Bags of two sessions often share their names.
        prepared[session] = tuple(
            replace(one, run=replace(one.run, name=f'{session} {number}: {one.run.name}'))
            for number, one in enumerate(built, start=1))
    earlier, later = prepared['before'], prepared['after']
    watch.progress('contact parameters', 0.0)
    identified = identify_plain(list(before), rig, is_cancelled=is_cancelled)
    ring, law = with_raceways(RingSystem(rig), [one.run for one in earlier],
                              identified.parameters.contact.to_array(), watch)
    start = dict(zip(PARAMETER_NAMES, law.tolist(), strict=True))
    renewed, said = renewed_between(before, after)
    diagnosis, system = _diagnosed(Problem(
        TwoSessions(ring, frozenset(one.run.name for one in earlier), renewed),
        [one.run for one in (*earlier, *later)], replace(sessions.SETTINGS, seed=seed),
        assumptions=discrepancy.Assumptions(
            model_error=sessions.PERSISTENT_MODEL_ERROR, proposes_law=False, is_persistent=True),
        start=start, proposals=next_test.propose(rig, [one.run for one in later]),
        watch=Watch('diagnose', on_progress, is_cancelled)))
    if system.are_rollers_moved:
        said.append(MOVED_ROLLERS)
    if ring.raceways:
        said.append(f'{ring_wording.wave_words(rms_of(ring.raceways))} are as far as the earlier '
                    'session shows them: the contact law before is fitted with them, and has no '
                    'interval')
    contact = contact_of_sessions(diagnosis, system, estimates_of(
        law, np.full(law.size, math.nan) if ring.raceways else identified.std))
    differs, left = (sessions.left_between(diagnosis, fit.prediction, system)
                     for fit in (diagnosis.fits.before, diagnosis.fits.after))
    diagnosis = sessions.with_main_cause(
        replace(diagnosis, causes=tuple(map(_as_change, diagnosis.causes))), differs, left,
        sessions.WAVY_DEFINITION if ring.raceways else sessions.DEFINITION)
    if doubts and diagnosis.verdict != 'none':
        diagnosis = diagnosis.in_doubt()
    notes += [*said, *check_set([*earlier, *later], rig), *diagnosis.warnings,
              *rig_dimensions.certificate_notes(rig, diagnosis.causes),
              *rig_dimensions.assumed_notes(rig),
              *told_once((record.name, note) for record in (*before, *after)
                         for note in record.notes)]
    if not diagnosis.complete:
        notes.append(f'{100.0 * left:.2g} % of range differs between the sessions and fits no '
                     'cause: it may be the interplay of the change with errors that both share')
    watch.progress('limits of the later session alone', 0.95)
    change = Change(
        diagnosis, earlier, later, contact, _limits_alone(ring, later, start, seed, watch),
        figures_of_sessions(rig, before, after), (*doubts, *notes),
        ' '.join(filter(None, (wiring_first(rig, [*before, *after]), _next_test(
            diagnosis, doubts, rig)))) or None, rig,
        seed, series_of(
            ring, prepared, start, watch, are_rollers_moved=system.are_rollers_moved)
        if between else None)
    watch.progress('verdict', 1.0)
    return change


def _diagnosed(problem: Problem) -> tuple[Diagnosis, TwoSessions]:
    """The diagnosis of a change, and its system: with rollers that moved where they are likely."""
    assert isinstance(problem.system, TwoSessions)
    diagnosis, system = discrepancy.diagnose_system(problem), problem.system
    if diagnosis.verdict == 'none' or not sessions.have_rollers_moved(diagnosis, system):
        return diagnosis, system
    moved = replace(system, are_rollers_moved=True)
    return discrepancy.diagnose_system(replace(problem, system=moved)), moved


def check_sessions(
    before: Sequence[Record], after: Sequence[Record],
) -> tuple[list[str], dict[str, str]]:
    """Notes, and doubts with the test that settles each; ComparisonError for no pair."""
    for name, records in (('before', before), ('after', after)):
        if not records:
            raise ComparisonError(f'{name}: no bags: give at least one bag of each session')
    rings = [{record.ring for record in records} - {''} for records in (before, after)]
    if len(rings[0] | rings[1]) > 1:
        remedy = 'compare sessions of one ring'
        stated = _stated('ring', before, after)
        for silent, its_ring, other in (('before', *stated), ('after', *stated[::-1])):
            if not its_ring and len(other) == 1:
                remedy = (f'{silent} states no ring: if it is the same, add ring: {min(other)} to '
                          'the metadata of its bags')
        raise ComparisonError(f'before is of {", ".join(sorted(rings[0]))} and after of '
                              f'{", ".join(sorted(rings[1]))}: {remedy}')
    dated = all(record.rig != DRAWN_DATES for record in (*before, *after))
    times = [[int(record.stamps[0]) for record in records] for records in (before, after)]
    if dated and min(times[0]) > max(times[1]):
        raise ComparisonError('every bag of before was recorded later than those of after: '
                              'exchange the sessions')
    if dated and max(times[0]) > min(times[1]):
        raise ComparisonError('some bags of before were recorded later than some of after: give '
                              'each session the bags of its own time')
    doubts = {}
    for key, (reason, test) in DOUBTS.items():
        first, second = _stated(key, before, after)
        if first and second and first != second:
            doubts[reason] = test
    kinds = [{(record.test, round(math.degrees(record.elevation))) for record in records}
             for records in (before, after)]
    notes = [f'after: {test} at {degrees} deg has no counterpart in the earlier session; errors '
             'that belong to this test alone do not cancel'
             for test, degrees in sorted(kinds[1] - kinds[0])]
    return notes, doubts


def _stated(key: str, *sessions: Sequence[Record]) -> list[set[str]]:
    """What the bags of each session state under a key of the metadata."""
    return [{record.details.get(key, '') for record in records} - {''} for records in sessions]


def renewed_between(
    before: Sequence[Record], after: Sequence[Record],
) -> tuple[instruments.Instruments, list[str]]:
    """What was calibrated between the sessions by the certificates in their bags, and a note."""
    (first, old), (second, new) = (
        instruments.stated_by((record.details.get('instruments', '') for record in records), name)
        for name, records in (('before', before), ('after', after)))
    if (first, old) == (second, new):
        return instruments.Instruments(), []
    renewed = instruments.difference_of(first, second)
    names = [name for name in instruments.NAMES if name not in renewed.not_stated]
    return renewed, [f'{", ".join(names)}: calibrated between the sessions (certificates '
                     f'{old or "not named"}, then {new or "not named"}): a change within both '
                     'certificates is not accused'] if names else []


def _as_change(cause: Cause) -> Cause:
    """The cause with the change of its size, after minus before."""
    parameters = {name: estimate for name, estimate in cause.parameters.items()
                  if name != sessions.SESSION}
    if cause.effect == CONTACT_CHANGE:
        name = QUANTITIES[round(parameters.pop('quantity').value)]
        definition = replace(cause.definition, parameters={name: cause.definition.size}, starts=())
        return replace(cause, definition=definition, parameters={name: parameters['change']},
                       elsewhere=())
    size = cause.definition.size.name
    if cause.parameters[sessions.SESSION].value == sessions.EARLIER:
        parameters[size] = replace(parameters[size], value=-parameters[size].value)
    elsewhere = tuple(
        {name: -value if name == size and values[sessions.SESSION] == sessions.EARLIER else value
         for name, value in values.items() if name != sessions.SESSION}
        for values in cause.elsewhere)
    return replace(cause, parameters=parameters, elsewhere=elsewhere)


def _next_test(diagnosis: Diagnosis, doubts: Mapping[str, str], rig: Rig) -> str | None:
    """The measurement that would settle what is open; that of a doubt goes first.

    A dimension of the rig is measured before any test.
    """
    if diagnosis.verdict == 'none':
        return None
    if doubts:
        return next(iter(doubts.values()))
    groups = [cause.group for cause in diagnosis.causes if len(cause.group) > 1]
    named, sentence = [name for cause in diagnosis.causes for name in cause.group], ''
    if diagnosis.verdict == 'ambiguous' and groups:
        sentence = next_test.for_groups(groups, diagnosis.separations) or (
            diagnosis.causes[0].definition.settled_by)
        for name in named:
            sentence = sentence.replace(ring_wording.lowered_titles(name),
                                        ring_wording.lowered_titles(name, name_of))
    has_dimensions = any(map(rig_dimensions.changed_title, named))
    if diagnosis.verdict == 'named' and not has_dimensions:
        sentence = next_test.confirming(named[0], ())
    first = ('First ask what was remounted between the sessions, and measure: '
             f'{", ".join(rig_dimensions.entries_of(rig, diagnosis.causes))}.'
             ) if has_dimensions else ''
    return ' '.join(filter(None, (first, sentence))) or None


def _limits_alone(
    ring: RingSystem, later: Sequence[PreparedRecord], start: Mapping[str, float], seed: int,
    watch: Watch,
) -> dict[str, float]:
    """Detection limit of each effect in the later session without the earlier one.

    A misfit of this session that is more than noise is error of the model there, as in its
    diagnosis: nothing in one session tells it from a cause of the same size.
    """
    space = discrepancy.prepare(Problem(
        ring, [record.run for record in later], discrepancy.Settings(seed=seed),
        start=start, watch=replace(watch, on_progress=None)))
    if space.leaves_misfit(space.base):
        space, _ = discrepancy.space_beside_error(space, space.base)
    return {effect.effect: effect.limit
            for effect in discrepancy.observed(space.with_inputs()).limits}


def estimates_of(law: Array, std: Array) -> dict[str, Estimate]:
    """A contact law (6,) with standard deviations (6,), NaN where it is not determined."""
    return {name: Estimate(value, error, PARAMETER_UNITS[name]) for name, value, error in zip(
        PARAMETER_NAMES, law.tolist(), std.tolist(), strict=True)}


def contact_of_sessions(
    diagnosis: Diagnosis, system: TwoSessions, earlier: Mapping[str, Estimate],
) -> dict[str, tuple[Estimate, Estimate, Estimate]]:
    """Contact parameters before, after, and their change, each with its standard deviation.

    A standard deviation is NaN if the data do not determine the value. The law before is
    `earlier`. The change is one linear step from the fit with the causes, in which each session
    has a contact law of its own: errors that both sessions share are marginalised, and so is the
    size of every cause but a change of the contact law itself. The law before and the change
    count as independent.
    """
    metric, fit, parameters = diagnosis.fits.metric, diagnosis.fits.after, system.base_parameters
    problem, count = metric.problem, len(parameters)
    changes = discrepancy.tangent(metric, fit).plain
    is_later = np.zeros(problem.size, dtype=bool)
    for index, _, part in problem.slices:
        is_later[part] = system.session_of(problem.runs[index]) == LATER
    own = [changes[:, part] for effect, _, part in fit.parts if effect.id != CONTACT_CHANGE]
    of_session = [np.where(there[:, None], changes[:, :count], 0.0)
                  for there in (~is_later, is_later)]
    columns = metric.whiten(np.hstack([*of_session, *own]))
    residual = metric.whiten(problem.measured - fit.prediction)
    # The whole range of a parameter is one standard deviation of its prior, as in every fit.
    covariance = np.linalg.inv(columns.T @ columns + np.eye(columns.shape[1]))
    step = covariance @ (columns.T @ residual)
    covariance *= diagnosis.residual_after.inflation(problem.settings.error_rate)
    reached = fit.theta_unit[:count] + step[: 2 * count].reshape(2, count)
    ends = np.clip(reached, 0.0, 1.0)
    # A step that leaves the bounds is none of a linear law. K and n of a row are one law.
    leaves = np.any(reached != ends, axis=0)
    leaves |= np.repeat(leaves.reshape(-1, 3)[:, :2].any(axis=1), 3)
    answers, moved = {}, fit.point.effects.get(CONTACT_CHANGE)
    changed = {QUANTITIES[round(moved['quantity'])]: 1.0 + moved['change']} if moved else {}
    for index, parameter in enumerate(parameters):
        places = [index, count + index]
        first, last = map(parameter.from_unit, ends[:, index].tolist())
        last *= changed.get(parameter.name, 1.0)
        both = covariance[np.ix_(places, places)]
        spread = math.nan if leaves[index] else math.sqrt(
            both[0, 0] + both[1, 1] - 2.0 * both[0, 1])
        before = earlier[parameter.name]
        # A K or D changes by the same factor about the law before as about the fitted one.
        factor = before.value / first if parameter.scale == 'log' else 1.0
        std_of_change = factor * parameter.slope(float(ends[:, index].max())) * spread
        change = Estimate(factor * (last - first), std_of_change, parameter.unit)
        answers[parameter.name] = (
            before, replace(before, value=before.value + change.value,
                            std=math.hypot(before.std, change.std)), change)
    return answers


def _misfits(diagnosis: Diagnosis) -> dict[str, dict[str, dict[str, float]]]:
    """Misfit of each run and channel without and with the causes, errors of both sessions removed.

    rms values over the measured range of the channel, as in every verdict document.
    """
    metric, problem = diagnosis.fits.metric, diagnosis.fits.metric.problem
    residuals = [metric.without_nuisances(fit.prediction - problem.measured)
                 for fit in (diagnosis.fits.before, diagnosis.fits.after)]
    answers: dict[str, dict[str, dict[str, float]]] = {run.name: {} for run in problem.runs}
    for view, weights in problem.system.views.items():
        seen = [problem.view_residuals(residual, view) for residual in residuals]
        for run, before, after in zip(problem.runs, *seen, strict=True):
            span = max(float(np.ptp(weights @ run.channels)), 1e-12)
            noise = math.sqrt(metric.noise_power(run, view))
            answers[run.name][view] = {
                'nrmse_before': math.sqrt(problem.mean_square(before, run, view)) / span,
                'nrmse_after': math.sqrt(problem.mean_square(after, run, view)) / span,
                'noise_floor': noise / span}
    return answers
