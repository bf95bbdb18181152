"""Claims on which effects are found: alternatives, masked pairs, small sizes, stopped bases."""

from __future__ import annotations

from dataclasses import replace
import operator
from types import MappingProxyType, SimpleNamespace

from bench import LOAD, measured, Shapes, STEP, System, TIME
import numpy as np
import pytest

from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import diagnose_system, Effect, Parameter, Point, Problem, Settings
from saddlering_ros.discrepancy.problem.fits import Fit
from saddlering_ros.discrepancy.search import selection
from saddlering_ros.discrepancy.search import space as spaces
from saddlering_ros.discrepancy.search.evidence import SearchLog
from saddlering_ros.discrepancy.search.ranking import _pair_gains, Score, shortlist, starts_of_each
from saddlering_ros.discrepancy.search.space import fit_each, ModelSpace, prepare


def only_cause(system: System, run: discrepancy.RunBlocks, settings: Settings | None = None,
               ) -> discrepancy.Cause:
    (cause,) = diagnose_system(Problem(system, [run], settings or Settings())).causes
    return cause


def test_a_second_variant_is_tried_unless_it_is_far_worse_or_fits_as_the_first() -> None:
    scores = [Score(SimpleNamespace(id=name), variant, gain, np.zeros(1)) for name, variant, gain
              in (('a', 0, 100.0), ('a', 1, 99.999), ('a', 2, 80.0), ('a', 3, 70.0),
                  ('b', 0, 65.0), ('b', 1, 50.0), ('c', 0, 0.5))]
    listed = [(one.effect.id, one.variant) for one in shortlist(scores, 1.0, 5)]
    assert listed == [('a', 0), ('a', 2), ('b', 0)]


# --- look-alikes ---


class TwoSensors(System):
    """Two sensors of one motion, of which one may have another gain."""

    channel_names = ('one', 'other')
    views = MappingProxyType({'one': np.array([1.0, 0.0]), 'other': np.array([0.0, 1.0])})
    effects = (Effect('gain', {'size': Parameter(-0.3, 0.3)},
                      variants=({'sensor': 0.0}, {'sensor': 1.0})),)

    def predict(self, name: str, point: Point) -> np.ndarray:
        gain = point.effects.get('gain', {'sensor': 0.0, 'size': 0.0})
        return point.base[0] * np.outer(
            [1.0 + gain['size'] * (gain['sensor'] == place) for place in (0.0, 1.0)], LOAD)


@pytest.mark.parametrize('sensor', [0.0, 1.0])
def test_a_place_that_another_base_makes_as_good_is_told_beside_the_named_one(sensor) -> None:
    system = TwoSensors()
    cause = only_cause(system, measured(system, 1e-3, {'gain': {'sensor': sensor, 'size': 0.05}}))
    (other,) = cause.elsewhere
    places = {cause.parameters['sensor'].value: cause.parameters['size'].value,
              other['sensor']: other['size']}
    assert places[sensor] == pytest.approx(0.05, abs=3e-3)
    assert places[1.0 - sensor] == pytest.approx(-0.05 / 1.05, abs=3e-3)


def group_of_a_square(stretches: int) -> set[str]:
    """Of a hidden square, the noise known from so many stretches at rest.

    It is as small as a square that fits better than a cube, but not by more than a noise of
    unsure level might make.
    """
    chance = np.random.default_rng(4)
    rest = [discrepancy.RestSegment(1e-3 * chance.normal(size=(1, 80)), STEP)
            for _ in range(stretches)]
    system = Shapes(0.2, square=LOAD**2, cube=LOAD**3)
    run = measured(system, 1e-3, {'square': {'size': 0.042}}, seed=3, rest=rest)
    return set(only_cause(system, run, Settings(form_error=0.0)).group)


def test_a_look_alike_leaves_the_group_only_where_the_noise_is_well_known() -> None:
    assert group_of_a_square(6) == {'square', 'cube'}
    assert group_of_a_square(100) == {'square'}


