"""Faults for the ring simulator of benchmarks/independent_ring.py, in forms of its own.

`fault_of` draws a fault that has a name in the catalogue; `OUTSIDE` holds laws that have none.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import math

from independent_ring import Adding, Array, Fault, low_pass, Motion, Sliders
import numpy as np

from saddlering_ros.rig import default_rig

RIG = default_rig()
FULL = RIG.full_scale_load
ARM = RIG.trunnion.y
COLUMN = {'delta_x': 0, 'delta_y': 1, 'gamma': 2}


@dataclass(frozen=True)
class Hidden:
    """A fault, its name in the catalogue and its size in the catalogue's parameters."""

    effect: str
    parameters: Mapping[str, float]
    fault: Fault

    def to_json(self) -> dict[str, object]:
        """As the truths of the blind trials."""
        return {'effect': self.effect, 'parameters': dict(self.parameters)}


def _column(channel: str, values: Array) -> Array:
    out = np.zeros((values.size, 3))
    out[:, COLUMN[channel]] = values
    return out


def _probe(number: int, values: Array) -> Array:
    out = np.zeros((values.size, 4))
    out[:, number - 1] = values
    return out


def slider_state(load: Array, travel: float) -> Array:
    """A smooth memory of direction in -1 to 1: ten stops of spread travel over the load."""
    widths = travel * np.linspace(0.3, 1.7, 10)
    state = np.zeros(10)
    out = np.zeros(load.size)
    for i in range(1, load.size):
        state = np.clip(state + (load[i] - load[i - 1]) / widths, -1.0, 1.0)
        out[i] = state.mean()
    return out


def cosine_arc(centre: float, half: float, depth: float) -> Callable[[Array], Array]:
    """Extra gap of rollers on an arc: one half of a cosine wave."""
    def gap(phi: Array) -> Array:
        off = np.abs((phi - centre + np.pi) % (2.0 * np.pi) - np.pi)
        return np.where(off < half, depth * np.cos(0.5 * np.pi * off / half), 0.0)
    return gap


def _soft_over(value: Array, start: float, width: float) -> Array:
    """A ramp from `start` with a hyperbolic corner."""
    return np.asarray(0.5 * (value - start + np.hypot(value - start, width)))


def _ringing(time: Array, signal: Array, hertz: float, ratio: float) -> Array:
    """The response of a second mode to a signal, by an exact step for a straight input."""
    h = time[1] - time[0]
    w = 2.0 * math.pi * hertz
    parts = max(1, math.ceil(h * hertz * 30))
    own, speed = float(signal[0]), 0.0
    out = signal.copy()
    for i in range(1, time.size):
        for k in range(parts):
            u = signal[i - 1] + (signal[i] - signal[i - 1]) * (k + 0.5) / parts
            step = h / parts
            speed += step * (w * w * (u - own) - 2.0 * ratio * w * speed)
            own += step * speed
        out[i] = own
    return out


def _creep(share: float, scale: float) -> Adding:
    def adding(motion: Motion) -> Array:
        out = np.zeros_like(motion.motion)
        for constant, weight in ((0.6, 0.2), (1.0, 0.6), (1.6, 0.2)):
            for c in range(3):
                out[:, c] += weight * share * low_pass(motion.time, motion.motion[:, c],
                                                       scale * constant)
        return out
    return adding


