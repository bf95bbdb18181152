"""Plateaus are found from the load alone, and their readings carry honest errors."""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from saddlering_ros.comparison.wear import AXIAL, standard_errors
from saddlering_ros.errors import BagError
from saddlering_ros.record.plateaus import find_holds, plateau_means, plateaus
from saddlering_ros.rig import TONNE


def staircase(*, step=1.0, top=25.0, preload=0.5, cycles=1) -> list[float]:
    """Levels [t] of a static test, up and down, from and to the preload."""
    first = np.floor(preload / step + 1e-9) * step + step
    up = [preload, *np.arange(first, top + 1e-9, step)]
    once = up + up[-2::-1]
    return once + once[1:] * (cycles - 1)


def static_run(levels, *, hold=5.0, ramp=1.0, rate=20.0, lag=0.3, noise=120.0, correlation=0.0,
               seed=0):
    """A held staircase as a rig drives it: `lag` [s] to settle, white and slow noise."""
    random = np.random.default_rng(seed)
    times, targets = [0.0], [levels[0]]
    for number, (level, following) in enumerate(pairwise(levels)):
        end = (number + 1) * (hold + ramp)
        times += [end - ramp, end]
        targets += [level, following]
    times.append(times[-1] + hold)
    targets.append(levels[-1])
    time = np.arange(0.0, times[-1], 1.0 / rate)
    wanted = np.interp(time, times, targets) * TONNE
    load = first_order(wanted, lag, rate)
    probe_noise = 3e-7 * random.normal(size=(4, len(time)))
    if correlation:
        keep = np.exp(-1.0 / rate / correlation)
        for index in range(1, len(time)):
            probe_noise[:, index] *= np.sqrt(1.0 - keep ** 2)
            probe_noise[:, index] += keep * probe_noise[:, index - 1]
    true = np.stack([1e-3 + 4e-10 * load] * 4)
    return SimpleNamespace(
        path=Path('a_run'), time=time, load=load + noise * random.normal(size=len(time)),
        gaps=true + probe_noise, true=true)


def first_order(wanted, lag, rate):
    answer = wanted.copy()
    share = 1.0 - np.exp(-1.0 / rate / lag)
    for index in range(1, len(answer)):
        answer[index] = answer[index - 1] + share * (wanted[index] - answer[index - 1])
    return answer


@pytest.mark.parametrize(('way', 'form'), [
    *((way, {}) for way in (
        {}, {'rate': 1000.0}, {'rate': 5.0}, {'hold': 2.0, 'ramp': 0.3},
        {'hold': 20.0, 'rate': 10.0}, {'hold': 1.2, 'ramp': 0.3, 'rate': 100.0, 'lag': 0.05},
        {'ramp': 3.0}, {'noise': 0.0}, {'noise': 500.0},
        {'ramp': 0.02, 'lag': 0.01, 'rate': 200.0})),
    *(({}, form) for form in (
        {'step': 0.5}, {'step': 5.0}, {'top': 5.0}, {'preload': 0.0},
        {'preload': 1.0, 'step': 2.0}, {'cycles': 3, 'step': 2.5}))], ids=str)
def test_every_level_is_found_however_the_test_was_driven_and_whatever_the_steps(way, form):
    levels = staircase(**form)
    found = plateaus(static_run(levels, **way))
    np.testing.assert_allclose(found.load / TONNE, levels, atol=0.02 if form else 0.05)


def test_two_holds_at_the_top_are_both_its_turning_point():
    found = plateaus(static_run([0.5, 5.0, 10.0, 10.8, 5.0, 0.5]))
    assert found.level.tolist() == [0, 1, 2, 2, 1, 0]
    assert found.branch.tolist() == [0, 1, 0, 0, -1, -1]


def test_branches_and_levels_tell_the_way_up_from_the_way_down():
    levels = staircase()
    found = plateaus(static_run(levels))
    top = len(levels) // 2
    assert found.branch[0] == found.branch[top] == 0
    assert (found.branch[1:top] == 1).all()
    assert (found.branch[top + 1:] == -1).all()
    np.testing.assert_array_equal(found.level, found.level[::-1])
    assert found.level[top] == top


def test_each_cycle_turns_at_its_top_and_its_bottom():
    found = plateaus(static_run(staircase(cycles=3, step=5.0)))
    assert (found.branch == 0).sum() == 1 + 3 + 2


def test_the_settling_part_is_left_out():
    run = static_run(staircase(), lag=0.5, noise=0.0)
    found = plateaus(run)
    assert (found.start > found.hold_start).all()
    settled = np.array(staircase()) * TONNE
    assert np.abs(found.load - settled).max() < 0.01 * TONNE
    whole = plateau_means(found.hold_start, found.hold_stop, run.load)
    assert np.abs(whole - settled).max() > np.abs(found.load - settled).max()


@pytest.mark.parametrize('correlation', [0.0, 0.05, 0.2])
def test_standard_errors_are_those_that_repeated_tests_show(correlation):
    levels = staircase(step=2.5)
    scores = []
    for seed in range(12):
        run = static_run(levels, rate=50.0, correlation=correlation, seed=seed)
        found = plateaus(run)
        true = plateau_means(found.start, found.stop, run.true)
        scores.append((found.gaps - true)[AXIAL] / standard_errors(run, found))
    spread = np.sqrt(np.mean(np.square(scores)))
    assert 0.85 < spread < 1.2


def test_a_short_disturbance_does_not_split_a_plateau():
    levels = staircase(step=5.0)
    run = static_run(levels, rate=100.0)
    struck = (run.time > 20.0) & (run.time < 20.2)
    run.load[struck] += 0.4 * TONNE
    assert len(plateaus(run)) == len(levels)


def test_a_silent_probe_has_no_reading_and_the_others_keep_theirs():
    run = static_run(staircase(step=5.0))
    run.gaps[2, run.time < 12.0] = np.nan
    found = plateaus(run)
    assert np.isnan(found.gaps[2, :2]).all()
    assert np.isfinite(found.gaps[[0, 1, 3]]).all()
    assert np.isfinite(found.gaps[2, 3:]).all()


def test_time_is_that_of_the_part_averaged():
    run = static_run(staircase(step=5.0))
    found = plateaus(run)
    assert (found.time > run.time[found.start]).all()
    assert (found.time < run.time[found.stop - 1]).all()


def test_a_dynamic_run_has_no_plateaus():
    time = np.arange(0.0, 10.0, 1e-3)
    load = (0.5 + 24.5 * np.clip(1.0 - np.abs(time - 5.0) / 3.5, 0.0, 1.0)) * TONNE
    run = SimpleNamespace(path=Path('ramp'), time=time, load=load, gaps=np.ones((4, len(time))))
    with pytest.raises(BagError, match='too few for a static test'):
        plateaus(run)


def test_a_slow_logger_makes_no_holds_of_a_ramp():
    time = np.arange(0.0, 10.0, 0.05)
    load = 12.5 - 12.0 * np.cos(0.2 * np.pi * time)
    assert sum(time[stop - 1] - time[start] for start, stop in find_holds(time, load)) < 3.0


def test_a_load_that_never_moves_has_no_plateaus():
    assert find_holds(np.arange(100.0), np.full(100, 5.0)) == []
