"""Claims about the sensitivity of the ring to small errors of its load."""

import numpy as np
import pytest

from saddlering_ros.rig import ContactParameters, default_rig, FULL_SCALE_LOAD
from saddlering_ros.ring.sensitivity import load_sensitivity
from saddlering_ros.ring.simulator import dynamic_batch, static_response

RIG = default_rig()
NODES, STEPS, STEP = 100, 5, 4e-3
TIME = STEP * np.arange(NODES * STEPS)
NODE_TIME = TIME.reshape(NODES, STEPS).mean(axis=1)
LAWS = {
    'little damping': ContactParameters(9e7, 1.15, 2e4, 8e8, 1.05, 4e4),
    'much damping': ContactParameters(9e7, 1.15, 1e7, 8e7, 1.3, 1e7)}


def block_means(motion: np.ndarray) -> np.ndarray:
    return motion.reshape(3, NODES, STEPS).mean(axis=-1)


@pytest.mark.parametrize('law', LAWS.values(), ids=LAWS)
def test_sensitivity_is_what_a_small_error_of_the_load_does(law: ContactParameters) -> None:
    load = np.interp(TIME, [0.0, 0.3, 1.1, 1.9], [RIG.preload, RIG.preload, 0.5 * FULL_SCALE_LOAD,
                                                  RIG.preload])
    errors = np.random.default_rng(0).normal(0.0, 1.0, NODES)
    moved, still = (
        dynamic_batch(RIG, law.to_array()[None], 0.9, TIME, own, STEP)[0]
        for own in (load + np.interp(TIME, NODE_TIME, errors), load))
    expected = load_sensitivity(RIG, law, 0.9, TIME, load, NODES) @ errors
    for row, seen in zip(expected, block_means(moved - still), strict=True):
        assert np.std(row - seen) < 0.1 * np.std(seen)


def test_a_lasting_error_at_rest_has_the_static_slope() -> None:
    law, load = LAWS['little damping'], 0.4 * FULL_SCALE_LOAD
    sensitivity = load_sensitivity(RIG, law, 0.9, TIME, np.full(TIME.size, load), NODES)
    below, above = static_response(RIG, law.to_array(), 0.9, [load - 10.0, load + 10.0]).T
    slope = (above - below) / 20.0
    assert sensitivity.sum(axis=2) == pytest.approx(np.repeat(slope[:, None], NODES, 1), rel=1e-3)


def test_no_error_acts_before_it_happens() -> None:
    load = np.full(TIME.size, 0.4 * FULL_SCALE_LOAD)
    sensitivity = load_sensitivity(RIG, LAWS['much damping'], 0.9, TIME, load, NODES)
    late = np.triu_indices(NODES, 2)
    assert np.all(sensitivity[:, late[0], late[1]] == 0.0)
    assert np.all(sensitivity[0].diagonal() > 0.0)
