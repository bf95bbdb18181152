"""Claims about advice with an unknown cause: the rig file is suspected before the hardware."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from saddlering_ros.diagnosis.next_test import next_test
from saddlering_ros.discrepancy.next_test import HeldOutEvidence
from saddlering_ros.rig import default_rig

RIG = default_rig()
SWAP = 'Swap probes 2 and 4'
STILL: Any = SimpleNamespace(visible=0.0)
AFTER = SimpleNamespace(fast=STILL, shapes=[
    SimpleNamespace(view='delta_y', coordinate='load', p_value=0.0, visible=0.01)])


@pytest.mark.parametrize(('verdict', 'rig_hash', 'is_first'), [
    ('unknown', '', True), ('unknown', 'f' * 64, True), ('unknown', RIG.digest, False),
    ('named', '', False), ('none', '', False),
])
def test_the_rig_file_comes_before_the_probes_unless_a_hash_vouches_for_it(
        verdict: str, rig_hash: str, is_first: bool) -> None:
    unseen = SimpleNamespace(limits=[SimpleNamespace(effect='film_creep', testable=False)],
                             labels=(), cosines=())
    cause = SimpleNamespace(effect='radial_friction', group=('radial_friction',))
    found: Any = SimpleNamespace(
        verdict=verdict, causes=[cause], residual_after=AFTER, observability=unseen,
        held_out_evidence=())
    run: Any = SimpleNamespace(rig_hash=rig_hash)
    sentence = next_test(found, [run], RIG)
    assert sentence is not None
    assert (SWAP in sentence) == (verdict == 'unknown')
    assert sentence.startswith('First compare the rig file') == is_first


def test_a_moment_arm_with_five_alternatives_is_told_the_tests_that_need_no_record_first() -> None:
    group = ('moment_arm', 'elevation_error', 'load_gain', 'load_offset', 'rig_trunnion_x',
             'rig_weight_x')
    cause = SimpleNamespace(effect='moment_arm', group=group)
    evidence = [HeldOutEvidence(name, name, ('static_70',), 0.0, float(name == 'moment_arm'),
                                name == 'moment_arm') for name in group]
    found: Any = SimpleNamespace(
        verdict='ambiguous', causes=[cause], held_out_evidence=evidence, separations=())
    sentence = next_test(found, [], RIG)
    assert sentence is not None
    free, drawing, record = (sentence.index(words) for words in (
        'Fit static_70 too: of the alternatives, moment_arm predicts static_70 best',
        'First compare the rig file with the drawing and the ring: ', ' means '))
    assert free < drawing < record
    assert 'rig.trunnion.x, rig.carriage.weight_x' in sentence
