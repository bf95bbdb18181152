"""Claims about the numbers of this moment: units, margins, and what is old is marked."""

import math

import pytest

from saddlering_ros.live import traces
from saddlering_ros.live.traces import Gauges
from saddlering_ros.rig import TONNE


@pytest.mark.parametrize(('gap', 'margin', 'level'), [
    (0.4e-3, 0.4, 'ok'), (1e-3, 1.0, 'ok'), (1.9e-3, 0.1, 'warning'), (2e-3, 0.0, 'error'),
    (2.1e-3, -0.1, 'error')])
def test_a_gap_is_shown_in_millimetres_with_its_margin_to_the_nearer_end(gap, margin, level):
    found = Gauges()
    found.push('probe_2', gap, 0.0, 2e-3)
    probes = found.as_page()['probes']
    assert probes[1] == {'gap': pytest.approx(1e3 * gap), 'low': 0.0, 'high': 2.0,
                         'margin': pytest.approx(margin), 'level': level, 'is_old': False}
    assert probes[0] is None


def test_load_and_elevation_are_in_the_units_of_the_rig_room():
    found = Gauges()
    found.push('load', 12.5 * TONNE)
    assert found.as_page(50.0)['load'] == {'t': 12.5, 'kN': 122.58, 'is_old': False}
    assert found.as_page(50.0)['elevation'] == {
        'deg': 50.0, 'is_measured': False, 'is_old': False}
    found.push('elevation', math.radians(49.7))
    assert found.as_page(50.0)['elevation'] == {'deg': 49.7, 'is_measured': True, 'is_old': False}


def test_a_reading_that_is_old_stays_and_is_marked_as_the_last_one(monkeypatch):
    found = Gauges()
    found.push('load', TONNE)
    monkeypatch.setattr(traces, 'FRESH', -1.0)
    assert found.as_page()['load'] == {'t': 1.0, 'kN': 9.81, 'is_old': True}


def test_a_probe_that_the_rig_does_not_have_is_absent():
    assert Gauges().as_page(absent=3)['probes'] == [None, None, {'is_absent': True}, None]


@pytest.mark.parametrize('value', [math.nan, math.inf])
def test_a_reading_that_is_no_number_is_shown_as_none(value):
    """It was NaN in the JSON of the page, whose numbers all stood still from there on."""
    found = Gauges()
    for name in ('load', 'elevation', 'probe_1'):
        found.push(name, value)
    assert found.as_page() == {'load': None, 'elevation': None, 'probes': [None] * 4}
