"""Claims about the particle swarm."""

from itertools import pairwise

import numpy as np
import pytest

from saddlering_ros.identification.methods import minimise
from saddlering_ros.identification.settings import IdentificationError, StopReason, SwarmSettings

LOW = np.array([-4.0, -4.0])
HIGH = np.array([4.0, 6.0])


def bowl(points):
    return np.sum((points - np.array([1.0, 2.0])) ** 2, axis=1)


def test_it_finds_the_bottom_of_a_bowl():
    result = minimise(bowl, LOW, HIGH, seed=3)
    assert result.position == pytest.approx([1.0, 2.0], abs=1e-3)
    assert result.iterations == 50


def test_the_same_seed_gives_the_same_run_and_another_seed_another():
    first, again, other = (minimise(bowl, LOW, HIGH, seed=seed) for seed in (7, 7, 8))
    assert np.array_equal(first.history, again.history)
    assert not np.array_equal(first.history, other.history)


def test_the_defaults_are_the_papers():
    settings = SwarmSettings()
    assert (settings.particles, settings.iterations) == (20, 50)
    assert (settings.cognitive, settings.social) == (1.2, 1.7)
    assert settings.inertia(0) == pytest.approx(0.9)
    assert settings.inertia(49) == pytest.approx(0.4)


def test_no_particle_leaves_the_box_nor_moves_faster_than_v_max():
    settings = SwarmSettings(velocity_limit=0.1)
    seen = []
    minimise(lambda points: (seen.append(points), -points.sum(axis=1))[1],  # best outside the box
             LOW, HIGH, settings, seed=1)
    for before, after in pairwise(seen):
        assert np.all((after >= LOW) & (after <= HIGH))
        assert np.all(np.abs(after - before) <= 0.1 * (HIGH - LOW) + 1e-12)


def test_the_minimum_may_lie_on_a_bound():
    result = minimise(lambda points: points.sum(axis=1), LOW, HIGH, seed=2)
    assert np.array_equal(result.position, LOW)


def test_best_objective_never_rises():
    history = minimise(bowl, LOW, HIGH, seed=4).history
    assert np.all(np.diff(history) <= 0.0)


@pytest.mark.parametrize(
    ('settings', 'reason'),
    [
        (SwarmSettings(accuracy=0.05), StopReason.ACCURACY),
        (SwarmSettings(stagnation=3, stagnation_tolerance=0.9), StopReason.STAGNATION),
        (SwarmSettings(), StopReason.ITERATIONS)])
def test_it_says_why_it_stopped(settings, reason):
    result = minimise(bowl, LOW, HIGH, settings, seed=5)
    assert result.stopped is reason
    assert (result.iterations < 50) == (reason is not StopReason.ITERATIONS)


def test_cancelling_stops_before_the_next_iteration():
    seen = []
    result = minimise(
        bowl, LOW, HIGH, seed=6, on_iteration=seen.append, is_cancelled=lambda: len(seen) >= 4)
    assert result.stopped is StopReason.CANCELLED
    assert result.iterations == 4
    assert result.objective == seen[-1].best_objective


def test_progress_tells_iteration_best_spread_and_time():
    seen = []
    minimise(bowl, LOW, HIGH, seed=6, on_iteration=seen.append)
    assert [progress.iteration for progress in seen] == list(range(1, 51))
    assert seen[-1].spread < seen[0].spread


def test_infinite_objectives_are_only_bad_places():
    def walled(points):
        return np.where(points[:, 0] < 0.0, np.inf, bowl(points))

    assert minimise(walled, LOW, HIGH, seed=1).objective < 1e-4


@pytest.mark.parametrize(
    'wrong',
    [{'particles': 1}, {'iterations': 0}, {'cognitive': -1.0}, {'social': np.nan},
     {'velocity_limit': 0.0}])
def test_settings_that_make_no_swarm_are_refused(wrong):
    with pytest.raises(IdentificationError):
        SwarmSettings(**wrong)
