"""Claims about simulated next tests: what they promise is what a second diagnosis finds."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from saddlering_ros.discrepancy import (
    diagnose_system,
    Effect,
    next_step,
    Parameter,
    Point,
    Problem,
    Proposal,
    Reading,
    RunBlocks,
)
from test.discrepancy.bench import LOAD, recorded, STEP, System, TIME

NOISE = 2e-3


class Spring(System):
    """A spring whose force is measured wrongly, or that yields with time: alike at one rate."""

    effects = (
        Effect('a parabola', {'size': Parameter(-1.0, 1.0, start=0.1)}, id='parabola'),
        Effect('the same with the rate', {'size': Parameter(-1.0, 1.0, start=0.1)}, id='rate'))

    def predict(self, name, point):
        return one_run(name, point)


def one_run(name, point):
    load = LOAD * (0.3 if 'low' in name else 1.0)
    faster = 3.0 if 'fast' in name else 1.0
    seen = point.base[0] * load
    seen = seen + point.effects.get('parabola', {}).get('size', 0.0) * load**2
    seen = seen + point.effects.get('rate', {}).get('size', 0.0) * faster * load**2
    return seen[None]


def measured(name, truth, seed):
    exact = one_run(name, Point(np.array([1.0]), truth))
    return recorded(name, exact + np.random.default_rng(seed).normal(0.0, NOISE, exact.shape))


def proposed(name, **more) -> Proposal:
    empty = RunBlocks(name, 'bench', TIME, np.full(TIME.size, STEP), np.zeros((1, TIME.size)),
                      {'load': LOAD}, direction=np.sign(np.gradient(LOAD)))
    return Proposal(f'Load the {name} way.', empty, **more)


@cache
def verdict():
    tests = [proposed('same'), proposed('fast'), proposed('low'),
             proposed('direct', readings=(Reading('rate', 1e-3),))]
    runs = [measured('first', {'parabola': {'size': 0.1}}, 1)]
    return diagnose_system(Problem(Spring(), runs, proposals=tests))


def share_of(name: str) -> float:
    return next(item.share for item in verdict().separations if item.proposal.run.name == name)


def test_a_group_gets_the_test_that_separates_it_in_every_simulated_draw():
    assert verdict().verdict == 'ambiguous'
    assert verdict().separations[0].proposal.run.name in ('fast', 'direct')
    assert share_of('fast') > 0.95


def test_a_repeated_test_separates_nothing():
    assert share_of('same') == 0.0
    assert share_of('low') < 0.05


def test_a_direct_measurement_of_one_cause_separates_the_group():
    assert share_of('direct') > 0.95


def test_an_unknown_cause_with_alternatives_gets_the_test_that_parts_them():
    """A wave that no effect has keeps the cause from being established."""
    wave = 0.01 * np.sin(2.0 * np.pi * TIME / 2.7) * LOAD
    run = measured('first', {'parabola': {'size': 0.1}}, 1)
    tests = [proposed('same'), proposed('fast')]
    found = diagnose_system(Problem(
        Spring(), [replace(run, channels=run.channels + wave)], proposals=tests))
    assert (found.verdict, found.causes[0].group) == ('unknown', ('parabola', 'rate'))
    assert found.next_test == 'Load the fast way.'
    fast, same = (one.together for one in found.separations)
    assert fast == ((('parabola',),), (('rate',),))
    assert same == ((('parabola',), ('rate',)),)


def test_alternatives_of_a_cause_that_explains_little_are_not_parted():
    wave = 0.02 * np.sin(2.0 * np.pi * TIME / 2.7) * LOAD
    run = measured('first', {'parabola': {'size': 0.1}}, 1)
    found = diagnose_system(Problem(
        Spring(), [replace(run, channels=run.channels + wave)], proposals=[proposed('fast')]))
    assert (found.verdict, found.causes[0].group) == ('unknown', ('parabola', 'rate'))
    assert 0.1 < found.explained < 0.25
    assert (found.separations, found.next_test) == ((), None)


class Tangents(Spring):
    """The same with its neighbourhoods, so that its best tests are judged by refits."""

    def neighbourhood(self, groups):
        return lambda run: [self.predict_many(run, group) for group in groups]


def test_refits_of_a_linear_system_promise_what_its_forecasts_do(monkeypatch):
    calls = []
    refit = next_step.refit_full_jacobian
    monkeypatch.setattr(next_step, 'refit_full_jacobian', lambda *args: (
        calls.append(args), refit(*args))[1])
    runs = [measured('first', {'parabola': {'size': 0.1}}, 1)]
    for name, share, together in (('fast', 1.0, 1), ('low', 0.0, 2)):
        (one,) = diagnose_system(Problem(Tangents(), runs, proposals=[proposed(name)])).separations
        assert one.share == pytest.approx(share, abs=0.05)
        assert (one.refitted, one.caveat) == (True, '')
        assert {len(group) for group in one.together} == {together}
    assert len(calls) == 4  # Each of two models as the truth, in each of two tests.


def test_the_true_cause_is_kept_whatever_the_test():
    assert all(item.kept == item.draws for item in verdict().separations)


def test_the_interval_of_a_share_holds_it_and_narrows_with_the_draws():
    one = verdict().separations[0]
    few, many = (replace(one, draws=count, alone=count // 2) for count in (20, 2000))
    assert few.interval[0] < many.interval[0] < 0.5 < many.interval[1] < few.interval[1]


def test_the_summary_states_the_test_and_its_share():
    assert 'of 100 simulated draws; a linear forecast, which can promise' in verdict().summary()


@pytest.mark.parametrize('cause', ['parabola', 'rate'])
def test_the_promise_is_kept_by_a_second_diagnosis_with_the_test_made(cause):
    truth = {cause: {'size': 0.1}}
    runs = [measured('first', truth, 3), measured('fast', truth, 4)]
    found = diagnose_system(Problem(Spring(), runs))
    assert (found.verdict, [item.effect for item in found.causes]) == ('named', [cause])
