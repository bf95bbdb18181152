"""Claims about the reference against a multibody program with one spring-damper per roller."""

from dataclasses import replace

import numpy as np
import pytest
import readable_ring as reference

from saddlering_ros.rig import default_rig, Rig, TONNE, TRUE_TO_SCALE

pytest.importorskip('exudyn', reason='the multibody program exudyn is not installed '
                                     '(pip install "saddlering_ros[test]")')

from multibody_ring import MultibodyRing

RIG = default_rig()
RAISED = replace(RIG, radial_row=replace(RIG.radial_row, height=0.08))
ELEVATION = np.deg2rad(50.0)


@pytest.mark.parametrize('rig', [RIG, RAISED], ids=['middle row in the mid-plane', 'raised'])
@pytest.mark.parametrize('tonnes', [1.0, 10.0, 25.0])
def test_equilibrium_is_that_of_the_multibody_program(rig: Rig, tonnes: float) -> None:
    load = tonnes * TONNE
    plain = reference.static_equilibrium(rig, TRUE_TO_SCALE, load, ELEVATION)
    other = MultibodyRing(rig, TRUE_TO_SCALE, ELEVATION, lambda _: load,
                          start=(3e-5, -3e-5, 5e-5)).static()
    assert other == pytest.approx(plain, abs=1e-9)


def _pulse(t: np.ndarray | float) -> np.ndarray:
    return 8.0 * TONNE * (1.0 + np.sin(np.pi * np.clip(np.asarray(t) / 0.2, 0.0, 1.0)) ** 2)


@pytest.mark.slow
def test_motion_under_a_load_pulse_is_that_of_the_multibody_program() -> None:
    steps = 160
    time = np.linspace(0.0, 0.2, steps + 1)
    plain = reference.simulate_dynamic(RIG, TRUE_TO_SCALE, ELEVATION, time, _pulse(time))
    other = MultibodyRing(RIG, TRUE_TO_SCALE, ELEVATION, lambda t: float(_pulse(t)),
                          start=plain[:, 0]).dynamic(0.2, steps)
    assert np.ptp(plain, axis=1).min() > 1e-6
    # Two rules of second order, BDF2 here and generalised alpha there, at steps of 1.25 ms.
    assert other == pytest.approx(plain, abs=2e-8)
