"""A damping that the smallest step cannot follow is named."""

from dataclasses import replace

from saddlering_ros.rig import TRUE_TO_SCALE
from saddlering_ros.ring.accuracy import accuracy_notes


def test_a_damping_at_the_lower_bound_has_a_note_and_a_usual_one_has_none():
    assert accuracy_notes(TRUE_TO_SCALE) == []
    assert accuracy_notes(replace(TRUE_TO_SCALE, D1=1e5)) == []
    (note,) = accuracy_notes(replace(TRUE_TO_SCALE, D1=1e4))
    assert note.startswith('D1 is 1e+04 N s/m')
    assert 'up to 3 % of the motion' in note
