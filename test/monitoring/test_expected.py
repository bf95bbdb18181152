"""Claims about the motion expected at a load and about the noise read at a zero."""

import numpy as np
import pytest

from saddlering_ros.monitoring.expected import (
    ExpectedMotion,
    NO_COVARIANCE,
    NO_ZERO,
    OUTSIDE,
    WITHOUT_EFFECTS,
)
from saddlering_ros.record.displacement import ZeroNoise
from saddlering_ros.rig import default_rig, ParameterSet, ParameterSource, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import static_response

RIG, ELEVATION = default_rig(), np.radians(50.0)
LOAD, ZERO = 1.6e5, RIG.preload + 1e4
SHARES = np.array([0.02, 0.003, 0.2, 0.02, 0.003, 0.2])


def settled(values: np.ndarray, load: float) -> np.ndarray:
    motion = static_response(RIG, values, ELEVATION, np.array([ZERO, load]))
    return motion[:, 1] - motion[:, 0]


@pytest.fixture(name='model', scope='module')
def model_fixture() -> ExpectedMotion:
    deviations = SHARES * TRUE_TO_SCALE.to_array()
    source = ParameterSource('swarm', ('a',), covariance=np.diag(deviations**2))
    return ExpectedMotion(RIG, ParameterSet(TRUE_TO_SCALE, source=source), ELEVATION)


def test_the_motion_is_the_equilibrium_from_the_zero(model: ExpectedMotion) -> None:
    expected = model.at(LOAD, ZERO)
    truth = settled(TRUE_TO_SCALE.to_array(), LOAD)
    assert expected.motion == pytest.approx(truth, rel=2e-3, abs=2e-8)
    assert expected.validity == 0


def test_the_derivative_predicts_the_motion_at_another_load(model: ExpectedMotion) -> None:
    here, there = model.at(LOAD, ZERO), model.at(LOAD + 5e3, ZERO)
    assert here.motion + 5e3 * here.by_load == pytest.approx(there.motion, rel=0.02, abs=2e-8)


def test_the_covariance_is_that_of_drawn_parameters(model: ExpectedMotion) -> None:
    chance, values = np.random.default_rng(1), TRUE_TO_SCALE.to_array()
    drawn = np.array([settled(values * (1.0 + SHARES * chance.standard_normal(6)), LOAD)
                      for _ in range(400)])
    found = np.sqrt(np.diag(model.at(LOAD, ZERO).covariance))
    assert found == pytest.approx(drawn.std(axis=0), rel=0.15)  # 400 draws: 3.5 %


def test_what_does_not_hold_is_stated(model: ExpectedMotion) -> None:
    assert model.at(2.0 * RIG.full_scale_load, None).validity == OUTSIDE | NO_ZERO
    assert model.at(RIG.preload - 60.0, ZERO).validity == 0, 'noise at preload'
    bare = ParameterSet(TRUE_TO_SCALE, {'radial_friction': {'force': 1e3}})
    expected = ExpectedMotion(RIG, bare, ELEVATION).at(LOAD, ZERO)
    assert expected.validity == NO_COVARIANCE | WITHOUT_EFFECTS
    assert not expected.covariance.any()


def test_the_noise_after_a_zero_is_read_though_the_ring_moves() -> None:
    chance, noise = np.random.default_rng(1), ZeroNoise()
    deviations = np.array([2e-7, 3e-7, 4e-7, 1e-7])
    moving = 1e-5 * np.sin(np.arange(250) / 200.0)
    rows = moving + deviations[:, None] * chance.standard_normal((4, 250))
    rows[3] = np.nan  # a rig without parity
    for part in range(0, 250, 10):
        noise.push(np.full(10, 7), rows[:, part:part + 10])
    found = np.sqrt(np.diag(noise.covariance))
    assert found[:3] == pytest.approx(deviations[:3], rel=0.15)
    assert not noise.covariance[3].any()
    noise.push(np.full(50, 8), 3.0 * rows[:, :50])
    assert np.sqrt(noise.covariance[0, 0]) > 1.5 * found[0], 'a new zero, read anew'