def fault_of(effect: str, draw: np.random.Generator, share: float = 1.0) -> Hidden:
    """A fault of this name, of random form and of this share of a random size."""
    up = share * float(draw.uniform(0.6, 1.6))
    side = float(draw.choice([-1.0, 1.0]))
    probe = int(draw.integers(1, 5))
    size: dict[str, float]
    if effect == 'load_offset':
        size = {'offset': side * 2.5e3 * up}
        fault = Fault(ring_load=lambda t, p: p - size['offset'])
    elif effect == 'load_nonlinearity':
        size = {'curvature': side * 0.012 * up}
        fault = Fault(ring_load=lambda t, p: p + size['curvature'] * FULL
                      * np.sin(np.pi * p / FULL))
    elif effect == 'cylinder_friction':
        size = {'force': 3e3 * up}
        fault = Fault(ring_load=lambda t, p: p - size['force'] * slider_state(p, 2.5e3))
    elif effect == 'elevation_error':
        size = {'angle': side * 0.02 * up}
        fault = Fault(turn=lambda t, p: np.full(p.size, size['angle']))
    elif effect == 'bracket_play':
        size = {'angle': 0.006 * up}
        fault = Fault(turn=lambda t, p: size['angle'] * slider_state(p, 3e3))
    elif effect == 'moment_arm':
        size = {'offset': side * 0.04 * up}
        fault = Fault(arm=size['offset'])
    elif effect == 'radial_friction':
        size = {'force': 4e3 * up}
        fault = Fault(friction_x=Sliders(size['force'], 2e-6))
    elif effect == 'tilt_friction':
        size = {'moment': 6e3 * up}
        fault = Fault(friction_tilt=Sliders(size['moment'], 3e-6))
    elif effect in ('radial_clearance', 'axial_clearance'):
        size = {'change': (30e-6 if side > 0 else -15e-6) * up}
        pair = (0.0, size['change']) if effect.startswith('radial') else (size['change'], 0.0)
        fault = Fault(clearance=pair)
    elif effect == 'tilt_compliance':
        size = {'compliance': 1.2e-10 * up}
        fault = Fault(series=(lambda m: _column(
            'gamma', size['compliance'] * m.forces[:, 2]
            * (1.0 - 0.04 * m.forces[:, 2] / (FULL * ARM))),))
    elif effect == 'axial_compliance':
        size = {'compliance': 7e-11 * up}
        fault = Fault(series=(lambda m: _column('delta_y', size['compliance'] * m.forces[:, 1]),))
    elif effect == 'bolt_opening':
        size = {'compliance': 2.5e-10 * up, 'moment': float(draw.uniform(0.6e5, 1.2e5))}
        fault = Fault(series=(lambda m: _column('gamma', size['compliance'] * _soft_over(
            m.forces[:, 2], size['moment'], 6e3)),))
    elif effect == 'ring_ovalisation':
        size = {'compliance': side * 3e-11 * up}
        fault = Fault(readings=(lambda m: np.outer(
            m.forces[:, 0] * (1.0 + 0.03 * m.forces[:, 0] / FULL), [1, 0, 1, 0])
            * size['compliance'],))
    elif effect == 'unequal_rows':
        size = {'excess': side * 0.3 * up}
        fault = Fault(lower_row=1.0 + size['excess'])
    elif effect in ('worn_sector_axial', 'worn_sector_radial'):
        size = {'wear': 0.3 * up, 'half_width': float(draw.uniform(0.4, 0.9)),
                'centre': float(draw.uniform(0.0, 0.8))}
        gap = cosine_arc(size['centre'], size['half_width'], 1e-4 * size['wear'])
        fault = Fault(gap_axial=gap) if effect.endswith('axial') else Fault(gap_radial=gap)
    elif effect == 'out_of_round':
        size = {'amplitude': side * 9e-6 * up, 'angle': float(draw.uniform(0.0, 0.5))}
        fault = Fault(gap_radial=lambda phi: size['amplitude'] * (
            np.cos(2 * (phi - size['angle'])) + 0.08 * np.cos(3 * phi)))
    elif effect == 'axial_flatness':
        size = {'amplitude': side * 8e-6 * up, 'angle': float(draw.uniform(0.0, math.pi / 4)),
                'rows': float(draw.integers(4))}
        more = 0.3 * draw.standard_normal(3) * (2.0 / np.arange(3, 6)) ** 2
        phases = draw.uniform(0.0, 2.0 * np.pi, 3)

        def bent(phi: Array) -> Array:
            return size['amplitude'] * (np.cos(2 * (phi - size['angle'])) + more @ np.cos(
                np.arange(3, 6)[:, None] * phi + phases[:, None]))

        share_lower = {0.0: 0.0, 1.0: -2.0, 2.0: -1.0, 3.0: 1.0}[size['rows']]
        fault = Fault(gap_axial=bent if size['rows'] < 3.0 else None,
                      gap_lower=lambda phi: share_lower * bent(phi))
    elif effect == 'film_creep':
        size = {'share': 0.05 * up, 'time': float(draw.uniform(4.0, 20.0))}
        fault = Fault(series=(_creep(size['share'], size['time']),))
    elif effect == 'settling':
        size = {'settling': 4e-11 * up}
        channel = str(draw.choice(['delta_x', 'delta_y']))
        fault = Fault(series=(lambda m: _column(channel, size['settling'] * FULL * (
            np.maximum.accumulate(m.load) / FULL) ** 1.15),))
    elif effect == 'damping_law':
        size = {'share': 1.0}
        fault = Fault(damping_exponent=float(draw.uniform(0.6, 1.3)))
    elif effect == 'carriage_resonance':
        hertz, share = float(draw.uniform(5.0, 12.0)), 0.7 * up
        size = {'share': share, 'period': 1.0 / hertz}
        fault = Fault(series=(lambda m: share * np.stack([
            _ringing(m.time, m.motion[:, c], hertz, 0.06) - m.motion[:, c] for c in range(3)],
            axis=1) if m.time[1] - m.time[0] < 0.01 else 0.0 * m.motion,))
    elif effect == 'probe_height':
        size = {'height': side * 0.03 * up}
        fault = Fault(readings=(lambda m: np.outer(m.motion[:, 2], [1, 0, -1, 0])
                                * size['height'],))
    elif effect == 'probe_bracket':
        size = {'compliance': side * 2.5e-11 * up, 'probe': probe}
        fault = Fault(readings=(lambda m: _probe(
            probe, size['compliance'] * m.load * (1.0 + 0.02 * m.load / FULL)),))
    elif effect == 'probe_gain':
        size = {'gain': side * 0.03 * up, 'probe': probe}
        fault = Fault(readings=(lambda m: _probe(probe, size['gain'] * m.d[:, probe - 1]),))
    elif effect == 'probe_nonlinearity':
        size = {'curvature': side * 200.0 * up, 'probe': probe}
        fault = Fault(readings=(lambda m: _probe(probe, size['curvature'] * m.d[:, probe - 1] ** 2
                                                 * (1.0 - 300.0 * np.abs(m.d[:, probe - 1]))),))
    elif effect == 'probe_drift':
        size = {'rate': side * 2.5e-8 * up, 'probe': probe}
        fault = Fault(readings=(lambda m: _probe(probe, size['rate'] * 3000.0 * (
            1.0 - np.exp(-m.time / 3000.0))),))
    elif effect == 'probe_lag':
        size = {'time': 0.03 * up, 'probe': probe}
        fault = Fault(lag=tuple(size['time'] if i == probe - 1 else 0.0 for i in range(4)))
    elif effect == 'clock_offset':
        size = {'offset': 0.02 * up}
        fault = Fault(late=(size['offset'],) * 4)
    elif effect == 'mains_pickup':
        size = {'cosine': 4e-7 * up, 'sine': 0.0, 'frequency': 50.0, 'probe': probe}
        fault = Fault(readings=(lambda m: _probe(probe, size['cosine'] * (
            np.cos(2 * np.pi * 50.0 * m.time) + 0.15 * np.sin(2 * np.pi * 150.0 * m.time))),))
    elif effect == 'probe_saturation':
        probe = int(draw.choice([1, 2, 3]))
        size = {'limit': float(draw.uniform(0.4, 0.75)), 'probe': probe}

        def clipped(m: Motion) -> Array:
            d = m.d[:, probe - 1]
            high = size['limit'] * 1.0e-4
            return _probe(probe, -np.sign(d) * _soft_over(np.abs(d), high, 4e-7))

        fault = Fault(readings=(clipped,))
    else:
        raise ValueError(f'{effect}: no form of this effect here')
    return Hidden(effect, size, fault)


