"""Effects in the load path and in the ring: rollers, friction, joints that give or creep."""

from collections.abc import Mapping
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import Rig
from saddlering_ros.rig.geometry import size_factor
from saddlering_ros.virtual_rig import integrator as at
from saddlering_ros.virtual_rig.effects import effect, TrueSize
from saddlering_ros.virtual_rig.integrator import hysteresis, LAWS, low_pass, Rollers, second_mode

Floats = NDArray[np.float64]

INITIAL = TrueSize('initial', '1', -0.3, 0.3, 0.0)
RATE_FREE = ('jenkins', 'dahl', 'bouc_wen')
X_AND_T = ('delta_x', 'delta_y', 'gamma')


@dataclass
class LoadPath:
    """The load on its way, (N,) each; effects change the last three."""

    rig: Rig
    time: Floats  # [s]
    measured: Floats  # of an exact cell [N]
    arriving: Floats  # at the ring [N]
    elevation: Floats  # [rad], as it really is
    trunnion_y: Floats  # [m], as it really is


@effect('load_gain', 'load', X_AND_T, [TrueSize('gain', '1', 0.01, 0.08, 0.03, signed=True)])
def load_gain(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The cell reads too much by a share."""
    path.arriving /= 1.0 + values['gain']


@effect('load_offset', 'load', X_AND_T,
        [TrueSize('offset', 'N', 500.0, 4000.0, 2000.0, signed=True)])
def load_offset(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The cell reads too much by a constant."""
    path.arriving -= values['offset']


@effect('load_nonlinearity', 'load', X_AND_T,
        [TrueSize('curvature', '1', 0.003, 0.03, 0.01, signed=True)])
def load_nonlinearity(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The cell's characteristic is a parabola."""
    full = path.rig.full_scale_load
    path.arriving += 4.0 * values['curvature'] * path.measured * (1.0 - path.measured / full)


@effect('cylinder_friction', 'load', X_AND_T,
        [TrueSize('force', 'N', 500.0, 8000.0, 3000.0),
         TrueSize('presliding', 'N', 1000.0, 8000.0, 3000.0, positive=True), INITIAL], RATE_FREE)
def cylinder_friction(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """Seal friction takes a part of the load on the way up and adds it on the way down."""
    z = hysteresis(LAWS[form], path.measured, values['presliding'], values['initial'])
    path.arriving -= values['force'] * z


@effect('elevation_error', 'load', X_AND_T,
        [TrueSize('angle', 'rad', 0.005, 0.04, 0.0175, signed=True)])
def elevation_error(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The barrel has another elevation than recorded."""
    path.elevation += values['angle']


@effect('moment_arm', 'load', ('delta_y', 'gamma'),
        [TrueSize('offset', 'm', 0.01, 0.08, 0.03, signed=True)])
def moment_arm(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The trunnion lies higher than in the rig file."""
    path.trunnion_y += values['offset']


@effect('bracket_play', 'load', X_AND_T,
        [TrueSize('angle', 'rad', 0.001, 0.015, 0.005),
         TrueSize('presliding', 'N', 1000.0, 8000.0, 3000.0, positive=True), INITIAL], RATE_FREE)
def bracket_play(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The bracket tips over its play when the load turns round."""
    z = hysteresis(LAWS[form], path.measured, values['presliding'], values['initial'])
    path.elevation += values['angle'] * z


@effect('out:load_cell_lens', 'load', X_AND_T, [TrueSize('share', '1', 0.005, 0.03, 0.015)])
def load_cell_lens(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """Hysteresis of the cell's body: a lens that closes at both ends of the range."""
    full = path.rig.full_scale_load
    z = hysteresis(LAWS['dahl'], path.measured, 0.1 * full, 1.0)
    share = np.clip(path.measured / full, 0.0, 1.0)
    path.arriving -= values['share'] * full * z * np.sin(np.pi * share) ** 2


@effect('out:pump_ripple', 'load', X_AND_T,
        [TrueSize('force', 'N', 300.0, 4000.0, 1500.0),
         TrueSize('frequency', 'Hz', 0.7, 6.0, 2.3, positive=True)])
def pump_ripple(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The pump makes the load swing, the more the higher it is; the cell's filter hides it."""
    swing = np.sin(2.0 * np.pi * values['frequency'] * path.time)
    path.arriving += values['force'] * swing * path.measured / path.rig.full_scale_load


@effect('out:valve_stick', 'load', X_AND_T,
        [TrueSize('force', 'N', 500.0, 5000.0, 2500.0),
         TrueSize('spacing', 'N', 2e4, 8e4, 4e4, positive=True)])
def valve_stick(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The load at the ring sticks and slips: a saw over the load."""
    phase = path.measured / values['spacing']
    path.arriving += values['force'] * (phase - np.floor(phase) - 0.5) * np.minimum(phase, 1.0)


T = ('delta_y', 'gamma')
X = ('delta_x',)
SLIDING = ('jenkins', 'dahl', 'lugre', 'bouc_wen')


@dataclass
class FrictionElements:
    """Rows of the friction table (F_... of integrator) and the states z they start from."""

    rows: list[Floats]
    initial: list[float]

    def add(self, direction: tuple[float, float, float], limit: float, presliding: float,
            form: str, initial: float) -> None:
        row = np.zeros(at.FRICTION_COLUMNS)
        row[:3] = direction
        row[at.F_LIMIT], row[at.F_PRESLIDING] = limit, presliding
        row[at.F_LAW] = LAWS[form]
        row[at.F_STRIBECK] = presliding * 20.0
        row[at.F_VISCOUS] = 0.02 * limit / (20.0 * presliding)
        self.rows.append(row)
        self.initial.append(initial)


@dataclass
class Motion:
    """Motion on the grid of the integrator, (N,) each, and the forces that the joints pass on."""

    rig: Rig
    time: Floats  # [s]
    x: Floats  # [m] of the point that the probes see
    y: Floats  # [m]
    tilt: Floats  # [rad]
    force_x: Floats  # [N] in the joints of the ring, dead weight included
    force_y: Floats  # [N]
    moment: Floats  # [N m]
    load: Floats  # [N] at the ring

    @property
    def step(self) -> float:
        return float(self.time[1] - self.time[0])


def _widen(rollers: Rollers, row: str, change: float, form: str) -> None:
    """Half the change at each side; 'spread': rollers differ, from no change to twice the mean."""
    table = rollers.of(row)
    share = np.ones(len(table))
    if form == 'spread':
        share = rollers.random.permutation(np.linspace(0.0, 2.0, len(table)))
    table[:, at.GAP] += 0.5 * change * share


@effect('radial_clearance', 'rollers', X,
        [TrueSize('change', 'm', 5e-6, 30e-6, 15e-6, signed=True)], ('uniform', 'spread'))
def radial_clearance(rollers: Rollers, values: Mapping[str, float], form: str) -> None:
    """The radial row has another clearance than in the rig file."""
    _widen(rollers, 'middle', values['change'], form)


@effect('axial_clearance', 'rollers', T,
        [TrueSize('change', 'm', 5e-6, 30e-6, 15e-6, signed=True)], ('uniform', 'spread'))
def axial_clearance(rollers: Rollers, values: Mapping[str, float], form: str) -> None:
    """The axial rows have another clearance than in the rig file."""
    _widen(rollers, 'upper', values['change'], form)
    _widen(rollers, 'lower', values['change'], form)


@effect('unequal_rows', 'rollers', T, [TrueSize('excess', '1', 0.05, 0.5, 0.2, signed=True)])
def unequal_rows(rollers: Rollers, values: Mapping[str, float], form: str) -> None:
    """The lower row is stiffer than the upper row."""
    rollers.of('lower')[:, at.STIFFNESS] *= 1.0 + values['excess']


WEAR_FORMS = ('hard', 'cosine', 'hard_gap', 'cosine_gap')
WEAR = (TrueSize('wear', '1', 0.1, 0.6, 0.3), TrueSize('centre', 'rad', 0.0, math.pi, 0.5),
        TrueSize('half_width', 'rad', 0.3, 0.9, 0.5, positive=True))
WORN_GAP = 1e-4
"""Extra gap [m] at a wear of 1."""


def _wear(rollers: Rollers, row: str, values: Mapping[str, float], form: str) -> None:
    """Rollers on the arc carry less, or lie lower; hard or cosine-shaped edges."""
    table, angle = rollers.of(row), rollers.angles(row)
    off = np.abs(np.angle(np.exp(1j * (angle - values['centre'])))) / values['half_width']
    if form.startswith('hard'):
        shape = (off <= 1.0).astype(np.float64)
    else:
        shape = np.where(off < 2.0, 0.5 + 0.5 * np.cos(0.5 * np.pi * np.minimum(off, 2.0)), 0.0)
    if form.endswith('gap'):
        table[:, at.GAP] += WORN_GAP * values['wear'] * shape
    else:
        carried = np.maximum(1.0 - values['wear'] * shape, 0.0)
        table[:, at.STIFFNESS] *= carried
        table[:, at.DAMPING] *= carried


@effect('worn_sector_axial', 'rollers', T,
        [*WEAR, TrueSize('row', '1', 0.0, 2.0, 0.0, choices=(0.0, 1.0, 2.0))], WEAR_FORMS)
def worn_sector_axial(rollers: Rollers, values: Mapping[str, float], form: str) -> None:
    """An arc of the axial raceways is worn: row 0 both, 1 upper, 2 lower."""
    for number, row in ((1.0, 'upper'), (2.0, 'lower')):
        if values['row'] in (0.0, number):
            _wear(rollers, row, values, form)


@effect('worn_sector_radial', 'rollers', X, WEAR, WEAR_FORMS)
def worn_sector_radial(rollers: Rollers, values: Mapping[str, float], form: str) -> None:
    """An arc of the radial raceway is worn."""
    _wear(rollers, 'middle', values, form)


@effect('out_of_round', 'rollers', X,
        [TrueSize('amplitude', 'm', 3e-6, 20e-6, 8e-6, signed=True),
         TrueSize('angle', 'rad', 0.0, math.pi / 4, 0.2)])
def out_of_round(rollers: Rollers, values: Mapping[str, float], form: str) -> None:
    """The radial raceway is oval."""
    angle = rollers.angles('middle') - values['angle']
    rollers.of('middle')[:, at.GAP] += values['amplitude'] * np.cos(2.0 * angle)


@effect('axial_flatness', 'rollers', T,
        [TrueSize('amplitude', 'm', 3e-6, 20e-6, 8e-6, signed=True),
         TrueSize('angle', 'rad', 0.0, math.pi / 4, 0.2),
         TrueSize('rows', '1', 0.0, 3.0, 0.0, choices=(0.0, 1.0, 2.0, 3.0))],
        ('saddle', 'three_waves'))
def axial_flatness(rollers: Rollers, values: Mapping[str, float], form: str) -> None:
    """The axial raceways are bent: rows 0 both alike, 1 opposite, 2 upper, 3 lower."""
    for row, bent in (('upper', values['rows'] != 3.0), ('lower', values['rows'] != 2.0)):
        if not bent:
            continue
        angle = rollers.angles(row) - values['angle']
        wave = np.cos(2.0 * angle)
        if form == 'three_waves':
            wave += 0.3 * np.cos(3.0 * angle + 1.0)
        sign = -1.0 if row == 'lower' and values['rows'] == 1.0 else 1.0
        rollers.of(row)[:, at.GAP] += sign * values['amplitude'] * wave


@effect('damping_law', 'rollers', X_AND_T, [TrueSize('share', '1', 0.3, 1.0, 0.7)],
        ('hunt_crossley', 'linear', 'exponent_1_5', 'threshold'), dynamic_only=True)
def damping_law(rollers: Rollers, values: Mapping[str, float], form: str) -> None:
    """Damping grows with penetration: as p^n, p, p^1.5, or sets in above 15 um."""
    table = rollers.table
    table[:, at.DAMPING_SHARE] = values['share']
    power = {'linear': 1.0, 'exponent_1_5': 1.5}
    table[:, at.DAMPING_EXPONENT] = power.get(form, 0.0) or table[:, at.EXPONENT]
    if form == 'threshold':
        table[:, at.DAMPING_THRESHOLD] = 15e-6


@effect('out:softening', 'rollers', X_AND_T,
        [TrueSize('per_metre', '1/m', 1000.0, 8000.0, 4000.0, positive=True)])
def softening(rollers: Rollers, values: Mapping[str, float], form: str) -> None:
    """Rollers soften under load: F = K p^n / (1 + s p)."""
    rollers.table[:, at.SOFTENING] = values['per_metre']


@effect('radial_friction', 'friction', X,
        [TrueSize('force', 'N', 1000.0, 15000.0, 5000.0),
         TrueSize('presliding', 'm', 1e-6, 6e-6, 2e-6, positive=True), INITIAL], SLIDING)
def radial_friction(elements: FrictionElements, values: Mapping[str, float], form: str) -> None:
    """Dry friction against radial motion."""
    elements.add((1.0, 0.0, 0.0), values['force'], values['presliding'], form, values['initial'])


@effect('tilt_friction', 'friction', T,
        [TrueSize('moment', 'N m', 500.0, 10000.0, 3000.0),
         TrueSize('presliding', 'rad', 1e-6, 8e-6, 3e-6, positive=True), INITIAL,
         TrueSize('coordinate', '1', 1.0, 2.0, 2.0, choices=(1.0, 2.0))], SLIDING)
def tilt_friction(elements: FrictionElements, values: Mapping[str, float], form: str) -> None:
    """Dry friction of the axial rows: against tilting (2), or against axial motion (1).

    Of axial motion the moment is that of its force at 1 m.
    """
    against = (0.0, 1.0, 0.0) if values['coordinate'] == 1.0 else (0.0, 0.0, 1.0)
    elements.add(against, values['moment'], values['presliding'], form, values['initial'])


@effect('radial_compliance', 'motion', X, [TrueSize('compliance', 'm/N', 1e-11, 2e-10, 6e-11)])
def radial_compliance(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """The joint gives under the radial force it passes on."""
    motion.x += values['compliance'] * motion.force_x


@effect('axial_compliance', 'motion', ('delta_y',),
        [TrueSize('compliance', 'm/N', 1e-11, 2e-10, 5e-11)])
def axial_compliance(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """The joint gives under the axial force it passes on."""
    motion.y += values['compliance'] * motion.force_y


@effect('tilt_compliance', 'motion', ('gamma',),
        [TrueSize('compliance', 'rad/(N m)', 2e-11, 3e-10, 1e-10)])
def tilt_compliance(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """The joint gives under the moment it passes on."""
    motion.tilt += values['compliance'] * motion.moment


@effect('bolt_opening', 'motion', ('gamma',),
        [TrueSize('compliance', 'rad/(N m)', 5e-11, 5e-10, 2e-10),
         TrueSize('moment', 'N m', 5e4, 1.4e5, 9e4, positive=True)], ('sharp', 'smooth'))
def bolt_opening(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """The bolted joint opens beyond one moment; smooth: bolt after bolt over a tenth of it."""
    beyond = motion.moment - values['moment']
    width = 0.1 * values['moment']
    opened = (np.maximum(beyond, 0.0) if form == 'sharp'
              else width * np.logaddexp(0.0, beyond / width))
    motion.tilt += values['compliance'] * opened


@effect('film_creep', 'motion', X_AND_T,
        [TrueSize('share', '1', 0.02, 0.15, 0.05),
         TrueSize('time', 's', 2.0, 30.0, 8.0, positive=True),
         TrueSize('rows', '1', 0.0, 2.0, 0.0, choices=(0.0, 1.0, 2.0))],
        ('one_time', 'two_times'))
def film_creep(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """The film yields with time: rows 0 all, 1 middle, 2 axial; two_times: T/6 and T share it."""
    parts = [(1.0, values['time'])]
    if form == 'two_times':
        parts = [(0.4, values['time'] / 6.0), (0.6, values['time'])]
    for name in (('x', 'y', 'tilt'), ('x',), ('y', 'tilt'))[int(values['rows'])]:
        motion_of = getattr(motion, name)
        creep = sum(share * low_pass(motion_of, motion.step, time) for share, time in parts)
        setattr(motion, name, motion_of + values['share'] * creep)


@effect('settling', 'motion', X_AND_T,
        [TrueSize('settling', 'm/N', 1e-11, 1e-10, 4e-11, signed=True),
         TrueSize('coordinate', '1', 0.0, 2.0, 2.0, choices=(0.0, 1.0, 2.0))],
        ('max_load', 'late'))
def settling(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """Joints settle for good under the highest load yet; late: only above a fifth of the peak."""
    highest = np.maximum.accumulate(motion.load)
    highest = highest - highest[0]
    if form == 'late':
        highest = 1.25 * np.maximum(highest - 0.2 * highest[-1], 0.0)
    name = ('x', 'y', 'tilt')[int(values['coordinate'])]
    setattr(motion, name, getattr(motion, name) + values['settling'] * highest)


@effect('carriage_resonance', 'motion', X_AND_T,
        [TrueSize('period', 's', 0.05, 0.4, 0.15, positive=True),
         TrueSize('damping', '1', 0.02, 0.2, 0.05, positive=True),
         TrueSize('share', '1', 0.3, 1.0, 1.0, positive=True)], dynamic_only=True)
def carriage_resonance(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """The carriage swings on the ring as a second mode, which has a share of its motion."""
    frequency = 2.0 * math.pi / values['period']
    for name in ('x', 'y', 'tilt'):
        moved = getattr(motion, name)
        swung = second_mode(moved, motion.step, frequency, values['damping'])
        setattr(motion, name, moved + values['share'] * (swung - moved))


@effect('out:tilt_backlash', 'motion', ('gamma',),
        [TrueSize('angle', 'rad', 2e-6, 20e-6, 8e-6),
         TrueSize('load', 'N', 4e4, 1.5e5, 8e4, positive=True)])
def tilt_backlash(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """On unloading, the tilt falls back by a step at one load; it is taken up again on loading."""
    z = hysteresis(LAWS['jenkins'], motion.load, 0.05 * values['load'], 1.0)
    below = 0.5 - 0.5 * np.tanh((motion.load - values['load']) / (0.04 * values['load']))
    motion.tilt -= values['angle'] * below * (0.5 - 0.5 * z)


@effect('out:waviness', 'motion', X,
        [TrueSize('height', 'm', 0.7e-6, 5e-6, 2e-6),
         TrueSize('spacing', 'N', 3e4, 9e4, 6e4, positive=True)])
def waviness(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """The raceway is wavy: the radial motion swings over the load."""
    motion.x += values['height'] * np.sin(2.0 * np.pi * motion.load / values['spacing'])


@effect('out:sqrt_lift', 'motion', ('delta_y',),
        [TrueSize('lift', 'm/N^0.5', 0.5e-8, 5e-8, 2e-8, signed=True)])
def sqrt_lift(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """The ring lifts by the square root of the load."""
    motion.y += values['lift'] * np.sqrt(np.maximum(motion.load, 0.0))


@effect('out:snap', 'motion', X,
        [TrueSize('height', 'm', 1e-6, 8e-6, 4e-6, signed=True),
         TrueSize('load', 'N', 6e4, 1.8e5, 1.2e5, positive=True)])
def snap(motion: Motion, values: Mapping[str, float], form: str) -> None:
    """A seat snaps over at one load, both ways."""
    width = size_factor('N', motion.rig) * 3e3
    motion.x += values['height'] * 0.5 * (1.0 + np.tanh((motion.load - values['load']) / width))
