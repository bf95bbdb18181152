"""A verdict's JSON and curves small enough to see, for claims about reports."""

import math
from pathlib import Path

import numpy as np

from saddlering_ros.record.record import Record
from saddlering_ros.report.figures import RunCurves
from saddlering_ros.rig import CHANNELS, TONNE

NOISE = 2e-7


def channel(before, after):
    return {'nrmse_before': before, 'nrmse_after': after, 'noise_floor': 2e-3}


def document(verdict='named', **changes):
    """A verdict on one static run at 50 deg and one held out at 70."""
    cause = {
        'effect': 'radial_friction', 'group': ['radial_friction'],
        'parameters': {'force': {'value': 9e3, 'std': 35.0, 'unit': 'N'}},
        'evidence': {'p_value': 1e-20, 'delta_bic': 4e5},
        'gain': {'fit': 0.93, 'held_out': 0.94}, 'share_of_range': 0.06}
    runs = [
        {'bag': f'/bags/static_{degrees}', 'elevation_deg': float(degrees), 'test': 'static',
         'held_out': degrees == 70,
         'channels': {name: channel(0.06, 0.002) for name in CHANNELS}}
        for degrees in (50, 70)]
    values = {'K1': 1.3e8, 'n1': 1.11, 'D1': 3e6, 'K2': 1.3e8, 'n2': 1.11, 'D2': 3e6}
    after = {**values, **{f'{name}_std': 0.01 * value for name, value in values.items()}}
    shapes = [{'channel': 'delta_x', 'coordinate': 'direction', 'p_value': 1e-9,
               'share_of_range': 0.05}]
    return {
        'verdict': verdict, 'causes': [] if verdict == 'none' else [cause], 'runs': runs,
        'parameters': {'before': {**values, 'K2': 1e9}, 'after': after}, 'next_test': None,
        'gain': {'fit': 0.93, 'held_out': 0.94, 'how': 'held out'},
        'candidates': [{'step': 1, 'effects': ['radial_friction'], 'p_value': 1e-20,
                        'share_of_range': 0.06, 'delta_bic': 4e5, 'misfit': 1.0,
                        'parameters': {'radial_friction': {'force': 9e3}}}],
        'shapes': {'before': shapes, 'after': [{**shapes[0], 'p_value': 1.0}]},
        'signature_cosines': {'radial_friction': {'settling': 0.8},
                              'settling': {'radial_friction': 0.8}, 'load_gain': {}},
        'detection_limits': [{'effect': 'radial_friction', 'limit': 100.0, 'best_limit': 80.0,
                              'material_limit': 50.0, 'places': [],
                              'unit': 'N', 'share': 0.6, 'testable': True}],
        'immaterial': [], 'notes': ['one run only'], 'seed': 0, 'seconds': 1.0, **changes}


def run_curves(test='static', degrees=50.0, *, held_out=False):
    """A run that is straight but for a loop in delta_x, which the extended model has."""
    share = np.concatenate([np.linspace(0.0, 1.0, 40), np.linspace(1.0, 0.0, 40)])
    direction = np.where(np.arange(80) < 40, 1.0, -1.0)
    plain = np.stack([1e-4 * share, 2e-5 * share, 2e-4 * share, 0.0 * share])
    loop = np.zeros_like(plain)
    loop[0] = -5e-6 * direction
    noise = np.random.default_rng(1).normal(0.0, NOISE, plain.shape)
    time = np.arange(80.0) * (5.0 if test == 'static' else 0.1)
    return RunCurves(
        name=f'{test}_{degrees:g}', test=test, elevation_deg=degrees, held_out=held_out,
        time=time, width=np.full(80, 0.1), load=25 * TONNE * share, direction=direction,
        measured=plain + loop + noise, before=plain, after=plain + loop,
        noise=dict.fromkeys(CHANNELS, NOISE))


def record(**changes):
    """A static test at 50 deg whose stamps have one gap of 3 s."""
    time = np.arange(200.0) * 0.01 + np.where(np.arange(200) < 100, 0.0, 2.99)
    return Record(**{
        'name': 'static_50', 'path': Path('static_50'), 'test': 'static',
        'elevation': math.radians(50.0), 'rig': 'SR-017', 'run': 'third',
        'stamps': np.round(1e9 * time).astype(np.int64), 'time': time,
        'load': 0.5 * TONNE + 10.0 * np.arange(200.0),
        'gaps': np.full((4, 200), 1e-3) + 1e-8 * np.arange(200.0), 'notes': ['a note'], **changes})