def test_an_effect_that_the_base_almost_imitates_is_tried_as_an_alternative() -> None:
    system = Shapes(1.0, almost=LOAD + 0.08 * LOAD**2, cube=LOAD**3)
    cause = only_cause(system, measured(system, 1e-3, {'almost': {'size': 0.8}}, seed=3))
    assert cause.effect == 'almost'


def test_alternatives_are_those_of_the_model_that_the_last_round_leads_to(monkeypatch) -> None:
    """Those of a replaced member are no alternatives to the model without it."""
    monkeypatch.setattr(selection, 'MAX_CHECKS', 1)
    system = Shapes(square=LOAD**2, cube=LOAD**3)
    space = prepare(Problem(system, [measured(system, 1e-3, {'cube': {'size': 0.1}})]))
    scores = [score for score in space.scores(space.base) if score.effect.id == 'square']
    wrong = fit_each(space, space.base, scores)[0]
    fit, alternatives = selection.check_alternatives(space, wrong, SearchLog())
    assert fit.candidate.ids == ('cube',)
    assert alternatives == {'cube': ()}


# --- what is simulated once ---


def test_a_fit_goes_on_in_another_metric_and_from_its_starts_without_a_new_simulation() -> None:
    system = Shapes(square=LOAD**2, cube=LOAD**3)
    space = prepare(Problem(system, [measured(system, 1e-3, {'cube': {'size': 0.1}})]))
    trials = starts_of_each(space.scores(space.base))
    begun = space.started(space.base, trials)
    before = space.problem.simulations
    metric = space.metric.with_offsets()
    (fit,) = spaces.refit_full_jacobian(metric, [space.base], rounds=0)
    white = metric.whiten(fit.prediction - space.problem.measured)
    assert fit.misfit == pytest.approx(white @ white)
    assert all(map(operator.is_, space.started(space.base, trials), begun))
    assert space.problem.simulations == before


# --- one cause for two, two causes for none ---


@pytest.mark.parametrize(('unlisted', 'effects'), [(0.0, 3), (0.3, 2)])
def test_no_third_effect_is_looked_for_where_two_explain_little(unlisted, effects) -> None:
    waves = {name: np.sin(turns * np.pi * TIME / TIME[-1])
             for name, turns in (('a', 5.0), ('b', 8.0), ('c', 11.0), ('unlisted', 14.0))}
    wave = unlisted * waves.pop('unlisted')
    system = Shapes(**waves)
    noise = 1e-3 * np.random.default_rng(2).normal(size=(1, 80))
    run = measured(system, 1e-3, {name: {'size': 0.1} for name in waves},
                   rest=[discrepancy.RestSegment(noise, STEP)])
    space = prepare(Problem(system, [replace(run, channels=run.channels + wave)]))
    fit = selection.forward(space, space.base, SearchLog())
    assert len(fit.candidate.effects) == effects


