"""Claims about the load cell's noise: it is read from the plateaus, and what it does is known."""

from dataclasses import replace

from identification_records import DEGREES, dynamic_run, observe, RIG, static_run
import numpy as np
import pytest
from scipy.signal import lfilter

from saddlering_ros.estimation.record_noise import common_noise
from saddlering_ros.identification.objective import WeightedObjective
from saddlering_ros.identification.observation import slow_cell_noise
from saddlering_ros.identification.prepared import prepare
from saddlering_ros.rig import ContactParameters

RINGING = ContactParameters(9e7, 1.15, 3e4, 8e8, 1.05, 1e5)
"""A ring of little damping, soft in tilt."""


def wander(random, std, seconds, interval, shape):
    """Slow noise with that standard deviation and time constant along the last axis."""
    memory = np.exp(-interval / seconds)
    drive = random.normal(0.0, std * np.sqrt(1.0 - memory**2), shape)
    drive[..., 0] /= np.sqrt(1.0 - memory**2)
    return lfilter([1.0], [1.0, -memory], drive, axis=-1)


def with_slow_load_noise(run, std, seed):
    interval = float(np.mean(np.diff(run.time)))
    noise = wander(np.random.default_rng(seed), std, 3.0, interval, run.load.shape)
    return replace(run, load=run.load + noise)


@pytest.fixture(scope='module')
def runs():
    """RestSource probes, a noisy load cell."""
    options = {'contact': RINGING, 'noise': 1e-7, 'load_noise': 50.0}
    made = static_run(seed=1, **options), dynamic_run(seed=2, seconds=4.0, **options)
    return [with_slow_load_noise(run, 20.0, seed) for seed, run in enumerate(made)]


@pytest.fixture(scope='module')
def objective(runs):
    observations = observe(runs, RIG, fit_rate=50.0, contact=RINGING)
    return WeightedObjective(RIG, observations, (0, 1, 2))


def test_noise_that_two_series_share_is_read_whatever_each_has_beside():
    random = np.random.default_rng(0)
    shape = (120, 250)
    shared = wander(random, 20.0, 3.0, 0.02, shape) + random.normal(0.0, 50.0, shape)
    drift = np.linspace(0.0, 100.0, shape[1])
    found = common_noise(list(shared + drift), list(shared + random.normal(0.0, 80.0, shape)),
                         [1.0] * len(shared), 0.02)
    assert found.white / 0.02 == pytest.approx(50.0**2, rel=0.05)
    assert np.sqrt(found.slow.sum()) == pytest.approx(20.0, rel=0.35)


def test_series_that_share_nothing_have_no_common_noise():
    first, second = np.random.default_rng(1).normal(0.0, 50.0, (2, 100, 200))
    found = common_noise(list(first), list(second), [1.0] * 100, 0.02)
    assert found.white / 0.02 < 0.02 * 50.0**2
    assert found.slow.sum() < 0.02 * 50.0**2


@pytest.mark.parametrize('std', [0.0, 20.0])
def test_fast_noise_that_a_damped_ring_follows_late_is_no_slow_noise(std):
    # It was read as 14 N of slow noise, and D1 was 1.8 % too large for it. The measured ring
    # does not move with the noise of the cell, and the simulated one follows within 0.1 s.
    damped = ContactParameters(1.1e8, 1.1, 2.5e6, 1.5e8, 1.12, 3.5e6)
    run = static_run(0.0, contact=damped, noise=1e-7, load_noise=40.0, seed=5)
    run = with_slow_load_noise(run, std, 7)
    explained = prepare(run, RIG, 50.0).explained_by(RIG, damped)
    slow = slow_cell_noise(RIG, damped, [explained]).slow.sum()
    assert np.sqrt(slow) == pytest.approx(std, rel=0.35, abs=5.0)


def test_a_noisy_load_is_no_misfit_of_the_truth(objective):
    aware = objective.mean_squares(RINGING.to_array())
    unaware = WeightedObjective(
        RIG, [replace(one, load_errors=None) for one in objective.observations], (0, 1, 2)
    ).mean_squares(RINGING.to_array())
    assert aware == pytest.approx([1.0, 1.0], abs=0.4)
    assert unaware[0] > 3.0
    assert unaware[1] > 1.2 * aware[1]


def test_a_corrected_load_lies_nearer_the_true_one(runs, objective):
    still = dynamic_run(contact=RINGING, noise=0.0, seconds=4.0)
    true = observe([runs[0], still], RIG, fit_rate=50.0)[1].load
    before = objective.observations[1]
    after = objective.with_likely_loads(RINGING.to_array()).observations[1]
    loaded = true > 1.5 * RIG.preload
    error, left = ((one.load - true)[loaded] for one in (before, after))
    assert np.sqrt(np.mean(left**2)) < 0.85 * np.sqrt(np.mean(error**2))


def test_residuals_stay_as_they_were_when_a_load_is_corrected(objective):
    before = objective.residuals(RINGING.to_array()[None])[0]
    after = objective.with_likely_loads(RINGING.to_array()).residuals(RINGING.to_array()[None])[0]
    assert np.std(after - before) < 0.1 * np.std(before)


def test_the_zeros_load_moves_all_increments_together(objective):
    static = objective.observations[0]
    zero = static.load_errors.answers[-1]
    assert np.ptp(zero, axis=1) == pytest.approx(0.0, abs=1e-15)
    assert np.all(zero[[0, 2]] < 0.0)
    assert static.elevation == pytest.approx(50.0 * DEGREES)
