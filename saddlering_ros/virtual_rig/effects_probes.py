"""Effects in the measurement: probes, their brackets, amplifiers and clock."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from saddlering_ros.virtual_rig.effects import effect, TrueSize
from saddlering_ros.virtual_rig.effects_ring import Floats, Motion, X_AND_T
from saddlering_ros.virtual_rig.integrator import low_pass

ALL_CHANNELS = ('delta_x', 'delta_y', 'gamma', 'parity')
ONE_PROBE = TrueSize('probe', '1', 1.0, 4.0, 1.0, choices=(1.0, 2.0, 3.0, 4.0))
ANY_PROBE = TrueSize('probe', '1', 0.0, 4.0, 0.0, choices=(0.0, 1.0, 2.0, 3.0, 4.0))


@dataclass
class ProbeMotion:
    """Displacements at the probes."""

    motion: Motion
    increments: Floats  # (4, N) [m] since the start, on the grid of `motion`
    seed: int  # for effects that happen by chance

    def rows(self, values: Mapping[str, float]) -> list[int]:
        """Rows of the probes chosen."""
        probe = int(values['probe'])
        return [0, 1, 2, 3] if probe == 0 else [probe - 1]


@dataclass
class Recording:
    """How the record is taken."""

    clock_offset: float = 0.0  # of the probes' clock [s]
    clock_skew: float = 0.0
    load_limit: float = np.inf  # at which the cell clips [N]
    pickups: list[dict[str, float]] = field(default_factory=list)  # parameters of mains_pickup
    cut_offs: list[dict[str, float]] = field(default_factory=list)  # those of probe_saturation

    def disturb(self, probe: int, time: Floats, increment: Floats) -> Floats:
        """Output of the amplifier of probe 1 to 4 for an increment (N,) [m] at `time` (N,) [s]."""
        for line in self.pickups:
            if line['probe'] in (0.0, probe):
                phase = 2.0 * np.pi * line['frequency'] * time
                increment = (increment + line['cosine'] * np.cos(phase)
                             + line['sine'] * np.sin(phase))
        for cut in self.cut_offs:
            if cut['probe'] == probe:
                side = cut['side']
                increment = side * np.minimum(side * increment, cut['limit'])
        return increment


@effect('ring_ovalisation', 'probes', ('parity',),
        [TrueSize('compliance', 'm/N', 0.5e-11, 8e-11, 3e-11, signed=True)])
def ring_ovalisation(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """The ring goes oval under the radial force: probes 1 and 3 move alike."""
    common = values['compliance'] * (seen.motion.force_x - seen.motion.force_x[0])
    seen.increments[[0, 2]] += common


@effect('probe_height', 'probes', X_AND_T[:1],
        [TrueSize('height', 'm', 0.005, 0.05, 0.02, signed=True)])
def probe_height(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """The radial probes are higher than in the rig file."""
    tilt = values['height'] * (seen.motion.tilt - seen.motion.tilt[0])
    seen.increments[0] += tilt
    seen.increments[2] -= tilt


@effect('probe_bracket', 'probes', ALL_CHANNELS,
        [TrueSize('compliance', 'm/N', 0.5e-11, 6e-11, 2e-11, signed=True), ONE_PROBE])
def probe_bracket(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """The bracket of one probe bends with the load."""
    load = seen.motion.load - seen.motion.load[0]
    seen.increments[seen.rows(values)] += values['compliance'] * load


@effect('probe_gain', 'probes', ALL_CHANNELS,
        [TrueSize('gain', '1', 0.01, 0.1, 0.03, signed=True), ONE_PROBE])
def probe_gain(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """One probe reads too much by a share."""
    seen.increments[seen.rows(values)] *= 1.0 + values['gain']


@effect('probe_nonlinearity', 'probes', ALL_CHANNELS,
        [TrueSize('curvature', '1/m', 50.0, 500.0, 150.0, signed=True), ONE_PROBE])
def probe_nonlinearity(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """One probe's characteristic is bent."""
    rows = seen.rows(values)
    seen.increments[rows] += values['curvature'] * seen.increments[rows] ** 2


@effect('probe_drift', 'probes', ALL_CHANNELS,
        [TrueSize('rate', 'm/s', 0.3e-8, 6e-8, 2e-8, signed=True), ONE_PROBE],
        ('linear', 'fading'))
