"""Claims about the declarations of extension parameters: what they act on is what they change."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from saddlering_ros.effects import extension as extensions
from saddlering_ros.effects import own_parameters, OwnParameter
from saddlering_ros.effects.extension import Hysteron, MOTION, NO_EXTENSION, READING, ROLLERS
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, TRUE_TO_SCALE
from saddlering_ros.ring.kernels import integration, layout
from saddlering_ros.ring.model import MODEL, model_of, rows_of

RIG = default_rig()
TIME = np.arange(0.0, 0.3, 2e-3)
LOAD = np.interp(TIME, [0.0, 0.15, 0.3], [RIG.preload, FULL_SCALE_LOAD, RIG.preload])
# Every law is in use, so that each parameter can show what it changes.
BUSY = replace(
    NO_EXTENSION, cylinder_friction=Hysteron(500.0, 2000.0), bracket_play=Hysteron(1e-3, 2000.0),
    radial_friction=Hysteron(500.0, 2e-6), axial_friction=Hysteron(300.0, 3e-6),
    tilt_friction=Hysteron(200.0, 3e-6),
    damping_penetration_share=0.5, damping_penetration_exponent=1.5,
    damping_penetration_saturation=2e4, opening_compliance=1e-9, creep_radial=0.1,
    creep_axial=0.1, resonance_frequency=100.0)


def motion(extension: extensions.RingExtension) -> np.ndarray:
    """Motion (N, 3) of the rings against each other, before anything is added to it."""
    constants = model_of(RIG, 0.9, TRUE_TO_SCALE.to_array(), extension)
    state, moved = np.zeros(layout.STATE_SIZE), np.empty((TIME.size, 3))
    rows, uniform = rows_of(RIG, extension).flat, rows_of(RIG, extension).uniform
    integration.start(constants, rows, uniform, state, 0.0, LOAD[0])
    integration.advance(constants, rows, uniform, state, TIME, LOAD, 2e-3, moved,
                        np.empty((TIME.size, 4)))
    return moved


def changed(value: Any) -> Any:
    if isinstance(value, Hysteron):
        return replace(value, limit=1.3 * value.limit)
    if isinstance(value, extensions.RowGeometry):
        return replace(value, gap=5e-6)
    if isinstance(value, tuple):
        return tuple(1.3 * one + 1e-4 for one in value)
    return 1.3 * value + 1e-4


@pytest.fixture(scope='module')
def usual() -> np.ndarray:
    return motion(BUSY)


@pytest.mark.parametrize('item', extensions.shared_parameters(), ids=lambda item: item.name)
def test_a_parameter_moves_the_contacts_if_it_is_declared_to(item, usual) -> None:
    other = motion(replace(BUSY, **{item.name: changed(getattr(BUSY, item.name))}))
    assert np.array_equal(other, usual) == (item.metadata['acts_on'] not in (MOTION, ROLLERS))


def test_what_acts_on_one_stage_is_taken_out_of_an_extension_alone() -> None:
    kept = BUSY.only(MOTION)
    assert kept.radial_friction == BUSY.radial_friction
    assert kept.creep_radial == 0.0
    assert kept.resonance_frequency == 0.0


def test_the_model_has_every_parameter_by_the_name_of_its_declaration() -> None:
    for item in extensions.shared_parameters():
        name = f'{item.name}_stiffness' if item.metadata['acts_on'] == ROLLERS else item.name
        assert name in (MODEL.names or ())


def test_the_shipped_laws_need_no_file_of_an_effect() -> None:
    """Without the file of the ovalisation, the kernels did not compile: KeyError."""
    assert own_parameters() == ()


def test_an_own_parameter_adds_up_and_is_gone_at_nothing() -> None:
    item = OwnParameter('some', 'ring', READING)
    twice = item.add(item.add(NO_EXTENSION, 2.0), 1.0)
    assert item.of(twice) == 3.0
    assert item.add(twice, -3.0) == NO_EXTENSION
    assert twice.only(MOTION) == NO_EXTENSION
