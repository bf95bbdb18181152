"""Johansson's quadruple tank; records by pcgym's four_tank under scipy's LSODA."""

from __future__ import annotations

import importlib.util
from pathlib import Path
import sys
from types import ModuleType

import numba as nb
import numpy as np
from scipy.integrate import solve_ivp

from machines.machine import Array, Draw, Machine, noisy, steps
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, SUBSTEPS = 10.0, 2
COUNT = 500
FALL = (2.0 * 9.81) ** 0.5
SPLIT = 0.2
TRUE = {'outlet1': 35.0, 'outlet2': 30.0, 'pump1': 0.85, 'pump2': 0.95}
"""Areas of outlets [cm^2] and flow of pumps [l / s V]."""
UPPER = (20.0e-4, 25.0e-4)


def process_models() -> ModuleType:
    """pcgym.model_classes, with numpy in place of jax (not used by its numpy branch)."""
    found = importlib.util.find_spec('pcgym')
    if found is None or found.origin is None:
        raise ImportError('pcgym is not installed')
    sys.modules.setdefault('jax', ModuleType('jax'))
    sys.modules.setdefault('jax.numpy', np)
    path = Path(found.origin).parent / 'model_classes.py'
    spec = importlib.util.spec_from_file_location('pcgym_models', path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


LINES = process_models()


@nb.njit(cache=True)
def fill(pumps, start, law):  # type: ignore[no-untyped-def]
    """Levels of the two lower tanks (2, N) by midpoint steps; every tank has 1 m^2."""
    outlet1, outlet2, pump1, pump2, leak, curve, split = law
    level, rate, old = start.copy(), np.zeros(4), np.zeros(4)
    seen = np.empty((2, pumps.shape[1]))
    dt = STEP / SUBSTEPS
    for n in range(pumps.shape[1]):
        seen[0, n], seen[1, n] = level[0], level[1]
        one = pump1 * pumps[0, n] * (1.0 + curve * pumps[0, n])
        two = pump2 * pumps[1, n]
        for _ in range(SUBSTEPS):
            old[:] = level
            for share in (0.5, 1.0):
                root = FALL * np.sqrt(np.maximum(level, 0.0))
                rate[0] = UPPER[0] * root[2] + SPLIT * one - outlet1 * root[0]
                rate[1] = UPPER[1] * root[3] + (SPLIT + split) * two - outlet2 * root[1]
                rate[2] = (1.0 - SPLIT - split) * two - (UPPER[0] + leak) * root[2]
                rate[3] = (1.0 - SPLIT) * one - UPPER[1] * root[3]
                level[:] = old + share * dt * rate
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([1e-4 * p['outlet1'], 1e-4 * p['outlet2'], 1e-3 * p['pump1'],
                    1e-3 * p['pump2'], 1e-4 * p['leak.area'], p['curve.size'], p['split.share']])
    pumps = np.array([run.inputs['pump1'], run.inputs['pump2']], dtype=np.float64)
    one, two = fill(pumps, np.asarray(run.inputs['start']), law)
    return {'tank1': 100.0 * one, 'tank2': 100.0 * two * (1.0 + p['gauge.gain'])}


MODEL = Model(
    simulate,
    base={'outlet1': Parameter(20, 60, unit='cm^2'), 'outlet2': Parameter(20, 60, unit='cm^2'),
          'pump1': Parameter(0.4, 1.6, unit='l/s V'), 'pump2': Parameter(0.4, 1.6, unit='l/s V')},
    effects={
        'leak': Effect('Leak of tank 3', {'area': Parameter(0, 10, unit='cm^2')}),
        'curve': Effect('Pump 1 that is not straight', {'size': Parameter(-0.05, 0.05)}),
        'split': Effect('Valve 2 at another share', {'share': Parameter(-0.15, 0.5)}),
        'gauge': Effect('Gain of gauge 2', {'gain': Parameter(-0.3, 0.3)}),
    },
    channels={'tank1': Channel(unit='cm'), 'tank2': Channel(unit='cm')},
)
HIDDEN = {'leak': {'area': 1.0}, 'curve': {'size': -0.006}, 'split': {'share': 0.05},
          'gauge': {'gain': 0.05}}


def record(draw: Draw) -> Run:
    true, random = draw.true, draw.random
    pumps = np.array([steps(random, COUNT, 3.0, 12.0, 40) for _ in range(2)])
    tanks = LINES.four_tank(
        int_method='numpy', k1=1e-3 * true['pump1'], k2=1e-3 * true['pump2'],
        a1=1e-4 * true['outlet1'], a2=1e-4 * true['outlet2'], gamma_1=SPLIT,
        gamma_2=SPLIT + draw.size('split.share'))
    leak, curve = draw.size('leak.area') * 1e-4, draw.size('curve.size')
    level = start = random.uniform(0.3, 0.6, 4)
    seen = np.empty((2, COUNT))
    for n in range(COUNT):
        seen[:, n] = level[:2]
        drive = np.array([pumps[0, n] * (1.0 + curve * pumps[0, n]), pumps[1, n]])

        def change(_: float, now: Array, drive: Array = drive) -> Array:
            rate = np.array(tanks(np.maximum(now, 0.0), drive))
            rate[2] -= leak * FALL * np.sqrt(max(now[2], 0.0))
            return rate

        level = solve_ivp(change, (0.0, STEP), level, 'LSODA', rtol=1e-8, atol=1e-9).y[:, -1]
    time = STEP * np.arange(COUNT)
    gauge = 1.0 + draw.size('gauge.gain')
    return draw.run(time, {'pump1': pumps[0], 'pump2': pumps[1], 'start': start},
                    {'tank1': noisy(random, 100.0 * seen[0]),
                    'tank2': noisy(random, 100.0 * gauge * seen[1])})


MACHINE = Machine('four_tank', 'pcgym 0.1.8, four_tank (Johansson, IEEE Trans. Control Systems '
                  'Technology 8 (2000) 456)', 'MIT', MODEL, HIDDEN, record, TRUE)