def probe_drift(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """One probe drifts; fading: the drift dies out over twice the run."""
    time = seen.motion.time
    if form == 'fading':
        life = 2.0 * time[-1]
        time = life * -np.expm1(-time / life)
    seen.increments[seen.rows(values)] += values['rate'] * time


@effect('probe_lag', 'probes', ALL_CHANNELS,
        [TrueSize('time', 's', 0.01, 0.1, 0.03, positive=True), ANY_PROBE],
        ('first_order', 'two_stages'), dynamic_only=True)
def probe_lag(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """The amplifier answers late; two_stages: two low-passes share the time constant."""
    stages = 2 if form == 'two_stages' else 1
    for row in seen.rows(values):
        for _ in range(stages):
            seen.increments[row] = low_pass(seen.increments[row], seen.motion.step,
                                            values['time'] / stages)


@effect('mains_pickup', 'recording', ALL_CHANNELS,
        [TrueSize('cosine', 'm', 0.3e-6, 3e-6, 1e-6, signed=True),
         TrueSize('sine', 'm', 0.0, 1e-6, 0.0, signed=True),
         TrueSize('frequency', 'Hz', 45.0, 65.0, 50.0, positive=True), ANY_PROBE])
def mains_pickup(recording: Recording, values: Mapping[str, float], form: str) -> None:
    """The cables of one or all probes pick up a line."""
    recording.pickups.append(dict(values))


@effect('probe_saturation', 'recording', ALL_CHANNELS,
        [TrueSize('limit', 'm', 30e-6, 90e-6, 60e-6, positive=True), ONE_PROBE,
         TrueSize('side', '1', -1.0, 1.0, 1.0, choices=(1.0, -1.0))])
def probe_saturation(recording: Recording, values: Mapping[str, float], form: str) -> None:
    """One probe's reading, with its noise, is cut off at one side."""
    recording.cut_offs.append(dict(values))


@effect('clock_offset', 'recording', X_AND_T,
        [TrueSize('offset', 's', 0.005, 0.1, 0.02, signed=True),
         TrueSize('skew', '1', 0.0, 1e-4, 0.0, signed=True)], dynamic_only=True)
def clock_offset(recording: Recording, values: Mapping[str, float], form: str) -> None:
    """The probes' clock is ahead of the load's."""
    recording.clock_offset += values['offset']
    recording.clock_skew += values['skew']


@effect('out:probe_crosstalk', 'probes', ALL_CHANNELS,
        [TrueSize('share', '1', 0.01, 0.08, 0.03, signed=True)])
def probe_crosstalk(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """The readings of probes 1 and 2 leak into each other."""
    first, second = seen.increments[0].copy(), seen.increments[1].copy()
    seen.increments[0] += values['share'] * second
    seen.increments[1] += values['share'] * first


@effect('out:bracket_slip', 'probes', ALL_CHANNELS,
        [TrueSize('step', 'm', 0.5e-6, 5e-6, 2e-6), TrueSize('slips', '1', 3.0, 12.0, 6.0),
         ONE_PROBE])
def bracket_slip(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """The bracket of one probe slips now and then, by steps of random height."""
    random = np.random.default_rng([seen.seed, 77])
    time = seen.motion.time
    slips = max(int(values['slips']), 1)
    when = np.sort(random.uniform(0.1, 0.95, slips)) * time[-1]
    height = values['step'] * random.normal(0.0, 1.0, slips)
    walk = np.concatenate([[0.0], np.cumsum(height)])
    seen.increments[seen.rows(values)] += walk[np.searchsorted(when, time)]


@effect('out:load_clipping', 'recording', X_AND_T,
        [TrueSize('limit', 'N', 1.4e5, 2.3e5, 2e5, positive=True)])
def load_clipping(recording: Recording, values: Mapping[str, float], form: str) -> None:
    """The load cell's amplifier clips; the ring feels the full load."""
    recording.load_limit = min(recording.load_limit, values['limit'])


@effect('out:heat_wave', 'probes', ('delta_x', 'parity'),
        [TrueSize('height', 'm', 0.5e-6, 4e-6, 2e-6),
         TrueSize('share', '1', 0.1, 0.4, 0.2, positive=True)])
def heat_wave(seen: ProbeMotion, values: Mapping[str, float], form: str) -> None:
    """A draught: probe 1 swings slowly, by a period that is a share of the run."""
    time = seen.motion.time
    seen.increments[0] += values['height'] * np.sin(
        2.0 * np.pi * time / (values['share'] * time[-1]))