EFFECTS = (
    'load_offset', 'load_nonlinearity', 'cylinder_friction', 'elevation_error', 'bracket_play',
    'moment_arm', 'radial_friction', 'tilt_friction', 'radial_clearance', 'axial_clearance',
    'tilt_compliance', 'axial_compliance', 'bolt_opening', 'ring_ovalisation', 'unequal_rows',
    'worn_sector_axial', 'worn_sector_radial', 'out_of_round', 'film_creep', 'settling',
    'damping_law', 'carriage_resonance', 'probe_height', 'probe_bracket', 'probe_gain',
    'probe_nonlinearity', 'probe_drift', 'probe_lag', 'clock_offset', 'mains_pickup',
    'probe_saturation', 'axial_flatness')


# -- laws outside the catalogue ----------------------------------------------------------------


@dataclass(frozen=True)
class Outside:
    """A law that the catalogue does not have: where it acts and on what it depends.

    channels and coordinates: every answer that counts as right.
    """

    name: str
    channels: tuple[str, ...]
    coordinates: tuple[str, ...]
    fault: Callable[[np.random.Generator], Fault] = field(repr=False)


def _on(channel: str, law: Callable[[Motion], Array]) -> Fault:
    return Fault(series=(lambda m: _column(channel, law(m)),))


def _rate(motion: Motion, constant: float = 0.1) -> Array:
    return low_pass(motion.time, np.gradient(motion.load, motion.time), constant)


def _bump(draw: np.random.Generator) -> Fault:
    at, width = draw.uniform(0.35, 0.65) * FULL, draw.uniform(0.06, 0.1) * FULL
    return _on('delta_x', lambda m: 6e-6 * np.exp(-((m.load - at) / width) ** 2))


def _hill(draw: np.random.Generator) -> Fault:
    at = draw.uniform(0.3, 0.5) * FULL
    return _on('gamma', lambda m: 9e-6 * np.tanh((m.load - at) / (0.05 * FULL))
               * (1.0 - m.load / FULL))


