"""Causes in the motion of the ring: friction, damping, compliances, creep, settling, resonance."""

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any, ClassVar

from saddlering_ros.effects import base
from saddlering_ros.effects.base import Choice, EffectParameter, Outcomes, RingEffect, Variant
from saddlering_ros.effects.extension import Hysteron, OwnParameter, READING, RingExtension
from saddlering_ros.rig import Rig

AXIAL, TILT, EACH = 1.0, 2.0, 3.0
"""The choices of a coordinate: axial motion, tilting, or every coordinate by its own amount."""


def loop_parameters(presliding_unit: str, low: float, high: float,
                    start: float) -> tuple[EffectParameter, ...]:
    """Presliding between `low` and `high`, sharpness of the loop's corners, and how it begins."""
    return (
        EffectParameter(
            'presliding', presliding_unit, low, high, start, start,
            'travel after a reversal within which friction changes direction', one_sided=True,
            logarithmic=True),
        EffectParameter(
            'sharpness', '1', 0.0, 1.0, 0.5, 0.5,
            'corners of the loop: 0 rounded (Dahl), 1 sharp (Jenkins)', one_sided=True),
        EffectParameter(
            'initial', '1', -1.0, 1.0, 0.5, 0.0,
            'share of the friction at the zero of the run: 1 as while loading, -1 as while '
            'unloading'))


def hysteron(limit: float, values: Mapping[str, float]) -> Hysteron:
    """The friction element of height `limit` [N, N m or rad] with the loop parameters."""
    return Hysteron(limit, values['presliding'], values['sharpness'], values['initial'])


LOOP_OUTCOMES = Outcomes(
    second_rate='a loop of the same height',
    repeat_cycle='a loop that repeats and stays open during the holds', pull_push=base.UNCLEAR)
"""What the tests on the rig show of friction."""


class FrictionEffect(RingEffect):
    """A friction element of `RingExtension`, of the height of the first parameter."""

    element: ClassVar[str]

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """The extension with the friction element set."""
        changed: dict[str, Any] = {self.element: hysteron(values[self.parameters[0].name], values)}
        return replace(extension, **changed)


class RadialFriction(FrictionEffect):
    formula = 'Dry friction against delta_x: a hysteron over delta_x takes up to its force'
    title = 'Dry friction in the radial row'
    words = ('Cages, seals or skewed rollers resist radial motion by a nearly constant force, '
             'which changes direction with the motion. The radial channel shows a loop that does '
             'not depend on the rate, with a flat part after each reversal. Tilt and axial motion '
             'show no loop.')
    settled_by = ('A second loading rate (x4), then a repeat cycle with holds at zero and full '
                  'load: the loop keeps its height and does not close during the holds.')
    outcomes = LOOP_OUTCOMES
    element = 'radial_friction'
    stage = 'ring'
    form = 0.1  # sticking exceeds sliding by a tenth to a quarter, and how much the speed decides
    channels = ('delta_x',)
    parameters = (
        EffectParameter('force', 'N', 0.0, 80000.0, 5000.0, 5000.0, 'full friction force',
                        amplitude=True, one_sided=True),
        *loop_parameters('m', 2e-7, 3e-5, 2e-6))


