"""Two sessions of one ring as one system: a shared base, and causes that act in one session only.

Runs of both sessions are fitted together. Contact parameters and every persistent error of this
ring (unequal rollers, model error, errors of the rig file, gains of instruments) have one value
for both sessions, so that they cancel in the difference. A cause acts in the later session alone.
A cause that has become smaller acts in the earlier session alone. What differs between the
sessions beside the causes decides whether a cause is established.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
import math

import numpy as np

from saddlering_ros import discrepancy
from saddlering_ros.diagnosis.rig_dimensions import changed_title
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Diagnosis, Effect, Parameter, Point, RunBlocks
from saddlering_ros.effects import catalogue
from saddlering_ros.estimation.process import Array
from saddlering_ros.quantities import WIDTH_95
from saddlering_ros.rig import Instruments, PARAMETER_NAMES, Rig

SESSION = 'session'
"""Fixed value of a variant: the session in which the cause acts."""

EARLIER, LATER = -1.0, 1.0

CONTACT_CHANGE = 'contact_change'
"""Id of the cause that only a comparison can name: one contact parameter has another value."""

QUANTITIES = ('K1', 'K2', 'D1', 'D2')
"""Contact parameters that may change; K and n of one row are one change for these loads."""

SETTINGS = discrepancy.Settings(max_causes=1)
"""One cause. Beside a large change, what remains is mostly the interplay of the change with the
persistent errors, which are marginalised to first order: a second cause was named for it on four
of six dirty rings."""

PERSISTENT_SIZE = 0.3
"""Spread of an error that both sessions share, as a share of the typical size of its effect.

The errors of a dirty rig (load gain 0.3 %, 2 mm, friction of 350 N) are 0.05 to 0.2 of the typical
size of a fault. The earlier session measures each error, so that a larger spread costs nothing.
"""

PERSISTENT_MODEL_ERROR = discrepancy.ModelErrorPrior(smooth=3e-3, loop=1e-3)
"""Smooth error of the simulator that both sessions share: ten times that of a diagnosis.

Raceways of a real ring wave by tens of micrometres. The earlier session measures the error, so
that the width of the prior costs one degree of freedom for each shape and no more.
"""

MOVED_MARGIN = 20.0
"""Twice the logarithm of the likelihood by which rollers that moved may be behind and count. With
the same rollers four pairs had 108 to 985, and -1 700 and -3 400 with others."""

SAME_COURSE = 0.01
"""Largest median difference of two loads under one course, as a share of the largest load."""

ESTABLISHED_SHARE, ESTABLISHED_P = 0.85, 1e-6
"""Share of the power of the misfit, and largest p-value, of a main cause that leaves a rest."""

DEFINITION = 0.03
"""Standard uncertainty of the size of a cause by its definition (JCGM 200, 2.27), as a share.

