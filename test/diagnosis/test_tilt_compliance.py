"""A claim on a compliance of the tilt that a bracket of a probe could be taken for."""

from __future__ import annotations

import pytest

from saddlering_ros.bags import read_run
from saddlering_ros.diagnosis.records import build_record
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import diagnose_system, Problem
from saddlering_ros.rig import default_rig

LIMIT = 2.8e-11
"""Its detection limit [rad/(N m)] in five clean runs of this kind."""


@pytest.mark.slow
def test_a_tilt_compliance_of_several_times_its_limit_is_the_first_of_its_group(campaign) -> None:
    rig = default_rig()
    runs = ('static_50', 'dynamic_50_fast', 'static_70')
    bags = campaign('tilt_compliance', 3.6 * LIMIT, 'compliance', runs, seed=5)
    blocks = [build_record(rig, read_run(bag), held_out=False).run for bag in bags]
    (cause,) = diagnose_system(Problem(RingSystem(rig), blocks)).causes
    assert cause.effect == 'tilt_compliance'
    assert 'probe_bracket' not in cause.group