class TiltFriction(RingEffect):
    formula = ('Dry friction in the axial rows: a hysteron over gamma or delta_y takes up to its '
               'moment')
    title = 'Dry friction in the axial rows'
    words = ('Friction in the axial rows or their seals resists tilting by a nearly constant '
             'moment, which changes direction with the motion. Tilt and axial motion show a loop '
             'that does not depend on the rate and repeats in every cycle. A seal that rubs all '
             'around resists axial and radial motion too, each by a force of its own; one that '
             'rubs evenly resists axial motion alone.')
    settled_by = ('A repeat cycle with holds at zero and full load: friction shows the same loop '
                  'again, settling does not, and drift continues during the holds.')
    outcomes = LOOP_OUTCOMES
    stage = 'ring'
    form = 0.1  # sticking exceeds sliding by a tenth to a quarter, and how much the speed decides
    parameters = (
        EffectParameter('moment', 'N m', 0.0, 60000.0, 3000.0, 3000.0,
                        'full friction moment; of axial motion alone the force at 1 m from the '
                        'axis', amplitude=True, one_sided=True),
        *loop_parameters('rad', 3e-7, 5e-5, 3e-6),
        EffectParameter('force', 'N', 0.0, 80000.0, 5000.0, 0.0,
                        'full friction force against radial motion, where each coordinate has its '
                        'own', amplitude=True, one_sided=True),
        EffectParameter('presliding_x', 'm', 2e-7, 3e-5, 2e-6, 2e-6,
                        'radial travel after a reversal within which friction changes direction',
                        one_sided=True, logarithmic=True),
        EffectParameter('force_y', 'N', 0.0, 80000.0, 5000.0, 0.0,
                        'full friction force against axial motion, where each coordinate has its '
                        'own', amplitude=True, one_sided=True),
        EffectParameter('presliding_y', 'm', 3e-7, 5e-5, 3e-6, 3e-6,
                        'axial travel after a reversal within which friction changes direction',
                        one_sided=True, logarithmic=True))
    variants = (
        Variant('gamma', {'coordinate': TILT}, ('delta_y', 'gamma')),
        Variant('delta_y', {'coordinate': AXIAL}, ('delta_y', 'gamma')),
        Variant('each coordinate', {'coordinate': EACH},
                frees=('force', 'presliding_x', 'force_y', 'presliding_y'),
                contains=('radial_friction',)))
    choices = (Choice('coordinate', (TILT, AXIAL, EACH), '2 gamma, 1 delta_y, 3 each'),)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        element = hysteron(values['moment'], values)
        if values['coordinate'] == AXIAL:
            return replace(extension, axial_friction=element)
        tilted = replace(extension, tilt_friction=element)
        if values['coordinate'] != EACH:
            return tilted
        radial = {**values, 'presliding': values['presliding_x']}
        axial = {**values, 'presliding': values['presliding_y']}
        return replace(tilted, radial_friction=hysteron(values['force'], radial),
                       axial_friction=hysteron(values['force_y'], axial))


class DampingLaw(RingEffect):
    formula = ('Damping D (1 - s + s h), with h = (p/r)^m (1 + (r L)^m) / (1 + (p L)^m), in '
               'place of D alone')
    title = 'Damping grows with penetration'
    words = ('The damping of a roller grows with its penetration, and the model has one constant '
             'D. In a dynamic run the lag behind the load grows with the load and not with the '
             'rate alone. A static run shows nothing. Damping may stop growing after the film is '
             'squeezed out; with a high power, damping then begins at one penetration.')
    settled_by = ('A second loading rate (x4): the lag scales with rate at each load, and its '
                  'shape over load stays.')
    outcomes = Outcomes(
        second_rate='a lag that keeps its shape over load and scales with the rate')
    stage = 'ring'
    form = 0.1  # the power of penetration and the saturation may differ between the rows
    parameters = (
        EffectParameter(
            'share', '1', 0.0, 1.0, 0.5, 0.5,
            'share of the damping that grows; h = 1 at r = 50 µm', amplitude=True, one_sided=True,
            adds_to='damping_penetration_share'),
        # Tsuji et al. 1992: 1/4; Kuwabara and Kono 1987: 1/2; Hunt and Crossley 1975: n
        EffectParameter('exponent', '1', 0.2, 8.0, 1.0, 10.0 / 9.0,
                        'm, by which damping grows; left out in a file: n of each row',
                        one_sided=True, logarithmic=True,
                        adds_to='damping_penetration_exponent'),
        EffectParameter('levelling', '1/m', 0.0, 2e5, 2e4, 0.0,
                        'L, one over the penetration beyond which damping is constant; 0: no '
                        'limit', one_sided=True, adds_to='damping_penetration_saturation'))
    dynamic_only = True
    starts = ({'exponent': 0.25}, {'exponent': 6.0, 'levelling': 5e4},
              {'exponent': 6.0, 'levelling': 1.2e5})

    def complete(self, values: Mapping[str, float], rig: Rig | None = None) -> dict[str, float]:
        """An exponent left out stays out: it is n of each row, as in files that have none."""
        complete = super().complete(values, rig)
        if 'exponent' not in values:
            del complete['exponent']
        return complete


class RadialCompliance(RingEffect):
    formula = 'A spring in series with the rollers: delta_x += c F_x'
    title = 'Radial compliance in series'
    words = ('Bolts, ring bodies or the carriage deform radially in series with the rollers. The '
             'additional motion is a straight line over load, without loop and without damping, '
             'so that the radial stiffness imitates nearly all of it.')
    settled_by = 'A second loading rate (x4): the compliance has no damping, the rollers have.'
    outcomes = Outcomes(other_elevation='a radial misfit in proportion to the radial force')
    stage = 'ring'
    channels = ('delta_x',)
    parameters = (EffectParameter(
        'compliance', 'm/N', 0.0, 4e-10, 6e-11, 6e-11, 'motion per unit of force', amplitude=True,
        one_sided=True, adds_to='radial_compliance'),)


