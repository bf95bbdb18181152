"""Identification of the contact parameters from test runs: the default and the paper's method."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
import time

import numpy as np

from saddlering_ros.errors import Cancelled, Interrupted
from saddlering_ros.estimation.least_squares import NEAR, SearchSpace, USUAL_DAMPING
from saddlering_ros.estimation.process import Array
from saddlering_ros.files import Provenance
from saddlering_ros.identification import objective as objectives
from saddlering_ros.identification import observation
from saddlering_ros.identification.objective import average_branches, refine, WeightedObjective
from saddlering_ros.identification.observation import Observation
from saddlering_ros.identification.prepared import prepare, PreparedRun, warnings_of
from saddlering_ros.identification.result import FittedLaw, Identification
from saddlering_ros.identification.ring_errors import (
    beside_errors,
    degrees_of_freedom,
    errors_beside,
    errors_of_ring,
    MAX_FIRST_CHI_SQUARE,
    PASSES,
)
from saddlering_ros.identification.settings import (
    Bounds,
    IdentificationError,
    IdentificationSettings,
    StopReason,
    SwarmSettings,
)
from saddlering_ros.identification.uncertainty import (
    assess,
    at_bound,
    MAX_SOUND,
    MIN_SOUND,
    TOO_QUIET,
    UNDETERMINED,
    usual_errors,
)
from saddlering_ros.progress import IsCancelled, one_blas_thread, OnProgress, Progress, SearchStep
from saddlering_ros.quantities import percent, quantity, told_once
from saddlering_ros.record.record import Record
from saddlering_ros.rig import PARAMETER_NAMES, ParameterSource, Rig
from saddlering_ros.rig.parameter_file import ContactParameters, TRUE_TO_SCALE

STATIC_NAMES = ('K1', 'n1', 'K2', 'n2')
DAMPING_NAMES = ('D1', 'D2')

MISFIT_ADVICE = {
    'default': 'diagnose looks for the cause',
    'paper': 'use the default method, which fits closer, or look for the cause with diagnose'}
"""Remedy for a misfit, by method."""

STALLED_AFTER, STALLED_GAIN = 4, 0.05
"""Share of gain per so many iterations below which a swarm before least squares stops: descents
along exact gradients are faster from there."""

PROVISIONAL = 1e-3
"""Gain of chi square below which a descent ends that is followed by another one."""

MIN_WAVE_SHARE = 0.5
"""Share of the variance of a parameter by waves from which it is also fitted beside errors."""

LOAD_CORRECTIONS = 2
"""Number of times that the load of dynamic runs is corrected and the fit repeated."""


@dataclass(frozen=True, slots=True)
class SwarmResult:
    """Result of a swarm: best position (D,), its objective, and the course of the search."""

    position: Array
    objective: float
    iterations: int
    stopped: StopReason
    history: Array = field(repr=False)


def minimise(objective: Callable[[Array], Array], low: Array, high: Array,
             settings: SwarmSettings | None = None, *, seed: int = 0,
             on_iteration: Callable[[SearchStep], None] | None = None,
             is_cancelled: IsCancelled | None = None) -> SwarmResult:
    """Minimise objective((particles, D)) -> (particles,) in the box, repeatably by its seed.

    The particle swarm of the paper: Kennedy and Eberhart's with the inertia of Shi and Eberhart
    (1998) falling linearly: v <- w v + c1 r1 (own best - x) + c2 r2 (swarm's best - x), |v| <=
    v_max, x <- x + v. A particle that would leave the box is put on its wall and loses its
    velocity towards the wall.
    """
    settings = settings or SwarmSettings()
    random = np.random.default_rng(seed)
    shape, span = (settings.particles, low.size), high - low
    fastest = settings.velocity_limit * span
    position = low + span * random.random(shape)
    velocity = fastest * random.uniform(-1.0, 1.0, shape)
    own_best, own_objective = position.copy(), np.full(settings.particles, np.inf)
    history: list[float] = []
    stopped = None
    while stopped is None:
        if is_cancelled is not None and is_cancelled():
            stopped = StopReason.CANCELLED
            break
        costs = objective(position)
        better = costs < own_objective
        own_best[better] = position[better]
        own_objective[better] = costs[better]
        best = own_best[int(np.argmin(own_objective))].copy()
        pull_own, pull_all = random.random((2, *shape))
        velocity = (
            settings.inertia(len(history)) * velocity
            + settings.cognitive * pull_own * (own_best - position)
            + settings.social * pull_all * (best - position))
        velocity = np.clip(velocity, -fastest, fastest)
        moved = position + velocity
        position = np.clip(moved, low, high)
        velocity = np.where(moved == position, velocity, 0.0)
        history.append(float(own_objective.min()))
        if on_iteration is not None:
            on_iteration(SearchStep(
                len(history), settings.iterations, history[-1], tuple(best.tolist()),
                float(np.mean(position.std(axis=0) / span))))
        stopped = _reason_to_stop(history, settings)
    return SwarmResult(
        position=own_best[int(np.argmin(own_objective))], objective=float(own_objective.min()),
        iterations=len(history), stopped=stopped, history=np.array(history))


def _reason_to_stop(history: list[float], settings: SwarmSettings) -> StopReason | None:
    best = history[-1]
    if settings.accuracy is not None and best <= settings.accuracy:
        return StopReason.ACCURACY
    if settings.stagnation is not None and len(history) > settings.stagnation:
        before = history[-1 - settings.stagnation]
        if before - best <= settings.stagnation_tolerance * abs(before):
            return StopReason.STAGNATION
    return StopReason.ITERATIONS if len(history) == settings.iterations else None


@dataclass
class _Search:
    """One running identification: its inputs, its reports and its count of simulations."""

    runs: Sequence[Record]
    rig: Rig
    settings: IdentificationSettings
    on_progress: OnProgress | None
    is_cancelled: IsCancelled | None
    started: float = field(default_factory=time.monotonic)
    evaluations: int = 0
    notes: list[str] = field(default_factory=list)

    def observations(self, contact: ContactParameters | None = None) -> list[Observation]:
        """The fitted runs, with their noise from a first result."""
        rate = self.settings.fit_rate
        observations = (observation.observe_prepared(self.prepared, rate) if contact is None
                        else observation.observe_with_cell(self.prepared, self.rig, rate, contact))
        # If no run shows D, plateaus count as equilibria, which do not depend on D.
        return observations if self.has_dynamic else [one.coarse() for one in observations]

    @cached_property
    def bounds(self) -> Bounds:
        return self.settings.bounds_for(self.rig)

    @cached_property
    def start(self) -> ContactParameters:
        """The true-to-scale parameters, pulled into the bounds."""
        low, high = np.array([self.bounds[name] for name in PARAMETER_NAMES]).T
        return ContactParameters.from_array(np.clip(TRUE_TO_SCALE.to_array(), low, high))

    @cached_property
    def prepared(self) -> list[PreparedRun]:
        if not self.runs:
            raise IdentificationError('no runs to identify from: give at least one bag')
        return [prepare(run, self.rig, self.settings.fit_rate) for run in self.runs]

    @property
    def has_dynamic(self) -> bool:
        """Whether a run shows damping."""
        return any(run.test != 'static' for run in self.runs)

    def is_too_quiet(self, sound_factor: float) -> bool:
        """Whether a misfit is less than noise can leave, so that the noise is not known."""
        return self.has_dynamic and sound_factor < MIN_SOUND

    @property
    def cancelled(self) -> bool:
        return self.is_cancelled is not None and self.is_cancelled()

    def space(self, free: Sequence[str], held: ContactParameters, *, log: bool) -> SearchSpace:
        """Search space of `free`, logarithmic for K and D, or for K only on request."""
        names: tuple[str, ...] = ('K1', 'K2', 'D1', 'D2') if log else ()
        if not log and self.settings.logarithmic_stiffness:
            names = ('K1', 'K2')
        return SearchSpace.of(self.bounds, free, held, names)

    def report(self, stage: str, step: SearchStep) -> None:
        if self.on_progress is not None:
            share = step.iteration / max(step.iterations, 1)
            self.on_progress(Progress(
                'identify', stage, share, f'best {step.best_objective:.4g}', step))

    def watch(self, stage: str, step: SearchStep) -> None:
        """Report that work at a step goes on; Cancelled on request."""
        if self.cancelled:
            raise Cancelled
        self.report(stage, step)

    def run_swarm(self, stage: str, objective: WeightedObjective | objectives.PaperObjective,
                  space: SearchSpace) -> tuple[ContactParameters, float]:
        """Let the swarm search `space`; the best contact parameters and their objective.

        Before least squares it may stop at small gains.
        """
        before, chosen = objective.evaluations, self.settings.swarm
        if self.settings.method != 'paper' and chosen.stagnation is None:
            chosen = replace(chosen, stagnation=STALLED_AFTER, stagnation_tolerance=STALLED_GAIN)

        def report_iteration(step: SearchStep) -> None:
            lowest = space.contacts(np.array(step.best_parameters))[0]
            self.report(stage, replace(step, best_parameters=tuple(lowest.tolist())))

        best = minimise(
            lambda points: objective(space.contacts(points)), space.low, space.high,
            chosen, seed=self.settings.seed, on_iteration=report_iteration,
            is_cancelled=self.is_cancelled)
        self.evaluations += objective.evaluations - before
        self.notes.append(f'{stage}: {best.iterations} iterations, {best.stopped.value}')
        contact = ContactParameters.from_array(space.contacts(best.position)[0])
        return contact, best.objective


def identify(runs: Sequence[Record], rig: Rig, settings: IdentificationSettings | None = None, *,
             on_progress: OnProgress | None = None,
             is_cancelled: IsCancelled | None = None) -> Identification:
    """Identify K1, n1, D1, K2, n2, D2 from static and dynamic runs of any elevations.

    Where the misfit exceeds that of a sound ring, or where waves of the raceways bend this law
    most, it is also fitted beside waves and small errors of ring and rig.
    IdentificationError (one line) if the runs, bounds or settings cannot be used. A cancelled
    identification returns its result so far, marked `cancelled`. An interrupt of the second fit
    raises `Interrupted` with the first law. Reading refuses two bags of one recording.
    """
    search = _Search(runs, rig, settings or IdentificationSettings(), on_progress, is_cancelled)
    found = _identified(search)
    has_waves = any(shares.get('raceway_waves', 0.0) > MIN_WAVE_SHARE
                    for shares in found.budget.values())
    is_sound = found.sound_factor <= MAX_SOUND and not has_waves
    if found.cancelled or is_sound or search.settings.method == 'paper' or (
            search.is_too_quiet(found.sound_factor)):
        return found
    try:
        beside = _beside_errors(search, found)
    except (Cancelled, KeyboardInterrupt) as stopped:
        first = replace(
            found, cancelled=True, status='cancelled: the law without errors of the ring is '
            f'complete, that beside errors is not; {found.status}')
        if isinstance(stopped, KeyboardInterrupt):
            raise Interrupted(first) from None
        return first
    search.report('beside errors', SearchStep(  # ends a line of progress
        1, 1, found.chi_square, tuple(found.contact.to_array().tolist()), 0.0))
    if beside is None:
        words = ['no law within the bounds explains the misfit beside usual small errors of '
                 'ring and rig']
    else:
        named = [name for name, is_determined in beside.determined.items() if is_determined]
        words = [f'{", ".join(named)} are determined beside errors of the ring'] if named else []
    return replace(
        found, beside_errors=beside, status='; '.join([found.status, *words]),
        evaluations=search.evaluations, elapsed=time.monotonic() - search.started)


def identify_plain(runs: Sequence[Record], rig: Rig, *, on_progress: OnProgress | None = None,
                   is_cancelled: IsCancelled | None = None) -> Identification:
    """`identify` with usual settings, without the law beside errors of the ring."""
    return _identified(_Search(runs, rig, IdentificationSettings(), on_progress, is_cancelled))


def law_beside_errors(runs: Sequence[Record], rig: Rig, found: Identification, *,
                      on_progress: OnProgress | None = None,
                      is_cancelled: IsCancelled | None = None) -> FittedLaw | None:
    """The law of runs beside usual errors, from that of some of them without errors (found)."""
    return _beside_errors(
        _Search(runs, rig, IdentificationSettings(), on_progress, is_cancelled), found)


@one_blas_thread()
def _identified(search: _Search) -> Identification:
    """The law of a ring without errors."""
    observations = search.observations()
    search.notes += told_once((str(run.path), warning)
                              for run in search.runs for warning in warnings_of(run, search.rig))
    method = _by_paper if search.settings.method == 'paper' else _by_default
    return _judged(search, method(search, observations))


@dataclass(frozen=True)
class _Outcome:
    """End of a method."""

    contact: ContactParameters
    objective: float
    searched: tuple[str, ...]  # names
    observations: Sequence[Observation]
    bottom: tuple[WeightedObjective, objectives.Refinement] | None = None  # the last descent


def _by_paper(search: _Search, observations: Sequence[Observation]) -> _Outcome:
    """The published method: static records give K and n, and then dynamic ones give D."""
    static = [one for one in observations if not one.dynamic]
    dynamic = [one.coarse() for one in observations if one.dynamic]
    if not static:
        raise IdentificationError(
            "the paper's method needs a static run for K and n: add a static bag or use the "
            'default method')
    channels = search.settings.channels
    averaged = [average_branches(one.coarse(), search.rig.limits.level_step) for one in static]
    contact, objective = search.run_swarm(
        'static step', objectives.PaperObjective(search.rig, averaged, channels),
        search.space(STATIC_NAMES, search.start, log=False))
    if not dynamic or search.cancelled:
        return _Outcome(contact, objective, STATIC_NAMES, observations)
    contact, objective = search.run_swarm(
        'dynamic step', objectives.PaperObjective(search.rig, dynamic, channels),
        search.space(DAMPING_NAMES, contact, log=False))
    return _Outcome(contact, objective, PARAMETER_NAMES, observations)


def _by_default(search: _Search, observations: Sequence[Observation]) -> _Outcome:
    """Swarm for a start (statics first, if any), then joint least squares over all runs."""
    static = [one for one in observations if not one.dynamic]
    dynamic = [one for one in observations if one.dynamic]
    channels = search.settings.channels
    contact, best = search.start, np.inf
    if static:
        averaged = [average_branches(one.coarse(), search.rig.limits.level_step) for one in static]
        contact, best = search.run_swarm(
            'static swarm', WeightedObjective(search.rig, averaged, channels),
            search.space(STATIC_NAMES, contact, log=True))
    if dynamic and not search.cancelled:
        # The run whose load moves fastest shows the damping well enough for a start.
        shown = [max(dynamic, key=lambda one: float(np.ptp(one.load) / np.ptp(one.time)))]
        contact, best = search.run_swarm(
            'dynamic swarm',
            WeightedObjective(
                search.rig, [objectives.thinned(one) for one in (shown if static else dynamic)],
                channels),
            search.space(DAMPING_NAMES if static else PARAMETER_NAMES, contact, log=True))
    searched = PARAMETER_NAMES if dynamic else STATIC_NAMES
    if search.cancelled:
        return _Outcome(contact, best, searched, observations)
    return _refined(search, observations, contact, searched, best)


def _refined(search: _Search, observations: Sequence[Observation], contact: ContactParameters,
             searched: tuple[str, ...], best: float) -> _Outcome:
    """Joint least squares from two starts in long steps, then from the better one in short steps.

    The starts are the best point of the swarm and the true-to-scale parameters. A note reports
    if they end in different points.
    """
    channels = search.settings.channels
    rough = WeightedObjective(
        search.rig, [one.coarse(objectives.SEARCH_STEP) for one in observations], channels)
    coarse = replace(rough, observations=[one.coarse() for one in observations], evaluations=0)
    space = search.space(searched, search.start, log=True)
    outcome = _Outcome(contact, best, searched, observations)
    evaluations = 0

    def descend(objective: WeightedObjective, start: Array, damping: float = NEAR,
                number: int = 2) -> objectives.Refinement:
        end = refine(objective, space, start, search.is_cancelled, PROVISIONAL, damping)
        search.report('refinement', end.as_step(number))
        return end

    try:
        starts = [space.coordinates(one.to_array()) for one in (contact, search.start)]
        bottoms = [descend(rough, start, USUAL_DAMPING, number)
                   for number, start in enumerate(starts, start=1)]
        lowest = min(bottoms, key=lambda bottom: bottom.chi_square)
        lowest = descend(coarse, lowest.point)
        outcome = _Outcome(lowest.law, lowest.chi_square, searched, observations)
        first, second = (bottom.chi_square for bottom in bottoms)
        if abs(first - second) > max(0.1, 1e-6 * first):
            search.notes.append(
                f'two starts ended in different optima (chi square {first:.6g} and {second:.6g}): '
                'the result is the better one')
        fine = WeightedObjective(search.rig, search.observations(lowest.law), channels)
        with_cell = replace(
            fine, observations=[one.coarse() for one in fine.observations], evaluations=0)
        lowest = descend(with_cell, lowest.point)
        fine = fine.with_settled_plateaus(lowest.contact)
        for _ in range(LOAD_CORRECTIONS if search.has_dynamic else 0):
            lowest = descend(fine, lowest.point)
            fine = fine.with_likely_loads(lowest.contact)
        lowest = refine(fine, space, lowest.point, search.is_cancelled, damping=NEAR)
        evaluations = with_cell.evaluations + fine.evaluations
        outcome = _Outcome(
            lowest.law, lowest.chi_square, searched, fine.observations, (fine, lowest))
        search.report('refinement', lowest.as_step(3))
    except Cancelled:
        pass
    search.evaluations += rough.evaluations + coarse.evaluations + evaluations
    return outcome


@one_blas_thread()
def _beside_errors(search: _Search, found: Identification) -> FittedLaw | None:
    """The contact law beside errors of ring and rig; None if they do not explain the misfit.

    found: the law of a ring without errors. It is far from that of the contacts, so that waves,
    noise of the load cell and sensitivities are those of the law before, in PASSES.
    """
    law, reached = found.contact, found.chi_square
    space = search.space(PARAMETER_NAMES if search.has_dynamic else STATIC_NAMES, law, log=True)
    seed, usual = search.settings.seed, usual_errors(search.rig)
    for number in range(PASSES):
        contact = law.to_array()
        watch = partial(search.watch, 'beside errors', SearchStep(
            number, PASSES + 1, reached, tuple(contact.tolist()), 0.0))
        alone = WeightedObjective(search.rig, search.observations(law), search.settings.channels
                                  ).with_settled_plateaus(contact)
        usable = beside_errors(alone, space, law, usual, seed + number, watch)
        if usable is None:
            return None
        beside, objective = usable, usable.objective
        best = refine(objective, space, space.coordinates(contact), search.is_cancelled)
        law, reached = best.law, best.chi_square
        search.evaluations += objective.evaluations
        if reached > MAX_FIRST_CHI_SQUARE * degrees_of_freedom(objective, best):
            return None
    watch = partial(search.watch, 'beside errors', SearchStep(
        PASSES, PASSES + 1, reached, tuple(best.contact.tolist()), 0.0))
    trust = assess(
        objective, space, best,
        errors_beside(objective, best, beside.waves, usual, seed + PASSES, watch),
        search.bounds, MISFIT_ADVICE['default'])
    is_explained = (trust.reduced_chi_square <= MAX_SOUND**2 and not best.at_bound.any()
                    and beside.is_usual(best.contact))
    return FittedLaw(**vars(trust), contact=law, at_bound=at_bound(space, best)) if (
        is_explained) else None


def _judged(search: _Search, outcome: _Outcome) -> Identification:
    """Covariance and its consequences at the result; coarse if cancelled."""
    observations = outcome.observations
    space = search.space(outcome.searched, outcome.contact, log=True)
    if outcome.bottom is not None and not search.cancelled:
        objective, best = outcome.bottom
    else:
        if search.cancelled:
            observations = [one.coarse() for one in observations]
        objective = WeightedObjective(search.rig, observations, search.settings.channels)
        best = objectives.stay_at(objective, space, outcome.contact)
    advice = MISFIT_ADVICE[search.settings.method]
    step = SearchStep(0, 1, best.chi_square, tuple(best.contact.tolist()), 0.0)
    on_work = objectives.idle if search.cancelled else partial(search.report, 'intervals', step)
    trust = assess(
        objective, space, best, errors_of_ring(objective, best, on_work), search.bounds, advice,
        is_minimum=outcome.bottom is not None)
    if not search.cancelled:
        search.report('intervals', replace(step, iteration=1))
    made = Provenance(tuple(run.origin for run in search.runs))
    bags = tuple(one.name for one in observations)
    open_names = [name for name in PARAMETER_NAMES if not trust.determined[name]]
    words = []
    if trust.sound_factor > MAX_SOUND:
        words.append(
            f'the misfit is {np.sqrt(trust.reduced_chi_square):.2f} times the noise, and '
            f'{trust.sound_factor:.2f} times what noise and small errors of a sound ring leave: '
            f'intervals are widened and may be biased ({advice}; it finds none where smooth '
            'errors of the contact law, delays or noise of the load can explain this)')
    if search.is_too_quiet(trust.sound_factor):
        words.append(TOO_QUIET.format(trust.sound_factor))
    if trust.waves.rms:
        words.append(
            f'raceways that wave by {quantity(trust.waves.rms, "m", digits=2)} (rms) would '
            f'explain {percent(trust.waves.share)} of the power of the misfit: intervals allow '
            'for such waves')
    if open_names:
        words.append(f'{UNDETERMINED}: {", ".join(open_names)}')
    status = '; '.join(words) or 'identified'
    cancelled = search.cancelled
    if cancelled:
        status = 'cancelled: the best result so far'
    return Identification(
        **vars(trust), contact=outcome.contact, source=ParameterSource(
            method=search.settings.method, bags=bags, objective=outcome.objective,
            covariance=trust.noise_covariance, note='; '.join([status, *trust.reasons.values()]),
            sha256=tuple(origin.sha256 for origin in made.bags), versions=made.versions_in_words,
            undetermined=trust.reasons, rig_hash=search.rig.digest),
        method=search.settings.method, objective=outcome.objective,
        chi_square=best.chi_square, degrees_of_freedom=objective.size - len(space.free),
        at_bound=at_bound(space, best),
        evaluations=search.evaluations, elapsed=time.monotonic() - search.started, status=status,
        cancelled=cancelled, notes=tuple(search.notes))
