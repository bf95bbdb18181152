"""Each effect of the virtual rig shows in the channels that the catalogue says and in no other."""

import re

import numpy as np
import pytest

from saddlering_ros.effects import catalogue
from saddlering_ros.errors import VirtualRigError
from saddlering_ros.virtual_rig.effects import EFFECTS, parse_requests

SHOWS, HIDDEN = 1e-8, 3e-9

CASES = [(name, form) for name, effect in sorted(EFFECTS.items()) for form in effect.forms
         if name != 'mains_pickup']
RADIAL_PROBE = {'probe_bracket', 'probe_drift', 'probe_gain', 'probe_nonlinearity',
                'probe_saturation', 'out:bracket_slip'}
"""Effects that sit on probe 1 unless told otherwise."""


def expected_channels(name):
    if name in RADIAL_PROBE:
        return {'delta_x', 'parity'}
    if name == 'settling':  # of gamma, unless told otherwise
        return {'gamma'}
    shown = set(EFFECTS[name].channels)  # a lag of all probes at once cancels in parity
    return shown - {'parity'} if name == 'probe_lag' else shown


@pytest.mark.parametrize(('name', 'form'), CASES)
def test_an_effect_shows_in_its_channels_only(name, form, ideal_record, channels):
    plain, changed = ideal_record(), ideal_record(name, form)
    before, after = channels(plain, plain), channels(changed, plain)
    difference = {key: np.sqrt(np.mean((after[key] - before[key]) ** 2)) for key in before}
    if name == 'out:load_clipping':  # the ring does not know; only the load's reading does
        assert max(difference.values()) < HIDDEN
        assert changed.load.max() < plain.load.max() - 1e3
        return
    shows = {key for key, size in difference.items() if size > SHOWS}
    hidden = {key for key, size in difference.items() if size < HIDDEN}
    assert shows == expected_channels(name)
    assert hidden == set(before) - shows


def test_a_line_is_picked_up_where_each_sample_is_taken(ideal_record):
    plain, changed = ideal_record(), ideal_record('mains_pickup')
    for probe in range(4):
        seconds = (changed.probe_stamps[probe] % (3600 * 10**9)) * 1e-9
        seconds -= np.floor(seconds[0])
        line = 1e-6 * np.cos(2.0 * np.pi * 50.0 * seconds)
        assert np.allclose(changed.gaps[probe] - plain.gaps[probe], line, atol=1e-9)


@pytest.mark.parametrize('name', ['radial_friction', 'tilt_friction', 'cylinder_friction'])
def test_friction_opens_a_loop_that_no_hold_closes(name, ideal_record, channels):
    plain, changed = ideal_record(test='static'), ideal_record(name, test='static')
    before, after = channels(plain, plain), channels(changed, plain)
    middle = len(before['gamma']) // 2
    channel = 'gamma' if name == 'tilt_friction' else 'delta_x'
    loop = (after[channel] - before[channel])[60:-60]
    up, down = loop[: middle - 100].min(), loop[middle + 40:].max()
    assert up < -3e-7
    assert down > 3e-7


@pytest.mark.parametrize('name', [name for name, effect in sorted(EFFECTS.items())
                                  if effect.dynamic_only and name != 'clock_offset'])
def test_what_only_motion_shows_is_gone_at_the_end_of_a_hold(name, ideal_record, channels):
    plain, changed = ideal_record(test='static'), ideal_record(name, test='static')
    before, after = channels(plain, plain), channels(changed, plain)
    held = slice(-60, None)
    for key in before:
        assert np.max(np.abs(after[key][held] - before[key][held])) < 2e-8


def test_every_effect_of_the_catalogue_can_be_hidden():
    assert set(catalogue()) <= set(EFFECTS)


def test_typical_sizes_lie_within_the_plausible_ones():
    for effect in EFFECTS.values():
        for parameter in effect.parameters:
            assert parameter.low <= parameter.typical <= parameter.high, (effect.id, parameter)


def test_a_request_takes_main_parameter_named_parameter_and_form():
    found, = parse_requests(['radial_friction=6e3', 'radial_friction.presliding=3e-6'],
                            ['radial_friction=lugre'])
    assert (found.values['force'], found.values['presliding']) == (6e3, 3e-6)
    assert found.form == 'lugre'


@pytest.mark.parametrize(('texts', 'forms', 'said'), [
    (['radial_frction=1'], [], 'did you mean radial_friction'),
    (['nothing=1'], [], 'worn_sector_radial'),
    (['film_creep.tau=1'], [], 'share, time, rows'),
    (['film_creep=much'], [], 'NAME=NUMBER'),
    (['film_creep.time=-1'], [], 'above zero'),
    (['radial_friction=-5'], [], 'from zero up'),
    (['film_creep=nan'], [], 'finite'),
    (['probe_gain.probe=5'], [], '1, 2, 3, 4'),
    (['film_creep=0.1'], ['film_creep=square'], 'one_time, two_times'),
    (['film_creep=0.1'], ['settling=late'], 'given by|one of the effects')])
def test_a_request_that_makes_no_sense_is_answered_in_one_line(texts, forms, said):
    with pytest.raises(VirtualRigError) as caught:
        parse_requests(texts, forms)
    assert re.search(said, str(caught.value))
    assert '\n' not in str(caught.value)