class AxialCompliance(RingEffect):
    formula = 'A spring in series with the rollers: delta_y += c F_y'
    title = 'Axial compliance in series'
    words = ('Bolts or ring bodies deform axially in series with the rollers. The additional '
             'axial motion is a straight line over the axial force, without loop and without '
             'damping. Tilt is not changed.')
    settled_by = ('Swapped probes 2 and 4 rule out the instruments; a second loading rate (x4) '
                  'tells the spring from K1.')
    outcomes = Outcomes(
        other_elevation='a misfit of the axial motion in proportion to the axial force')
    stage = 'ring'
    channels = ('delta_y',)
    parameters = (EffectParameter(
        'compliance', 'm/N', 0.0, 3e-10, 5e-11, 5e-11, 'motion per unit of force', amplitude=True,
        one_sided=True, adds_to='axial_compliance'),)


class TiltCompliance(RingEffect):
    formula = 'A spring in series with the rollers: gamma += c M'
    title = 'Tilt compliance in series'
    words = ('Bolts, ring bodies or the carriage bend under the tilting moment in series with the '
             'rollers. The additional tilt is a straight line over the moment, without loop and '
             'without damping. A joint that bends unevenly moves the ring radially and axially '
             'too, each in proportion to its own force.')
    settled_by = 'A second loading rate (x4), or an inclinometer on the upper ring itself.'
    outcomes = Outcomes(other_elevation='a misfit of the tilt in proportion to the tilting moment')
    stage = 'ring'
    parameters = (
        EffectParameter('compliance', 'rad/(N m)', 0.0, 5e-10, 1e-10, 1e-10,
                        'motion per unit of moment', amplitude=True, one_sided=True,
                        adds_to='tilt_compliance'),
        EffectParameter('compliance_x', 'm/N', 0.0, 4e-10, 6e-11, 0.0,
                        'radial motion per unit of radial force, where every coordinate has its '
                        'own', amplitude=True, one_sided=True, adds_to='radial_compliance'),
        EffectParameter('compliance_y', 'm/N', 0.0, 3e-10, 5e-11, 0.0,
                        'axial motion per unit of axial force, where every coordinate has its own',
                        amplitude=True, one_sided=True, adds_to='axial_compliance'))
    variants = (
        Variant('gamma', {'coordinate': TILT}, ('gamma',)),
        Variant('each coordinate', {'coordinate': EACH},
                frees=('compliance_x', 'compliance_y'),
                contains=('radial_compliance', 'axial_compliance')))
    choices = (Choice('coordinate', (TILT, EACH), '2 gamma, 3 each'),)


class BoltOpening(RingEffect):
    formula = ('A joint that opens: gamma += c mean(max(0, M - M0)), M0 spread evenly over M0 - '
               'w to M0 + w')
    title = 'Opening bolted joint'
    words = ('Beyond a certain tilting moment the bolted joint opens on one side, and the ring '
             'tilts more easily. Tilt has a kink at one moment, or a bend if bolts open one after '
             'another. The kink is the same at every elevation, for rising and falling load.')
    settled_by = ('A run at another elevation: the kink stays at the same moment, not at the same '
                  'load; the ring slewed by 90 deg moves the opening to other bolts.')
    outcomes = Outcomes(
        slewed_ring='a kink at another tilting moment',
        other_elevation='a kink at the same tilting moment and another load')
    stage = 'ring'
    form = 0.05  # bolts need not open evenly over the range of moments
    channels = ('gamma',)
    parameters = (
        EffectParameter('compliance', 'rad/(N m)', 0.0, 1e-9, 2e-10, 2e-10,
                        'extra tilt per unit of moment beyond the opening moment', amplitude=True,
                        one_sided=True, adds_to='opening_compliance'),
        EffectParameter(
            'moment', 'N m', 20000.0, 250000.0, 100000.0, 100000.0,
            'tilting moment at which the joint opens, the mean of its bolts', one_sided=True,
            adds_to='opening_moment'),
        EffectParameter('spread', 'N m', 0.0, 60000.0, 10000.0, 0.0,
                        'w: bolts open from M0 - w to M0 + w; 0: all at once', one_sided=True,
                        adds_to='opening_spread'))
    # A sharp kink does not show its change with the spread: the search begins with a wide one
    starts = tuple({'moment': moment, 'spread': 0.2 * moment} for moment in (4e4, 7e4, 1e5, 1.4e5))


