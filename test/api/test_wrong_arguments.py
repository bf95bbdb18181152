"""A wrong kind of argument is refused in one line that names it, before anything is read."""

import pytest

from saddlering_ros import (
    compare,
    diagnose,
    identify,
    load_rig,
    read_bag,
    read_parameters,
    residual,
    simulate,
    validate,
)
from saddlering_ros.errors import SaddleringError

BAG = 'bags/dynamic_50_fast'


@pytest.mark.parametrize(('call', 'words'), [
    (lambda: read_bag(3), 'path is of type int'),
    (lambda: read_bag([BAG]), 'path is of type list'),
    (lambda: read_bag(BAG, elevation_deg='50'), "elevation_deg is '50'"),
    (lambda: load_rig(3), 'of type int'),
    (lambda: read_parameters(3), 'parameter file is of type int: give a path'),
    (lambda: identify(None), 'bags is None'),
    (lambda: identify([BAG, None]), r'bags\[1\] is None'),
    (lambda: identify({'bag': BAG}), 'bags is of type dict'),
    (lambda: identify([]), 'at least one bag'),
    (lambda: identify(BAG, rig={}), 'rig is of type dict'),
    (lambda: identify(BAG, bounds=[1, 2]), 'bounds is of type list'),
    (lambda: identify(BAG, bounds={'K1': (1, 2, 3)}), 'bounds of K1'),
    (lambda: identify(BAG, bounds={'K9': (1, 2)}), "'K9'"),
    (lambda: identify(BAG, particles='many'), "particles is 'many'"),
    (lambda: identify(BAG, stagnation=-3), 'stagnation is -3'),
    (lambda: identify(BAG, accuracy=float('nan')), 'accuracy is nan'),
    (lambda: identify(BAG, seed=1.5), 'seed is 1.5'),
    (lambda: identify(BAG, seed=-1), 'seed is -1: give a whole number, 0 or above'),
    (lambda: diagnose(BAG, seed=-1), 'seed is -1: give a whole number, 0 or above'),
    (lambda: identify(BAG, on_progress=3), 'on_progress is of type int'),
    (lambda: identify(BAG, settings='paper'), 'settings is of type str: give Identification'),
    (lambda: validate(BAG, parameters=3), 'parameters: int holds none'),
    (lambda: simulate(BAG, parameters=None), 'parameters: NoneType holds none'),
    (lambda: residual(BAG, parameters=None), 'parameters: NoneType holds none'),
    (lambda: diagnose(BAG, hold_out=None), 'hold_out is None'),
    (lambda: diagnose(BAG, is_cancelled=True), 'is_cancelled is of type bool'),
    (lambda: compare(BAG, BAG, between=BAG), 'between is of type str: give a list of sessions'),
    (lambda: compare(BAG, BAG, between=3), 'between is of type int: give a list of sessions'),
    (lambda: compare(BAG, BAG, between=[[3]]), r'between\[0\]\[0\] is of type int')])
def test_an_argument_of_a_wrong_kind_is_refused_in_one_line(call, words):
    with pytest.raises(SaddleringError, match=words) as caught:
        call()
    assert '\n' not in str(caught.value)
