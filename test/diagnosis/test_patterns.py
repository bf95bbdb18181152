"""Claims on effects that act in several coordinates, in each by an amount of its own."""

from dataclasses import replace

from few_effects import few_effects
import numpy as np
import pytest

from saddlering_ros.bags.reader import read_run
from saddlering_ros.diagnosis.records import build_record
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Point, RunBlocks
from saddlering_ros.discrepancy.problem.fits import Fit
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.search.selection import Search, search_about
from saddlering_ros.discrepancy.search.space import prepare, refitted
from saddlering_ros.rig import default_rig

pytestmark = pytest.mark.slow


def best_of(runs: list[RunBlocks], change, *names: str) -> list[Fit]:
    """Fits to clean runs to which `change(run)` (4, N) is added, the best first.

    names: the effects that are fitted, the right one and those that look most like it.
    """
    changed = [replace(run, channels=run.channels + change(run)) for run in runs]
    with few_effects(*names):
        space = prepare(Problem(RingSystem(default_rig()), changed))
        return refitted(space, space.base)


def found_in(runs: list[RunBlocks]) -> Search:
    """The causes of runs and their alternatives; the verdict on them is not asked for."""
    return search_about(prepare(Problem(RingSystem(default_rig()), runs)))


def probes(run: RunBlocks, x: np.ndarray, y: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """What four probes read of a motion."""
    half = 0.5 * default_rig().probes.axial_span
    return np.stack([x, y + half * tilt, -x, y - half * tilt])


@pytest.fixture(scope='module')
def runs(campaign) -> list[RunBlocks]:
    return [build_record(default_rig(), read_run(bag), held_out=False).run
            for bag in campaign(runs=('static_50', 'dynamic_50_fast'))]


def test_settling_in_two_coordinates_is_one_cause_with_a_size_in_each(runs) -> None:
    def settled(run: RunBlocks) -> np.ndarray:
        highest = np.maximum.accumulate(run.inputs['load'])
        return probes(run, 0.0 * highest, 6e-11 * highest, 5e-11 * highest)

    best, second = best_of(runs, settled, 'settling', 'probe_drift', 'tilt_friction',
                           'film_creep', 'load_nonlinearity')[:2]
    (sizes,) = best.point.effects.values()
    assert best.candidate.ids == ('settling',)
    assert sizes['settling_y'] == pytest.approx(6e-11, rel=0.15)
    assert sizes['settling_tilt'] == pytest.approx(5e-11, rel=0.15)
    assert abs(sizes['settling']) < 1e-11
    assert second.misfit > best.misfit + 100.0


def test_a_carriage_that_sways_in_two_coordinates_has_no_share_in_the_third(runs) -> None:
    frequency, damping = 2.0 * np.pi / 0.3, 0.05

    def swaying(run: RunBlocks) -> np.ndarray:
        d1, d2, d3, d4 = run.channels
        axial = 0.5 * (d2 + d4)
        tilt = (d2 - d4) / default_rig().probes.axial_span
        return probes(run, swung(run, 0.5 * (d1 - d3)), 0.0 * axial, swung(run, tilt))

    def swung(run: RunBlocks, moved: np.ndarray) -> np.ndarray:
        """What a second mode adds to a motion, integrated in small steps."""
        if not run.rate.any():
            return 0.0 * moved
        step = 1e-3
        time = np.arange(run.time[0], run.time[-1], step)
        driven = np.interp(time, run.time, moved)
        y, rate, seen = driven[0], 0.0, np.empty(time.size)
        for number, value in enumerate(driven):
            rate += step * frequency * (frequency * (value - y) - 2.0 * damping * rate)
            y += step * rate
            seen[number] = y
        return np.interp(run.time, time, seen - driven)

    best = best_of(runs, swaying, 'carriage_resonance', 'damping_law', 'probe_lag', 'film_creep',
                   'clock_offset')[0]
    (shares,) = best.point.effects.values()
    assert best.candidate.ids == ('carriage_resonance',)
    assert shares['period'] == pytest.approx(0.3, rel=0.03)
    assert shares['share'] == pytest.approx(1.0, abs=0.15)
    assert shares['share_tilt'] == pytest.approx(1.0, abs=0.15)
    assert shares['share_y'] < 0.3


def with_effects(runs: list[RunBlocks], effects):
    """What effects add to the simulated readings of a run of the usual ring."""
    system = RingSystem(default_rig())
    base = np.array([item.from_unit(item.first_guess) for item in system.base_parameters])

    def added(run: RunBlocks) -> np.ndarray:
        plain, changed = system.predict_many(run, [Point(base), Point(base, effects)])
        return changed - plain

    return added


def test_a_joint_that_bends_in_two_coordinates_is_one_cause_with_a_compliance_in_each(runs):
    def bent(run: RunBlocks) -> np.ndarray:
        load, angle = run.inputs['load'], run.payload.elevation
        trunnion = default_rig().trunnion
        moment = load * (trunnion.y * np.cos(angle) + trunnion.x * np.sin(angle))
        return probes(run, 0.0 * load, -2.5e-10 * load * np.sin(angle), 4e-10 * moment)

    best = best_of(runs, bent, 'tilt_compliance', 'axial_compliance', 'radial_compliance',
                   'probe_bracket', 'load_gain', 'moment_arm')[0]
    (sizes,) = best.point.effects.values()
    assert best.candidate.ids == ('tilt_compliance',)
    assert sizes['compliance'] > 5e-11  # two short runs leave much of it to K1
    assert sizes['compliance_y'] > 5e-11
    assert sizes['compliance_x'] < 1e-11


def test_friction_against_tilt_and_radial_motion_is_one_cause_with_a_force_in_each(runs):
    loop = {'sharpness': 0.5, 'initial': 0.0}
    seals = {'tilt_friction': {**loop, 'moment': 7000.0, 'presliding': 3e-6, 'coordinate': 2.0,
                               'force': 0.0, 'presliding_x': 2e-6},
             'radial_friction': {**loop, 'force': 2000.0, 'presliding': 2e-6}}
    best, second = best_of(runs, with_effects(runs, seals), 'tilt_friction', 'radial_friction',
                           'cylinder_friction', 'film_creep', 'settling')[:2]
    (sizes,) = best.point.effects.values()
    assert best.candidate.ids == ('tilt_friction',)
    assert sizes['moment'] == pytest.approx(7000.0, rel=0.15)
    assert sizes['force'] == pytest.approx(2000.0, rel=0.25)
    assert second.misfit > best.misfit + 100.0


def test_friction_against_radial_motion_alone_has_no_alternative_that_contains_it(runs):
    seal = {'radial_friction': {'force': 6000.0, 'presliding': 2e-6, 'sharpness': 0.5,
                                'initial': 0.0}}
    changed = [replace(run, channels=run.channels + with_effects(runs, seal)(run)) for run in runs]
    with few_effects('radial_friction', 'tilt_friction', 'cylinder_friction', 'film_creep'):
        found = found_in(changed)
    assert found.fit.candidate.ids == ('radial_friction',)
    assert 'tilt_friction' not in alternatives_of(found)


def alternatives_of(found: Search) -> set[str]:
    """Every effect that stays open beside the causes."""
    return {name for models in found.alternatives.values() for model in models
            for name in model.candidate.ids}


TILT_LIMIT = 2.8e-11
"""Its detection limit [rad/(N m)] in five clean runs of this kind."""


def test_a_tilt_compliance_of_several_times_its_limit_is_the_first_of_its_group(campaign) -> None:
    runs = ('static_50', 'dynamic_50_fast', 'static_70')
    bags = campaign('tilt_compliance', 3.6 * TILT_LIMIT, 'compliance', runs, seed=5)
    found = found_in([build_record(default_rig(), read_run(bag), held_out=False).run
                      for bag in bags])
    assert found.fit.candidate.ids == ('tilt_compliance',)
    assert 'probe_bracket' not in alternatives_of(found)


def test_a_clearance_that_leaves_a_quarter_of_a_friction_is_no_alternative_to_it(campaign) -> None:
    bags = campaign('tilt_friction', 3000.0, 'moment',
                    ('static_50', 'dynamic_50_fast', 'static_70'))
    with few_effects('tilt_friction', 'axial_clearance', 'radial_clearance', 'unequal_rows'):
        found = found_in([build_record(default_rig(), read_run(bag), held_out=False).run
                          for bag in bags])
    assert found.fit.candidate.ids == ('tilt_friction',)
    assert alternatives_of(found) <= {'tilt_friction'}