class RingOvalisation(RingEffect):
    formula = 'Ovalisation of the ring: d1 and d3 += c F_x, with the same sign'
    title = 'Ovalisation of the ring'
    words = ('The radial force squeezes the ring a little oval, so that both radial probes move '
             'in the same direction. Ovalisation shows in the parity (d1 + d3)/2 only, which is '
             'zero for a rigid ring. The parity is then a straight line over load, without loop.')
    settled_by = ('Swapped probes 1 and 3: ovalisation stays in the parity, a gain error of one '
                  'probe changes its sign.')
    outcomes = Outcomes(other_elevation='a parity in proportion to the radial force')
    stage = 'ring'
    channels = ('parity',)
    parameters = (EffectParameter(
        'compliance', 'm/N', -2e-10, 2e-10, 3e-11, 0.0,
        'common radial motion per unit of radial force', amplitude=True,
        adds_to=OwnParameter('ovalisation', 'ring', READING)),)


ALL_ROWS, RADIAL_ROW, AXIAL_ROWS = 0.0, 1.0, 2.0


class FilmCreep(RingEffect):
    formula = 'Creep of the oil film: y += c LP_T(y), a Maxwell film in series'
    title = 'Creep of the oil film'
    words = ('The lubricant between rollers and raceways is squeezed out slowly, so that the ring '
             'continues to move while the load is held, and returns late. Creep shows as drift on '
             'the plateaus, as a loop that depends on the loading rate, and as a displacement '
             'that remains at the end.')
    settled_by = ('A second loading rate (x4), and a repeat cycle with holds at zero and full '
                  'load: creep continues during the holds and fades.')
    outcomes = Outcomes(
        second_rate='a loop whose height depends on the rate',
        repeat_cycle='a loop that closes during the holds', zero_load=base.UNCLEAR,
        pull_push=base.UNCLEAR)
    stage = 'ring'
    form = 0.1  # films creep with more than one time constant
    parameters = (
        EffectParameter('share', '1', 0.0, 1.0, 0.05, 0.05,
                        'creep after a long time as a share of the immediate motion',
                        amplitude=True, one_sided=True),
        EffectParameter('time', 's', 0.1, 300.0, 10.0, 10.0, 'time constant of the creep',
                        one_sided=True, logarithmic=True),
        EffectParameter('share_axial', '1', 0.0, 1.0, 0.05, 0.05,
                        'share of the axial rows where they have their own, the first being the '
                        'radial row', amplitude=True, one_sided=True))
    variants = (
        Variant('all rows', {'rows': ALL_ROWS}),
        Variant('radial row', {'rows': RADIAL_ROW}, ('delta_x',)),
        Variant('axial rows', {'rows': AXIAL_ROWS}, ('delta_y', 'gamma')),
        Variant('radial and axial rows', {'rows': EACH}, frees=('share_axial',)))
    choices = (
        Choice('rows', (ALL_ROWS, RADIAL_ROW, AXIAL_ROWS, EACH),
               '0 all rows, 1 radial row, 2 axial rows, 3 radial and axial rows by their own'),)
    starts = tuple({'time': time} for time in (0.5, 5.0, 50.0))

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        radial = values['share'] if values['rows'] != AXIAL_ROWS else extension.creep_radial
        axial = values['share'] if values['rows'] != RADIAL_ROW else extension.creep_axial
        if values['rows'] == EACH:
            axial = values['share_axial']
        return replace(extension, creep_radial=radial, creep_axial=axial,
                       creep_time=values['time'])


SETTLING = ('settling_x', 'settling_y', 'settling_tilt')