def test_one_effect_takes_the_place_of_two_that_fit_no_better(monkeypatch) -> None:
    search = selection.forward

    def misled(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
        """A search that never tries what is both, from the base."""
        if fit.candidate.effects:
            return search(space, fit, log)
        for name in ('square', 'cube'):
            scores = [score for score in space.scores(fit) if score.effect.id == name]
            fit = fit_each(space, fit, scores)[0]
        return fit

    monkeypatch.setattr(selection, 'forward', misled)
    system = Shapes(square=LOAD**2, cube=LOAD**3, both=LOAD**2 - 2.0 * LOAD**3)
    cause = only_cause(system, measured(system, 1e-3, {'both': {'size': 0.2}}, seed=3))
    assert cause.effect == 'both'
    assert cause.parameters['size'].value == pytest.approx(0.2, rel=0.1)


class Held(Shapes):
    """A bench whose simulator fails at large slopes unless the load's square holds it."""

    def predict(self, name: str, point: Point) -> np.ndarray:
        held = point.effects.get('square', {'size': 0.0})['size'] < -0.1
        seen = super().predict(name, point)
        return seen if held or point.base[0] < 1.5 else np.full_like(seen, np.nan)


def test_a_model_that_fails_without_one_of_its_effects_is_refitted_from_the_base() -> None:
    system = Held(square=LOAD**2, cube=LOAD**3)
    space = prepare(Problem(system, [measured(system, 1e-3, {'cube': {'size': 0.1}})]))
    fit = space.base
    for name in ('square', 'cube'):
        scores = [score for score in space.scores(space.base) if score.effect.id == name]
        fit = fit_each(space, fit, scores)[0]
    slope, square = system.base_parameters[0].to_unit(1.9), 0.2
    both = replace(fit, theta_unit=np.array([slope, square, fit.theta_unit[2]]))
    less = space.without(both, 'square')
    assert less.converged
    assert less.point.effects['cube']['size'] == pytest.approx(0.1, rel=0.02)


SIZES = {'push': 0.24, 'pull': -0.196}
"""In these sizes, each change covers almost all of the other."""


def spring(**sizes: float) -> discrepancy.Diagnosis:
    """The diagnosis of a run with effects of these sizes, whose shapes are nearly the same."""
    system = Shapes(push=LOAD**2, pull=LOAD**2.5)
    effects = {name: {'size': size} for name, size in sizes.items()}
    return diagnose_system(Problem(system, [measured(system, 3e-3, effects, seed=2)]))


def test_two_causes_that_mask_each_other_are_both_named(monkeypatch: pytest.MonkeyPatch) -> None:
    found = spring(**SIZES)
    assert {cause.effect for cause in found.causes} == set(SIZES)
    assert 0.0 <= found.explained <= 1.0
    monkeypatch.setattr(selection, 'masked_pair', lambda space, fit, log: fit)
    assert not spring(**SIZES).causes


@pytest.mark.parametrize('sizes', [{}, {'push': 0.24}])
def test_one_cause_or_none_gets_no_partner(sizes: dict[str, float]) -> None:
    assert {cause.effect for cause in spring(**sizes).causes} == set(sizes)


def test_factors_of_a_pair_stay_within_their_reach() -> None:
    chance = np.random.default_rng(5)
    stack = chance.normal(size=(30, 3))
    products = stack.T @ chance.normal(size=30)
    reach = np.array([[0.0, 0.1], [-0.05, 0.05], [-1.0, 1.0]])
    gains, first, second = _pair_gains(stack, products, reach)
    grid = [np.linspace(low, high, 201) for low, high in reach]
    for row, column in ((0, 1), (1, 2), (2, 0)):
        one, other = np.meshgrid(grid[row], grid[column], indexing='ij')
        pair = stack[:, [row, column]]
        falls = 2.0 * (one * products[row] + other * products[column]) - (
            (pair @ np.stack([one.ravel(), other.ravel()])) ** 2).sum(axis=0).reshape(one.shape)
        assert gains[row, column] == pytest.approx(falls.max(), rel=1e-3)
        assert reach[row, 0] <= first[row, column] <= reach[row, 1]
        assert reach[column, 0] <= second[row, column] <= reach[column, 1]


# --- effects that do little where the search begins ---


class Bow(System):
    """One channel straight in the load, bent by some power of it, or by its third."""

    effects = (
        Effect('some power', {'size': Parameter(-0.5, 0.5), 'power': Parameter(1.1, 8.0)},
               starts=({'size': 0.1, 'power': 1.3},)),
        Effect('third power', {'size': Parameter(-0.5, 0.5)}))

    def predict(self, name: str, point: Point) -> np.ndarray:
        bent = [values['size'] * LOAD ** values.get('power', 3.0)
                for values in point.effects.values()]
        return (point.base[0] * LOAD + sum(bent))[None, :]


def test_an_effect_of_a_small_first_order_gain_is_refitted_before_another_is_named() -> None:
    run = measured(Bow(), 1e-3, {'some power': {'size': 0.2, 'power': 4.5}}, seed=3)
    found = diagnose_system(Problem(Bow(), [run], Settings(refits=1)))
    tried = {item.effects for item in found.search.candidates if item.step == 1}
    (cause,) = found.causes
    assert tried == {('some power',), ('third power',)}
    assert cause.effect == 'some power'
    assert cause.parameters['power'].value == pytest.approx(4.5, abs=0.3)


class Stopped(System):
    """One channel straight in the load, less a part that ends at a stop."""

    effects = (
        Effect('stop', {'height': Parameter(0.0, 4.0)}),
        Effect('square', {'size': Parameter(-0.2, 0.2)}),
        Effect(
            'clip',
            {'limit': Parameter(0.1, 3.0, neutral=3.0)},
            starts=tuple({'limit': limit} for limit in (0.3, 0.6, 1.2))))

    def predict(self, name: str, point: Point) -> np.ndarray:
        height = point.effects.get('stop', {'height': 0.0})['height']
        size = point.effects.get('square', {'size': 0.0})['size']
        seen = point.base[0] * LOAD - 0.3 * np.minimum(LOAD, height) + size * LOAD**2
        limit = point.effects.get('clip', {'limit': 3.0})['limit']
        return np.minimum(seen, limit)[None, :]


@pytest.mark.parametrize(('effect', 'parameter', 'value', 'error'), [
    ('stop', 'height', 0.02, 0.002), ('clip', 'limit', 0.96, 0.002)],
    ids=['a stop at a sixth of the smallest start', 'a limit that cuts a little'])
def test_an_effect_much_smaller_than_usual_is_found(effect, parameter, value, error) -> None:
    cause = only_cause(Stopped(), measured(Stopped(), 1e-4, {effect: {parameter: value}}))
    assert cause.group == (effect,)
    assert cause.parameters[parameter].value == pytest.approx(value, abs=error)


def test_the_limit_of_a_clip_is_told_as_the_clip_and_not_as_its_distance_from_none() -> None:
    found = diagnose_system(Problem(Stopped(), [measured(Stopped(), 1e-4, {})]))
    limits = next(item for item in found.observability.limits if item.effect == 'clip')
    assert 0.8 < limits.limit <= limits.best_limit < 1.0  # of a reading that goes to 1


RATE = np.gradient(LOAD, STEP)
POWERS = range(2, 11)
"""Of the load: more effects than are refitted in a step."""


class Dragged(System):
    """One channel straight in the load, and dragged in proportion to its rate."""

    base_parameters = (
        Parameter(0.5, 2.0, name='slope'),
        Parameter(1e-6, 1.0, start=0.5, name='drag'))
    effects = (
        Effect('turning', {'share': Parameter(0.0, 1.0)}),
        *(Effect(f'power_{power}', {'size': Parameter(-0.2, 0.2)}) for power in POWERS))

    def predict(self, name: str, point: Point) -> np.ndarray:
        share = point.effects.get('turning', {'share': 0.0})['share']
        seen = point.base[0] * LOAD + point.base[1] * (1.0 - 3.0 * share * LOAD) * RATE
        for power in POWERS:
            size = point.effects.get(f'power_{power}', {'size': 0.0})['size']
            seen = seen + size * LOAD**power
        return seen[None, :]


def test_an_effect_that_does_nothing_at_a_bound_of_the_base_is_found_all_the_same() -> None:
    """A drag that turns round with load sends one without it to nothing, where it has no share."""
    run = measured(Dragged(), 1e-4, {'turning': {'share': 0.9}}, base=(1.0, 0.5))
    found = diagnose_system(Problem(Dragged(), [run]))
    (cause,) = found.causes
    assert cause.group == ('turning',)
    assert cause.parameters['share'].value == pytest.approx(0.9, rel=0.05)
    assert found.base_alone['drag'].value == pytest.approx(0.0, abs=1e-3)
