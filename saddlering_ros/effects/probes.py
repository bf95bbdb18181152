"""Causes in the measurement: probes, their cables and brackets, and the clocks."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from saddlering_ros.effects import base
from saddlering_ros.effects.base import Choice, EffectParameter, Outcomes, RingEffect, Variant
from saddlering_ros.effects.extension import RingExtension, with_probe

MOVES = 'a misfit that moves with the probe'
"""Outcome of swapped probes for an effect that belongs to the probe and not to its place."""

ONE_PROBE = Choice(
    'probe', (1.0, 2.0, 3.0, 4.0), 'radial: 1 rear, 3 front; axial: 2 front, 4 rear')
ANY_PROBE = Choice('probe', (0.0, 1.0, 2.0, 3.0, 4.0), '0 for all probes, else one of them')


def probe_variants(more: Mapping[str, float] | None = None,
                   words: str = '') -> tuple[Variant, ...]:
    """One variant per probe 1 to 4, each with `more` values and `words` if given.

    1 and 3 are the radial probes, 2 and 4 the axial ones.
    """
    return tuple(
        Variant(f'probe {probe}{words}', {'probe': float(probe), **(more or {})},
                ('delta_x', 'parity') if probe in (1, 3) else ('delta_y', 'gamma'))
        for probe in (1, 2, 3, 4)
    )


class ProbeEffect(RingEffect):
    """An effect of the measurement at one of the probes."""

    stage = 'measurement'
    channels = ('delta_x', 'delta_y', 'gamma', 'parity')
    variants = probe_variants()
    choices: ClassVar[tuple[Choice, ...]] = (ONE_PROBE,)


class ProbeHeight(RingEffect):
    formula = 'Radial probes higher than assumed: d1 and -d3 see delta_x + (h_s + h) gamma'
    title = 'Height of the radial probes'
    words = ('The two radial probes sit higher or lower over the mid-plane of the ring than the '
             'rig file gives, so that they measure a part of the tilt. The error of the radial '
             'channel has the shape of the tilt.')
    settled_by = ('Measure the height of probes 1 and 3 over the mid-plane; or record a run at '
                  'another elevation, where the ratio of tilt and radial force differs.')
    outcomes = Outcomes(
        heights='another height of probes 1 and 3 than in the rig file',
        other_elevation='a radial misfit in proportion to the tilt')
    stage = 'measurement'
    channels = ('delta_x',)
    parameters = (EffectParameter(
        'height', 'm', -0.2, 0.2, 0.02, 0.0, 'true height minus the height in the rig file',
        amplitude=True, adds_to='probe_height'),)


class ProbeBracket(ProbeEffect):
    formula = 'A probe bracket that bends with load: d_i += b P'
    title = 'Probe bracket bends with load'
    words = ('The bracket of one probe moves with the load, because it bends or its base moves. '
             'The error of this probe is a straight line over load, without loop, and affects two '
             'channels.')
    settled_by = ('Swapped probes: the error stays with the bracket; the ring slewed by 90 deg '
                  'does not change the error.')
    outcomes = Outcomes(other_elevation='a misfit of one probe in the same proportion to the load')
    parameters = (EffectParameter(
        'compliance', 'm/N', -2e-10, 2e-10, 2e-11, 0.0, 'motion of the bracket per unit of load',
        amplitude=True, adds_to='probe_bracket'),)


class ProbeGain(ProbeEffect):
    formula = 'Wrong gain of one probe: d_i (1 + g)'
    title = 'Probe gain error'
    words = ('One probe reads a fixed share too much or too little, because of its calibration or '
             'the metal of its target. A radial probe (1, 3) shows it in the parity, an axial one '
             '(2, 4) in the ratio of axial motion to tilt.')
    settled_by = 'Swapped probes: the error moves with the probe.'
    outcomes = Outcomes(swapped_probes=MOVES)
    parameters = (EffectParameter(
        'gain', '1', -0.3, 0.3, 0.03, 0.0, 'share by which the probe reads too much',
        amplitude=True, adds_to='probe_gain'),)


class ProbeNonlinearity(ProbeEffect):
    formula = 'Bent characteristic of one probe: d_i += q d_i^2'
    title = 'Bent probe characteristic'
    words = ('The characteristic of one probe is bent, as happens near the end of its span. The '
             'error is a function of its reading, and does not depend on load, rate or elevation.')
    settled_by = ('Swapped probes: the error moves with the probe; or another gap at zero, which '
                  'shifts the error along the characteristic.')
    outcomes = Outcomes(
        swapped_probes=MOVES,
        other_gap='a misfit that moves to another load')
    parameters = (EffectParameter(
        'curvature', '1/m', -3000.0, 3000.0, 100.0, 0.0,
        'curvature; 100 per metre is 1 % at 100 micrometres', amplitude=True,
        adds_to='probe_nonlinearity'),)


RADIAL, AXIAL = 13.0, 24.0
"""The choices of two probes, which are opposite: 1 and 3, or 2 and 4."""


class ProbeDrift(ProbeEffect):
    formula = 'Drift of one probe, or of two opposite ones: d_i += r t'
    title = 'Probe drift'
    words = ('The reading of one probe, or of two opposite ones, drifts with time, mostly with '
             'temperature. The error follows time and not the load, continues at rest, and leaves '
             'the loop open at zero.')
    settled_by = 'A zero-load record as long as a test.'
    outcomes = Outcomes(
        second_rate='a misfit that grows with the time and not with the load',
        repeat_cycle='a misfit that continues to grow during the holds at preload',
        zero_load='readings that drift at constant preload',
        swapped_probes=MOVES)
    parameters = (
        EffectParameter('rate', 'm/s', -5e-7, 5e-7, 2e-8, 0.0, 'drift per second', amplitude=True),
        EffectParameter('both', 'm/s', -1e-6, 1e-6, 2e-8, 0.0,
                        'sum of the drifts of two opposite probes per second; 0: the second one '
                        'drifts as the first does, with the other sign', amplitude=True))
    variants = (
        *probe_variants(),
        Variant('both radial probes', {'probe': RADIAL}, ('delta_x', 'parity'), ('both',)),
        Variant('both axial probes', {'probe': AXIAL}, ('delta_y', 'gamma'), ('both',)))
    choices = (Choice('probe', (1.0, 2.0, 3.0, 4.0, RADIAL, AXIAL),
                      'radial: 1 rear, 3 front, 13 both; axial: 2 front, 4 rear, 24 both'),)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        probe, rate = round(values['probe']), values['rate']
        if probe not in (RADIAL, AXIAL):
            return replace(extension, probe_drift=with_probe(extension.probe_drift, probe, rate))
        first, second = divmod(probe, 10)
        one = with_probe(extension.probe_drift, first, rate)
        return replace(extension, probe_drift=with_probe(one, second, values['both'] - rate))


class ProbeLag(ProbeEffect):
    formula = 'Slow probe electronics: a low-pass of one or two stages on one or all probes'
    title = 'Probe lag'
    words = ('A filter in the electronics delays one probe, or all probes. In a dynamic run the '
             'error is exponential after each change of the load rate. A static run shows '
             'nothing. A lag of all probes looks much like damping, and a lag of two stages much '
             'like a clock offset.')
    settled_by = 'A second loading rate (x4), with swapped probes if only one is slow.'
    outcomes = Outcomes(
        second_rate='a delay of the same time with rounded corners', swapped_probes=base.UNCLEAR)
    parameters = (
        EffectParameter('time', 's', 0.0, 1.0, 0.03, 0.03,
                        'time constant of the low-pass, of both its stages together',
                        amplitude=True, one_sided=True, adds_to='probe_lag'),
        EffectParameter('second', '1', 0.0, 0.5, 0.5, 0.0,
                        'share of the time constant that a second stage has; 0: one stage',
                        one_sided=True, adds_to='probe_lag_second'))
    variants = (
        Variant('all probes', {'probe': 0.0}, ('delta_x', 'delta_y', 'gamma')), *probe_variants())
    choices = (ANY_PROBE,)
    starts = ({'second': 0.5},)
    dynamic_only = True


class ProbeSaturation(ProbeEffect):
    formula = 'A probe at the end of its span: d_i clipped at a limit'
    title = 'Probe saturation'
    words = ('One probe reaches the end of its span, and its reading stays constant while the '
             'ring moves on. The reading is cut off at one level, for rising and falling load, '
             'and right below this level.')
    settled_by = ('The same test with the gap of that probe set wider or narrower at zero; '
                  'swapped probes.')
    outcomes = Outcomes(
        swapped_probes=MOVES,
        other_gap='a flat part that moves to another load or disappears')
    parameters = (EffectParameter(
        'limit', 'm', 2e-6, 1e-3, 8e-5, 8e-5,
        'travel from zero at which the reading is cut off; large: never', amplitude=True,
        one_sided=True, neutral=1e-3, logarithmic=True),)
    variants = (
        *probe_variants({'side': 1.0}, ', increasing readings'),
        *probe_variants({'side': -1.0}, ', decreasing readings'))
    choices = (ONE_PROBE, Choice('side', (1.0, -1.0), '1 increasing readings, -1 decreasing ones'))
    starts = tuple({'limit': limit} for limit in (2e-5, 4e-5, 8e-5, 1.2e-4, 1.6e-4, 2e-4))

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        name = 'saturation_high' if values['side'] > 0.0 else 'saturation_low'
        levels = list(getattr(extension, name))
        levels[round(values['probe']) - 1] = values['side'] * values['limit']
        changed: dict[str, Any] = {name: tuple(levels)}
        return replace(extension, **changed)


class MainsPickup(ProbeEffect):
    formula = 'Pickup of a line frequency: d_i += a cos(w t) + b sin(w t)'
    title = 'Mains pickup'
    words = ('The probe cables pick up the mains, or a pump. The readings contain a steady '
             'oscillation at one frequency, at zero load too. At a low sampling rate this '
             'oscillation appears at another, lower frequency. A spectrum shows its frequency.')
    settled_by = 'A zero-load record at the highest sampling rate.'
    outcomes = Outcomes(
        zero_load='a line in the spectrum at constant preload', swapped_probes=base.UNCLEAR)
    parameters = (
        EffectParameter('cosine', 'm', -2e-5, 2e-5, 1e-6, 0.0,
                        'part in phase with a cosine from the start of the run', amplitude=True,
                        adds_to='pickup_cosine'),
        EffectParameter('sine', 'm', -2e-5, 2e-5, 1e-6, 0.0,
                        'part in phase with a sine from the start of the run', amplitude=True,
                        adds_to='pickup_sine'),
        EffectParameter('frequency', 'Hz', 0.5, 500.0, 50.0, 50.0, 'true frequency of the line',
                        one_sided=True, logarithmic=True))
    variants = (Variant('all probes', {'probe': 0.0}, ('delta_y', 'parity')), *probe_variants())
    choices = (ANY_PROBE,)
    line = True
    starts = ({'frequency': 50.0}, {'frequency': 60.0})

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        return replace(super().extend(extension, values), pickup_frequency=values['frequency'])


class ClockOffset(RingEffect):
    formula = 'Two clocks: a reading of the probes at t carries the stamp t + tau + skew t'
    title = 'Clock offset between load and probes'
    words = ('Load and probes are stamped by two clocks with an offset or a different speed. All '
             'probes are early or late by the same time, without smoothing. A static run hardly '
             'shows this.')
    settled_by = ('A second loading rate (x4): the shift stays the same in seconds; or record one '
                  'signal with both recorders.')
    outcomes = Outcomes(second_rate='a shift of the same time with sharp corners')
    stage = 'measurement'
    parameters = (
        EffectParameter('offset', 's', -0.5, 0.5, 0.02, 0.0,
                        'stamp of the probes minus true time; positive: probes late',
                        amplitude=True, adds_to='clock_offset'),
        EffectParameter(
            'skew', '1', -0.001, 1e-3, 1e-4, 0.0,
            'further offset per second of the run', amplitude=True, adds_to='clock_skew'))
    dynamic_only = True
