"""The solver divides its steps where a small damping or a jump of the load asks for it."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.rig import default_rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.ring.sensitivity import FollowedMotion
from saddlering_ros.ring.simulator import dynamic_batch

RIG = default_rig()
ELEVATION = 0.9
TIME = np.arange(120) * 1e-3
JUMP = np.where(TIME < 0.02, 5.0, 15.0) * TONNE


def law(damping: float) -> np.ndarray:
    return replace(TRUE_TO_SCALE, D1=damping, D2=damping).to_array()


@pytest.mark.parametrize('damping', [1e3, 3e3, 1e4, 3e4, 1e5, 1e6, 1e7])
def test_a_jump_of_the_load_is_within_one_percent_of_a_solution_at_ten_microseconds(damping):
    fine = np.arange((len(TIME) - 1) * 100 + 1) * 1e-5
    truth = dynamic_batch(RIG, law(damping), ELEVATION, fine, np.interp(fine, TIME, JUMP), 1e-5)
    truth = truth[0][:, ::100]
    found = dynamic_batch(RIG, law(damping), ELEVATION, TIME, JUMP)[0]
    moved = np.abs(truth - truth[:, :1]).max(axis=1)
    assert (np.abs(found - truth).max(axis=1) < 0.01 * moved).all()


@pytest.mark.parametrize('damping', [1e5, 3e6])
def test_the_noise_of_a_load_cell_divides_no_step_at_a_usual_damping(damping):
    noisy = 5.0 * TONNE + np.random.default_rng(0).normal(0.0, 50.0, len(TIME))
    path = FollowedMotion(RIG, law(damping), ELEVATION, TIME, noisy).path
    assert len(path.time) == len(TIME)
