"""What given tests of a rig could find, before they are made.

The tests are simulated on the ring of the rig file. Their detection limits, look-alikes and the
accuracy of the contact law follow from the sensitivities of the readings and from the noise, as in
a diagnosis. Nothing is drawn, so that a plan is the same every time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

import numpy as np

from saddlering_ros import discrepancy
from saddlering_ros.diagnosis.next_test import load_run, staircase
from saddlering_ros.diagnosis.records import Array
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import RunBlocks
from saddlering_ros.effects import catalogue
from saddlering_ros.errors import plain_number, SaddleringError
from saddlering_ros.estimation.process import ChannelNoise, TIME_CONSTANTS
from saddlering_ros.identification.uncertainty import distinct_elevations, reason_of_tests
from saddlering_ros.progress import one_blas_thread, OnProgress, Watch
from saddlering_ros.record.record import HIGHEST_ELEVATION, LOWEST_ELEVATION
from saddlering_ros.rig import ContactParameters, PARAMETER_NAMES, Rig, TRUE_TO_SCALE
from saddlering_ros.rig.parameter_file import PARAMETER_UNITS

STATIC_RATE, DYNAMIC_RATE = 25.0, 1000.0
"""Sampling rates [Hz] of the shipped tests."""

PROBE_NOISE = 0.3e-6
"""Standard deviation [m] of a reading of a probe, as in the shipped bags."""

WANDER = {10.0: 0.33, 40.0: 0.53}
"""Slow noise as shares of PROBE_NOISE by time constant [s]: a diagnosis learns 0.10 um at 10 s and
0.16 um at 40 s from the shipped static bags."""

PAIRS = 12
"""Degrees of freedom of the noise: a ramp rests for seconds, and a diagnosis counts no fewer."""

LOOK_ALIKE = 0.9
"""Cosine of two signatures from which the data hardly tell the causes apart."""

ELEVATIONS = (0.0, 30.0, 50.0, 70.0)
"""Elevations [deg] of the tests among which the best further test is chosen."""

MISSED = 1.0
"""Score of a cause that the tests cannot show: as if its limit were ten typical sizes."""

BEST_COUNT = 4  # tests of the default plan


class PlanError(SaddleringError):
    """Tests that cannot be planned; one line: fault, place, remedy."""


@dataclass(frozen=True)
class PlannedTest:
    """A test before it is made: its kind, elevation [deg], and its course."""

    kind: str
    elevation_deg: float

    @property
    def name(self) -> str:
        """As typed: 'static:50'."""
        return f'{self.kind}:{self.elevation_deg:g}'

    def run(self, rig: Rig) -> RunBlocks:
        """The test as a run without readings."""
        if self.kind == 'static':
            return replace(staircase(rig, self.elevation_deg), name=self.name)
        full, low = rig.full_scale_load, rig.preload
        times, shape, step = COURSES[self.kind]
        loads = [low + share * (full - low) for share in shape]
        return replace(load_run(rig, self.elevation_deg, times, loads, step), name=self.name)


COURSES: dict[str, tuple[list[float], list[float], float]] = {
    'dynamic': ([0, 2, 6, 10, 12], [0, 0, 1, 0, 0], 1e-2),
    'fast': ([0, 2, 3, 4, 6], [0, 0, 1, 0, 0], 5e-3),
    'slow': ([0, 2, 32, 62, 64], [0, 0, 1, 0, 0], 1.0),
    'cycles': ([0, 1, 6, 36, 41, 71, 76, 106, 111, 141], [0, 0, 1, 1, 0, 0, 1, 1, 0, 0], 1.0)}
"""Times [s], shares of full scale over the preload, and longest step [s] of each kind of ramp."""

KINDS = ('static', *COURSES)

ALL_TESTS = [PlannedTest(kind, degrees) for degrees in ELEVATIONS for kind in KINDS]
"""Tests among which the best are chosen."""


def planned_test(text: str) -> PlannedTest:
    """A test as typed, KIND:ELEVATION; PlanError if there is none."""
    kind, _, degrees = text.partition(':')
    if kind not in KINDS:
        raise PlanError(f'--test {text}: there is no kind {kind!r}: give KIND:ELEVATION with one '
                        f'of {", ".join(KINDS)}, such as static:50')
    try:
        elevation = plain_number(degrees)
    except ValueError:
        elevation = math.nan
    if not LOWEST_ELEVATION <= elevation <= HIGHEST_ELEVATION:
        fault = f'{degrees} is no elevation' if degrees else 'the elevation is missing'
        raise PlanError(f'--test {text}: {fault}: give degrees from {LOWEST_ELEVATION:g} to '
                        f'{HIGHEST_ELEVATION:g}, such as static:50')
    return PlannedTest(kind, elevation)


@dataclass(frozen=True)
class CausePlan:
    """What the tests would show of one cause: limit in its unit, look-alikes, typical size."""

    effect: str
    title: str
    limit: float
    unit: str
    is_testable: bool
    group: tuple[str, ...]
    typical: float

    @property
    def score(self) -> float:
        """Logarithm of the limit over the typical size, at most MISSED."""
        return min(MISSED, math.log10(self.limit / self.typical)) if self.is_testable else MISSED


@dataclass(frozen=True)
class Plan:
    """Tests with what they would find; further: the test that would add most, with its score.

    accuracy: standard deviation of each contact parameter of an exact rig, in its unit.
    """

    tests: tuple[PlannedTest, ...]
    causes: tuple[CausePlan, ...]
    accuracy: dict[str, float]
    contact: ContactParameters
    further: PlannedTest | None
    further_gain: float
    noise: float

    @property
    def undetermined(self) -> dict[str, str]:
        """Why an identification of these tests would leave a parameter open, by name."""
        elevations = distinct_elevations(math.radians(test.elevation_deg) for test in self.tests)
        is_static = all(test.kind == 'static' for test in self.tests)
        reasons = {}
        for name, std in self.accuracy.items():
            size = 1.0 if name[0] == 'n' else getattr(self.contact, name)
            if reason := reason_of_tests(name, std / size, elevations, is_static=is_static):
                reasons[name] = reason
        return reasons

    @property
    def score(self) -> float:
        """Mean score of the causes; lower is better."""
        return float(np.mean([cause.score for cause in self.causes]))

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            'tests': [test.name for test in self.tests],
            'causes': [
                {'effect': item.effect, 'title': item.title, 'unit': item.unit,
                 'limit': item.limit if item.is_testable else None, 'typical': item.typical,
                 'testable': item.is_testable, 'group': list(item.group)}
                for item in self.causes],
            'parameters': {
                name: {'value': getattr(self.contact, name), 'std': self.accuracy[name],
                       'unit': PARAMETER_UNITS[name], 'reason': self.undetermined.get(name)}
                for name in PARAMETER_NAMES},
            'further_test': None if self.further is None else {
                'test': self.further.name, 'factor': 10.0 ** self.further_gain},
            'assumed': {'probe_noise': self.noise, 'static_rate': STATIC_RATE,
                        'dynamic_rate': DYNAMIC_RATE}}


@dataclass
class Planner:
    """Plans of one rig; simulations of a test serve every plan that contains it."""

    rig: Rig
    contact: ContactParameters = TRUE_TO_SCALE
    noise: float = PROBE_NOISE
    watch: Watch = field(default_factory=lambda: Watch('plan', None, None))

    def __post_init__(self) -> None:
        self._system = KeptSystem(RingSystem(self.rig))
        self._runs: dict[PlannedTest, RunBlocks] = {}

    def plan(self, tests: Sequence[PlannedTest], candidates: Sequence[PlannedTest] = ()) -> Plan:
        """What the tests would find, and the candidate that would add most."""
        self.watch.check()
        plan = self._without_further(tests)
        others = [self._without_further([*tests, test]) for test in candidates
                  if test not in tests]
        if not others:
            return plan
        best = min(others, key=lambda other: other.score)
        gain = plan.score - best.score
        return replace(plan, further=best.tests[-1], further_gain=gain) if gain > 0.0 else plan

    def best(self) -> Plan:
        """The tests that are found one after another, each the one that adds most."""
        chosen: list[PlannedTest] = []
        for number in range(BEST_COUNT):
            self.watch.progress(f'test {number + 1} of {BEST_COUNT}', number / BEST_COUNT)
            plans = [self._without_further([*chosen, test]) for test in ALL_TESTS
                     if test not in chosen]
            chosen.append(min(plans, key=lambda plan: plan.score).tests[-1])
        return self.plan(chosen, ALL_TESTS)

    def _without_further(self, tests: Sequence[PlannedTest]) -> Plan:
        plain = discrepancy.Point(self.contact.to_array())
        for test in tests:
            if test not in self._runs:  # The readings are those of the ring without any cause.
                empty = test.run(self.rig)
                self._runs[test] = replace(
                    empty, channels=self._system.predict_many(empty, [plain])[0])
        start = dict(zip(PARAMETER_NAMES, self.contact.to_array(), strict=True))
        space = discrepancy.prepare(discrepancy.Problem(
            self._system, [self._runs[test] for test in tests], start=start, watch=Watch('plan'),
            assumptions=discrepancy.Assumptions(learn_noise=self._noise_of)))
        white = space.tangent_of(space.base).white
        covariance = np.linalg.inv(white.T @ white + np.eye(white.shape[1]))
        accuracy = {
            item.name: float(item.slope(float(unit)) * np.sqrt(covariance[index, index]))
            for index, (item, unit) in enumerate(zip(
                self._system.base_parameters, space.base.theta_unit, strict=True))}
        seen = discrepancy.observed(space)
        alike: dict[str, set[str]] = {}
        causes_of = [label.partition(':')[0] for label in seen.labels]
        for name, row in zip(causes_of, seen.cosines, strict=True):
            alike.setdefault(name, set()).update(
                other for other, cosine in zip(causes_of, row, strict=True)
                if cosine >= LOOK_ALIKE and other != name)
        causes = []
        for limit in seen.limits:
            effect = catalogue()[limit.effect]
            size = next(item for item in effect.parameters_on(self.rig) if item.amplitude)
            causes.append(CausePlan(
                limit.effect, effect.title, limit.limit, limit.unit, limit.testable,
                (limit.effect, *sorted(alike.get(limit.effect, ()))), abs(size.scale)))
        return Plan(tuple(tests), tuple(causes), accuracy, self.contact, None, 0.0, self.noise)

    def _noise_of(self, runs: Sequence[RunBlocks],
                  residuals: Sequence[Array] | None) -> dict[tuple[str, int], ChannelNoise]:
        """The same noise for every probe; a reading has `noise`, and the probe wanders."""
        slow = np.array([(WANDER.get(tau, 0.0) * self.noise) ** 2
                         for tau in TIME_CONSTANTS.tolist()])
        return {
            (run.name, channel): ChannelNoise(self.noise**2 / (
                STATIC_RATE if run.name.startswith('static') else DYNAMIC_RATE), slow, 0.0, PAIRS)
            for run in runs for channel in range(len(run.channels))}


class KeptSystem:
    """The ring with the readings of every point kept by test, because plans share tests."""

    def __init__(self, ring: RingSystem) -> None:
        self._ring = ring
        self._readings: dict[tuple[str, str], Array] = {}
        self.channel_names, self.views = ring.channel_names, ring.views
        self.base_parameters, self.effects = ring.base_parameters, ring.effects

    def predict_many(self, run: RunBlocks, points: Sequence[discrepancy.Point]) -> Array:
        """Channels (B, C, N); points that were asked for before are not simulated again."""
        keys = [
            (run.name, f'{point.base.tolist()} '
                       f'{[(name, *values.items()) for name, values in point.effects.items()]}')
            for point in points]
        new = {key: point for key, point in zip(keys, points, strict=True)
               if key not in self._readings}
        if new:
            simulated = self._ring.predict_many(run, list(new.values()))
            self._readings.update(zip(new, simulated, strict=True))
        return np.stack([self._readings[key] for key in keys])

    def nuisances(self, runs: Sequence[RunBlocks], point: discrepancy.Point) -> list[Array]:
        """As the ring."""
        return self._ring.nuisances(runs, point)


@one_blas_thread()
def plan_tests(rig: Rig, tests: Sequence[PlannedTest] = (),
               contact: ContactParameters = TRUE_TO_SCALE, *, noise: float = PROBE_NOISE,
               on_progress: OnProgress | None = None) -> Plan:
    """What the tests would find and the best further one; without tests, the four best.

    noise [m]: standard deviation of a reading of a probe.
    """
    planner = Planner(rig, contact, noise, Watch('plan', on_progress))
    return planner.plan(list(tests), ALL_TESTS) if tests else planner.best()
