"""Test runs made by the simulator plus noise, small enough for tests, with a known truth."""

from pathlib import Path

import numpy as np

from saddlering_ros.identification.observation import observe_prepared, observe_with_cell
from saddlering_ros.identification.prepared import prepare
from saddlering_ros.record.record import Record
from saddlering_ros.rig import ContactParameters, default_rig, ParameterSet, TONNE, TRUE_TO_SCALE
from saddlering_ros.rig.geometry import displacement_to_probes
from saddlering_ros.ring.simulator import simulate

RIG = default_rig()
GAP_AT_ZERO = 1e-3
DEGREES = np.pi / 180.0


def staircase(top=25, hold=3.0, ramp=0.5, rate=100.0, first=None):
    """Time [s] and load [N] of a static test: preload, up to `top` t and back in steps of 1 t."""
    first = RIG.preload if first is None else first
    levels = [first, *(TONNE * step for step in range(1, top + 1))]
    levels += levels[-2::-1]
    corners, loads = [0.0], [levels[0]]
    for number, level in enumerate(levels):
        if number:
            corners.append(corners[-1] + ramp)
            loads.append(level)
        corners.append(corners[-1] + hold)
        loads.append(level)
    return sampled(corners, loads, rate)


def ramp(top=25.0, seconds=8.0, hold=1.0, rate=500.0):
    """Time [s] and load [N] of a dynamic test: hold, up and down within `seconds`, hold."""
    corners = [0.0, hold, hold + seconds / 2, hold + seconds, 2 * hold + seconds]
    loads = [RIG.preload, RIG.preload, top * TONNE, RIG.preload, RIG.preload]
    return sampled(corners, loads, rate)


def sampled(corners, loads, rate):
    time = np.arange(0.0, corners[-1], 1.0 / rate)
    return time, np.interp(time, corners, loads)


def correlated(random, std, memory, shape):
    """AR(1) noise with standard deviation `std` along the last axis."""
    from scipy.signal import lfilter

    drive = random.normal(0.0, std * np.sqrt(1.0 - memory**2), (*shape[:-1], shape[-1] + 300))
    return lfilter([1.0], [1.0, -memory], drive, axis=-1)[..., 300:]


def record(test, profile, *, elevation=50.0, contact=TRUE_TO_SCALE, noise=3e-7, load_noise=0.0,
           memory=0.0, seed=0, rig=RIG, name=None, effects=None):
    """A Record of the simulator's own readings with noise [m] on the gaps, [N] on the load."""
    random = np.random.default_rng(seed)
    time, load = profile
    step = 1e-2 if test == 'static' else 1e-3
    parameters = ParameterSet(contact, effects or {})
    run = simulate(rig, parameters, elevation * DEGREES, time, load, step)
    increments = np.zeros((4, len(time)))
    increments[:, run.first :] = displacement_to_probes(rig.probes, run.displacement)
    polarity = np.asarray(rig.probes.polarity)[:, None]
    gaps = GAP_AT_ZERO + polarity * increments
    gaps += correlated(random, noise, memory, increments.shape)
    name = name or f'{test}_{elevation:g}'
    return Record(
        name=name, path=Path(name), test=test, elevation=elevation * DEGREES, rig='test', run='1',
        stamps=(time * 1e9).astype(np.int64), time=time,
        load=load + random.normal(0.0, load_noise, len(time)) if load_noise else load.copy(),
        gaps=gaps, notes=[])


def static_run(elevation=50.0, *, top=25, **options):
    return record('static', staircase(top), elevation=elevation, **options)


def dynamic_run(elevation=50.0, *, seconds=8.0, **options):
    return record('dynamic', ramp(seconds=seconds), elevation=elevation, **options)


def drawn_contact(random, rig=RIG):
    """A contact law drawn over the inner part of the bounds: K, D even in the logarithm."""
    values = {}
    for name, (low, high) in rig.bounds.items():
        share = random.uniform(0.1, 0.9)
        even = low + share * (high - low)
        values[name] = even if name[0] == 'n' else low * (high / low) ** share
    return ContactParameters(**values)


def observe(runs, rig, *, fit_rate, contact=None):
    """Observations of runs, with the noise of the load cell if a contact law is given."""
    prepared = [prepare(run, rig, fit_rate) for run in runs]
    if contact is None:
        return observe_prepared(prepared, fit_rate)
    return observe_with_cell(prepared, rig, fit_rate, contact)