def _chirp(draw: np.random.Generator) -> Fault:
    waves = draw.uniform(3.0, 5.0)
    return _on('delta_y', lambda m: 2.5e-6 * np.sin(2 * np.pi * waves * (m.load / FULL) ** 1.5))


def _ratchet(draw: np.random.Generator) -> Fault:
    spacing = draw.uniform(0.17, 0.26) * FULL
    return Fault(readings=(lambda m: _probe(2, 4e-6 * (
        np.arctan(1.6 * np.sin(2 * np.pi * m.load / spacing)))),))


def _wedge(draw: np.random.Generator) -> Fault:
    at = draw.uniform(0.3, 0.5) * FULL
    return Fault(readings=(lambda m: np.outer(
        5e-6 * np.maximum(0.0, (m.load - at) / FULL) ** 1.6, [1, 0, 1, 0]),))


def _lobes(draw: np.random.Generator) -> Fault:
    spacing = draw.uniform(0.3, 0.45) * FULL
    return Fault(ring_load=lambda t, p: p + 3.5e3 * np.sin(2 * np.pi * p / spacing) ** 3)


def _sided(draw: np.random.Generator) -> Fault:
    part = draw.uniform(0.25, 0.6)
    return _on('delta_y', lambda m: 3e-6 * slider_state(m.load, 2e3)
               * np.exp(-((m.load / FULL - part) / 0.2) ** 2))


def _root_rate(draw: np.random.Generator) -> Fault:
    size = draw.uniform(4e-6, 6e-6)
    return _on('delta_x', lambda m: size * np.sign(_rate(m))
               * np.sqrt(np.abs(_rate(m)) / (0.8 * FULL)))


def _warming(draw: np.random.Generator) -> Fault:
    lasting = draw.uniform(30.0, 60.0)
    return _on('delta_y', lambda m: -5e-6 * m.time / (m.time + lasting))


def _breathing(draw: np.random.Generator) -> Fault:
    lasting = draw.uniform(15.0, 25.0)
    return _on('delta_x', lambda m: 3e-6 * (m.time / lasting) ** 2
               * np.exp(-m.time / lasting) * 1.8)


def _fractional(draw: np.random.Generator) -> Fault:
    """Creep with relaxation times over two decades, as a power law of time has them."""
    def law(m: Motion) -> Array:
        total = np.zeros(m.load.size)
        for constant in np.geomspace(0.3, 30.0, 7):
            total += low_pass(m.time, m.load, float(constant)) / 7.0
        return 8e-6 * (m.load - total) / FULL * side
    side = float(draw.choice([-1.0, 1.0]))
    return _on('gamma', law)


def _bouc(draw: np.random.Generator) -> Fault:
    """Bouc-Wen memory over the load, n = 1.6, wider than any friction of the cylinder."""
    width = draw.uniform(3.5e4, 6e4)

    def law(m: Motion) -> Array:
        z = np.zeros(m.load.size)
        for i in range(1, z.size):
            dp = (m.load[i] - m.load[i - 1]) / width
            for _ in range(4):
                z[i] = z[i - 1] if _ == 0 else z[i]
                z[i] += 0.25 * (dp - abs(z[i]) ** 1.6 * (0.7 * abs(dp) * np.sign(z[i])
                                                         + 0.3 * dp))
        return 3e-6 * z
    return _on('delta_x', law)


OUTSIDE: tuple[Outside, ...] = (
    Outside('bump of delta_x over load', ('delta_x',), ('load',), _bump),
    Outside('hill of gamma over load', ('gamma',), ('load',), _hill),
    Outside('waves of delta_y that get shorter', ('delta_y',), ('load',), _chirp),
    Outside('ratchet of probe 2', ('eddy_current_2',), ('load',), _ratchet),
    Outside('probes 1 and 3 lifted by a wedge', ('parity',), ('load',), _wedge),
    Outside('lobes of the load at the ring', ('hydraulic_load',), ('load',), _lobes),
    Outside('delta_y by direction, at some loads', ('delta_y',), ('direction', 'hysteresis'),
            _sided),
    Outside('root of the rate in delta_x', ('delta_x',), ('rate',), _root_rate),
    Outside('delta_y that warms', ('delta_y',), ('time',), _warming),
    Outside('delta_x that swells and returns', ('delta_x',), ('time',), _breathing),
    Outside('fractional creep of gamma', ('gamma',), ('relaxation', 'rate'), _fractional),
    Outside('Bouc-Wen memory of delta_x', ('delta_x',), ('hysteresis', 'direction'), _bouc),
)
