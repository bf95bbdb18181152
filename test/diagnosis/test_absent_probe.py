"""A diagnosis without one radial probe: three readings, no parity, and a note."""

from dataclasses import replace

from few_effects import few_effects
import numpy as np

from saddlering_ros.bags.reader import read_run
from saddlering_ros.diagnosis import diagnose_ring
from saddlering_ros.diagnosis.records import build_record
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Point
from saddlering_ros.identification.validation import judge, validate
from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE

RIG = default_rig()
LESS = replace(RIG, probes=replace(RIG.probes, absent=3))


def test_the_model_of_three_probes_is_that_of_four_without_the_third(campaign):
    bag, = campaign(runs=('static_50',))
    whole, less = RingSystem(RIG), RingSystem(LESS)
    four = build_record(RIG, read_run(bag, rig=RIG), held_out=False).run
    three = build_record(LESS, read_run(bag, rig=LESS), held_out=False).run
    point = Point(TRUE_TO_SCALE.to_array(), {'tilt_compliance': {'compliance': 1e-10}})
    rows = [0, 1, 3]
    np.testing.assert_array_equal(three.channels, four.channels[rows])
    np.testing.assert_array_equal(less.predict_many(three, [point])[0],
                                  whole.predict_many(four, [point])[0][rows])
    groups = [[point, Point(1.001 * point.base, point.effects)]]
    ours, = less.neighbourhood(groups)(three)
    theirs, = whole.neighbourhood(groups)(four)
    np.testing.assert_array_equal(ours, theirs[:, rows])
    motion = np.array([3e-5, 1e-5, -3e-5, 2e-5])
    for view, weights in less.views.items():
        assert np.isclose(weights @ motion[rows], whole.views[view] @ motion, rtol=1e-12)
    assert 'parity' not in less.views


def test_an_effect_is_named_without_probe_3_and_no_figure_of_the_parity_is_given(campaign):
    bags = campaign('moment_arm', 0.06, 'offset', runs=('static_50', 'static_70'))
    with few_effects('moment_arm', 'elevation_error', 'load_gain', 'load_offset', 'probe_gain',
                     'tilt_compliance', 'probe_bracket'):
        found = diagnose_ring([read_run(bag, rig=LESS) for bag in bags], rig=LESS)
    document = found.to_json()
    (first, *others), = [cause['group'] for cause in document['causes']]
    assert first == 'moment_arm'
    # A pitch radius that is 21 mm wrong in the rig file leaves 7 % of what the arm explains.
    assert others in ([], ['rig_axial_radius'])
    assert all(set(run['channels']) == {'delta_x', 'delta_y', 'gamma'}
               for run in document['runs'])
    assert any('probe 3 is absent' in note for note in document['notes'])
    assert np.isnan(found.runs[0].measured[3]).all()


def test_a_validation_without_probe_3_judges_three_channels_and_says_why(campaign):
    bag, = campaign(runs=('dynamic_50',))
    found = validate([read_run(bag, rig=LESS)], LESS, ParameterSet(TRUE_TO_SCALE))
    assert set(found.runs[0].channels) == {'delta_x', 'delta_y', 'gamma'}
    assert 'parity' not in [criterion.id for criterion in judge(found.runs)]
    assert any('probe 3 is absent' in note for note in found.runs[0].notes)