Laws of one name differ: a sine for a parabola, a stiffening for a constant spring. The residual
hardly shows it. Sizes of such rings were 3 to 7 % wrong, where noise allows 1.0 to 1.6 % (docs/
benchmarks/changes.md).
"""

WAVY_DEFINITION = 0.1
"""The same on a ring whose raceways wave: other waves that fit as well answer a change otherwise.
On 23 such rings errors of sizes had an rms of 10 %, the largest ones 26 and 30 %."""


@dataclass(eq=False)
class TwoSessions:
    """The engine's `System` for two sessions of one ring.

    earlier: names of the runs of the earlier session; every other run is of the later one;
    renewed: uncertainty of the difference of each instrument that was calibrated between them;
    are_rollers_moved: whether slewing between the sessions may have moved the rollers.
    """

    ring: RingSystem
    earlier: frozenset[str]
    renewed: Instruments = field(default_factory=Instruments)
    are_rollers_moved: bool = False

    def __post_init__(self) -> None:
        ring = self.ring
        self.channel_names, self.units, self.views = ring.channel_names, ring.units, ring.views
        self.base_parameters = ring.base_parameters

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """Causes of the catalogue in one session, and the change of a contact parameter.

        Steady lines have a phase of their own in every run, and wider forms add no other name.
        """
        return (*(in_one_session(effect) for effect in self.ring.effects
                  if not (effect.line or effect.first_variant)), Effect(
            'Change of a contact parameter',
            {'change': Parameter(-0.6, 1.5, unit='1', neutral=0.0, step=1e-3)},
            variants=tuple({'quantity': float(number), SESSION: LATER}
                           for number in range(len(QUANTITIES))),
            starts=({'change': 0.02}, {'change': 0.2}, {'change': -0.1}),
            settled_by='Repeat the later session with a reference load cell and calibrated '
                       'probes.',
            id=CONTACT_CHANGE))

    @cached_property
    def inputs(self) -> tuple[Effect, ...]:
        """Dimensions of the rig, which may differ between the sessions."""
        return tuple(replace(in_one_session(effect), title=changed_title(effect.id))
                     for effect in self.ring.inputs)

    def session_of(self, run: RunBlocks) -> float:
        """EARLIER or LATER."""
        return EARLIER if run.name in self.earlier else LATER

    def predict_many(self, run: RunBlocks, points: Sequence[Point]) -> Array:
        session = self.session_of(run)
        return self.ring.predict_many(run, [seen_in(session, point) for point in points])

    def neighbourhood(self, groups: Sequence[Sequence[Point]]) -> discrepancy.Neighbourhood:
        by_session = {
            session: self.ring.neighbourhood(
                [[seen_in(session, point) for point in group] for group in groups])
            for session in (EARLIER, LATER)}
        return lambda run: by_session[self.session_of(run)](run)

    def targets(self, run: RunBlocks, point: Point) -> dict[str, Array]:
        return self.ring.targets(run, seen_in(self.session_of(run), point))

    def start_of(self, run: RunBlocks) -> float:
        return self.ring.start_of(run)

    def nuisances(self, runs: Sequence[RunBlocks], point: Point) -> list[Array]:
        """Nuisance parameters of the ring, and every effect as an error that both sessions share.

        Each is evaluated beside the causes of the run's session. Otherwise the interplay of a
        cause with these errors counts as a part of the cause, and its size is wrong by 2 to 7 %.
        """
        seen = [seen_in(self.session_of(run), point) for run in runs]
        renewed = replace(self.ring, rig=replace(self.ring.rig, instruments=self.renewed))
        columns, moved = [], self._moved_rollers(runs, seen)
        for run, here, usual, rollers in zip(
                runs, seen, self.ring.nuisances_at(runs, seen), moved, strict=True):
            errors = [beside(here, error, self.ring.rig) for error in self.persistent]
            predicted = self.ring.predict_many(
                run, [here, Point(here.base), *(larger for _, larger in errors)])
            persistent = predicted[2:] - predicted[[int(one is not here) for one, _ in errors]]
            renewals = renewed.instrument_errors(run, point.base)
            renewals = [change * (self.session_of(run) == LATER) for change in renewals]
            columns.append(np.concatenate(
                [usual, rollers, *(change[:, :, None] for change in renewals),
                 np.moveaxis(persistent, 0, -1)], axis=2))
        return columns

    def _moved_rollers(self, runs: Sequence[RunBlocks], points: Sequence[Point]) -> list[Array]:
        """Columns (C, N, k) of the difference by unequal rollers that stand elsewhere later."""
        if not self.are_rollers_moved:
            return [np.zeros((*run.channels.shape, 0)) for run in runs]
        # Two rollers differ by twice the variance of one.
        return [math.sqrt(2.0) * columns * (self.session_of(run) == LATER) for run, columns
                in zip(runs, self.ring.other_rollers(runs, points), strict=True)]

    @cached_property
    def persistent(self) -> list[dict[str, dict[str, float]]]:
        """One point per effect and variant, of the size of a persistent error."""
        points = []
        for effect in catalogue().values():
            if effect.line:
                continue
            for variant in effect.variants:
                if variant.frees:
                    continue
                parameters = effect.parameters_of(variant, self.ring.rig)
                size = next(parameter for parameter in parameters if parameter.amplitude)
                values = {parameter.name: parameter.start for parameter in parameters}
                if size.neutral == 0.0:
                    values[size.name] = PERSISTENT_SIZE * size.scale
                points.append({effect.id: {**values, **variant.values}})
        return points


def in_one_session(effect: Effect) -> Effect:
    """The effect in the later session; one of one sign may also act in the earlier one only."""
    sessions = (LATER, EARLIER) if effect.one_sided else (LATER,)
    return replace(effect, variants=tuple(
        {**variant, SESSION: session} for session in sessions for variant in effect.variants))


def seen_in(session: float, point: Point) -> Point:
    """The point of the ring in one session: causes of the other session do nothing."""
    base = point.base
    effects = {}
    for name, values in point.effects.items():
        if values.get(SESSION, session) != session:
            continue
        values = {key: value for key, value in values.items() if key != SESSION}
        if name == CONTACT_CHANGE:
            base = base.copy()
            changed = PARAMETER_NAMES.index(QUANTITIES[round(values['quantity'])])
            base[changed] *= 1.0 + values['change']
        else:
            effects[name] = values
    return Point(base, effects)


def beside(
    point: Point, error: Mapping[str, Mapping[str, float]], rig: Rig,
) -> tuple[Point, Point]:
    """The point without and with one more error.

    An error adds to the size of a cause of its own kind, or takes from one near its bound: the
    sign of an error is not known. A point holds one variant of an effect, so that the error of
    another variant stands without the cause.
    """
    (name, values), = error.items()
    cause, effect = point.effects.get(name), catalogue()[name]
    if cause is None:
        return point, Point(point.base, {**point.effects, **error})
    size = effect.parameters_on(rig)[0]
    if size.neutral or any(cause[key] != values[key] for key in effect.variants[0].values):
        return Point(point.base), Point(point.base, error)
    before, change = cause[size.name], values[size.name]
    other = before + (change if before + change <= size.high else -change)
    return point, Point(point.base, {**point.effects, name: {**cause, size.name: other}})


def with_main_cause(
    diagnosis: Diagnosis, differs: float, left: float, definition: float = DEFINITION,
) -> Diagnosis:
    """The verdict by what differs between the sessions, `left` of it beside the causes.

    definition: uncertainty of the size of a cause by its definition, as a share.

    A misfit that both sessions have is no change. The one cause is established if it takes nearly
    all of the power of the difference. The rest may be a part of this cause: its share of the
    change is an error of the size. A stand-in for a law that the catalogue lacks took at most 0.80
    of the power of the misfit on other machines (docs/benchmarks/real_machines.md). A dimension of
    the rig resembles other causes, and is established only if it leaves no rest. A size whose
    interval includes no change is none.
    """
    if diagnosis.verdict == 'unknown' and max(differs, left) < SETTINGS.materiality:
        return diagnosis.as_none()
    if len(diagnosis.causes) != 1 or diagnosis.verdict == 'none':
        return diagnosis
    cause = diagnosis.causes[0]
    share = 1.0 - (left / cause.visible) ** 2
    complete = left < SETTINGS.materiality
    is_established = share >= ESTABLISHED_SHARE and cause.p_value <= ESTABLISHED_P
    if changed_title(cause.effect) and not complete:
        return diagnosis.in_doubt()
    if diagnosis.verdict == 'unknown' and not is_established:
        return diagnosis
    name, size = next(iter(cause.parameters.items()))
    std = math.hypot(size.std, abs(size.value) * math.hypot(left / cause.visible, definition))
    if abs(size.value - cause.definition.neutral) <= WIDTH_95 * std:
        return diagnosis.in_doubt()
    widened = {**cause.parameters, name: replace(size, std=std)}
    stated = replace(diagnosis, verdict='named' if len(cause.group) == 1 else 'ambiguous',
                     causes=(replace(cause, parameters=widened, partial=False),),
                     complete=complete, remainder=() if complete else diagnosis.remainder,
                     # A session of other tests predicts the other one badly with any cause.
                     warnings=tuple(one for one in diagnosis.warnings
                                    if not isinstance(one, discrepancy.wording.OfPrediction)))
    return replace(stated, probabilities=discrepancy.probabilities_of(
        stated.verdict, stated.causes, share))


def have_rollers_moved(diagnosis: Diagnosis, system: TwoSessions) -> bool:
    """Whether unequal rollers that stand elsewhere later, with the causes or alone, are likely.

    By the marginal likelihood with such rollers over that of the causes without, and by no less
    where the rollers explain a change about as well as its causes.
    """
    metric, before, after = diagnosis.fits.metric, diagnosis.fits.before, diagnosis.fits.after
    problem = replace(metric.problem, system=replace(system, are_rollers_moved=True))
    price = math.log(problem.size)
    deviances = []
    for fit in (before, after):
        moved = replace(metric, problem=problem).with_nuisances(fit.point, fit.prediction)
        white = moved.whiten(np.column_stack([
            discrepancy.tangent(metric, fit).plain, fit.prediction - problem.measured]))
        deviances.append(discrepancy.stepped_misfit(white.T @ white)
                         + moved.shared.volume + price * fit.theta_unit.size)
    without = after.misfit + metric.shared.volume + price * after.theta_unit.size
    return bool(min(deviances) < without + MOVED_MARGIN)


def left_between(diagnosis: Diagnosis, prediction: Array, system: TwoSessions) -> float:
    """Largest rms, as a share of range, by which the sessions differ beside a prediction (n,).

    Each run is compared with the run of the other session under the same course of the load; a
    run without one counts whole. The noise of both is subtracted.
    """
    metric, problem = diagnosis.fits.metric, diagnosis.fits.metric.problem
    residual = metric.without_nuisances(problem.measured - prediction)
    largest = 0.0

    def are_alike(run: RunBlocks, other: RunBlocks) -> bool:
        """Of two sessions and one elevation, with nearly the same load at every time."""
        if system.session_of(other) == system.session_of(run) or run.group != other.group:
            return False
        load = run.inputs['load']
        along = np.interp(run.time - run.time[0], other.time - other.time[0], other.inputs['load'])
        return bool(np.median(np.abs(load - along)) < SAME_COURSE * np.abs(load).max())

    for view in problem.system.views:
        seen = problem.view_residuals(residual, view)
        for run, rest in zip(problem.runs, seen, strict=True):
            other = next((number for number, one in enumerate(problem.runs)
                          if are_alike(run, one)), None)
            noise = metric.noise_power(run, view)
            if other is not None:
                one = problem.runs[other]
                rest = rest - np.interp(
                    run.time - run.time[0], one.time - one.time[0], seen[other])
                noise += metric.noise_power(one, view)
            power = problem.mean_square(rest, run, view) - noise
            largest = max(largest, math.sqrt(max(power, 0.0)) / problem.view_ranges[view])
    return largest