class Settling(RingEffect):
    formula = 'Settling under the highest load so far: y += s max P'
    title = 'Settling in the first cycle'
    words = ('Joints, shims or asperities settle permanently under the highest load so far. The '
             'first cycle does not return to zero, and its loop is open at the lower end. A '
             'second cycle to the same load shows no change.')
    settled_by = ('A repeat cycle with holds at zero and full load: the second cycle shows no '
                  'settling.')
    outcomes = Outcomes(
        second_rate='no misfit in the repeated test',
        repeat_cycle='a misfit in the first cycle only',
        swapped_probes='no misfit in the repeated test', slewed_ring=base.UNCLEAR,
        other_elevation=base.UNCLEAR, other_gap='no misfit in the repeated test',
        pull_push=base.UNCLEAR)
    stage = 'ring'
    form = 0.05  # joints settle not quite in proportion to the load
    parameters = (
        EffectParameter('settling', 'm/N', -3e-10, 3e-10, 4e-11, 0.0,
                        'remaining motion per unit of the highest load; for tilt that at 1 m from '
                        'the axis', amplitude=True),
        EffectParameter('settling_y', 'm/N', -3e-10, 3e-10, 4e-11, 0.0,
                        'the same of delta_y where every coordinate has its own, the first being '
                        'of delta_x', amplitude=True, adds_to='settling_y'),
        EffectParameter('settling_tilt', 'm/N', -3e-10, 3e-10, 4e-11, 0.0,
                        'the same of gamma, at 1 m from the axis, where every coordinate has its '
                        'own', amplitude=True, adds_to='settling_tilt'))
    variants = (
        Variant('delta_x', {'coordinate': 0.0}, ('delta_x',)),
        Variant('delta_y', {'coordinate': 1.0}, ('delta_y',)),
        Variant('gamma', {'coordinate': 2.0}, ('gamma',)),
        Variant('each coordinate', {'coordinate': EACH}, frees=('settling_y', 'settling_tilt')))
    choices = (
        Choice('coordinate', (0.0, 1.0, 2.0, EACH), '0 delta_x, 1 delta_y, 2 gamma, 3 each'),)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        # Where each coordinate has its own amount, the first is that of delta_x.
        name = SETTLING[round(values['coordinate']) % len(SETTLING)]
        extended = super().extend(extension, values)
        return replace(extended, **{name: getattr(extended, name) + values['settling']})


ALIKE, APART = 0.0, 1.0

PERIODS = tuple(0.02 * 1.15**number for number in range(25))
"""Periods [s] tried first: closer than a ringing of ten periods separates."""

SHORTEST_PERIOD = 1e-4
"""Below this period [s] the mode is as good as rigid."""


class CarriageResonance(RingEffect):
    formula = "A second mode in series: v'' + 2 z w v' + w^2 v = w^2 u, and y = (1 - s) u + s v"
    title = 'Resonance of the carriage'
    words = ('The carriage or the frame oscillates after each sudden change of the load rate. All '
             'displacement channels oscillate at one frequency with a falling amplitude. A static '
             'run shows nothing.')
    settled_by = ('A second loading rate (x4): the oscillation grows with the rate and keeps its '
                  'frequency.')
    outcomes = Outcomes(second_rate='an oscillation that becomes smaller and keeps its frequency')
    stage = 'ring'
    parameters = (
        EffectParameter('share', '1', 0.0, 1.5, 1.0, 1.0,
                        'share of the motion that the second mode carries; 0: rigid',
                        amplitude=True, one_sided=True),
        EffectParameter('period', 's', 0.0, 1.0, 0.1, 0.1,
                        'period of the second mode (one over its frequency)', one_sided=True),
        EffectParameter('damping', '1', 0.005, 0.7, 0.05, 0.05, 'damping ratio of the second mode',
                        one_sided=True, logarithmic=True),
        EffectParameter('share_y', '1', 0.0, 1.5, 1.0, 1.0,
                        'share of delta_y where every coordinate has its own, the first being of '
                        'delta_x', amplitude=True, one_sided=True),
        EffectParameter(
            'share_tilt', '1', 0.0, 1.5, 1.0, 1.0,
            'share of gamma where every coordinate has its own', amplitude=True, one_sided=True))
    variants = (
        Variant('all alike', {'coordinates': ALIKE}),
        Variant('each coordinate', {'coordinates': APART}, frees=('share_y', 'share_tilt')))
    choices = (
        Choice('coordinates', (ALIKE, APART), '0 all swing alike, 1 each by its own share'),)
    starts = tuple({'period': period} for period in PERIODS)
    dynamic_only = True

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        period = values['period']
        frequency = 2.0 * math.pi / period if period > SHORTEST_PERIOD else 0.0
        share = values['share']
        shares = (share, share, share)
        if values['coordinates'] == APART:
            shares = (share, values['share_y'], values['share_tilt'])
        return replace(extension, resonance_frequency=frequency,
                       resonance_damping=values['damping'], resonance_share=shares)
