"""Creep of the oil film: y += c LP_T(y), a Maxwell film in series."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Choice, EffectParameter, RingEffect, UNCLEAR, Variant
from saddlering_ros.effects.extension import RingExtension

ALL_ROWS, RADIAL, AXIAL, EACH = 0.0, 1.0, 2.0, 3.0


class FilmCreep(RingEffect):
    title = 'Creep of the oil film'
    words = ('The lubricant between rollers and raceways is squeezed out slowly, so that the ring '
             'continues to move while the load is held, and returns late. Creep shows as drift on '
             'the plateaus, as a loop that depends on the loading rate, and as a displacement '
             'that remains at the end.')
    settled_by = ('A second loading rate (x4), and a repeat cycle with holds at zero and full '
                  'load: creep continues during the holds and fades.')
    outcomes = {
        'second_rate': 'a loop whose height depends on the rate',
        'repeat_cycle': 'a loop that closes during the holds', 'zero_load': UNCLEAR,
        'pull_push': UNCLEAR}
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
        Variant('radial row', {'rows': RADIAL}, ('delta_x',)),
        Variant('axial rows', {'rows': AXIAL}, ('delta_y', 'gamma')),
        Variant('radial and axial rows', {'rows': EACH}, frees=('share_axial',)))
    choices = (
        Choice('rows', (ALL_ROWS, RADIAL, AXIAL, EACH),
               '0 all rows, 1 radial row, 2 axial rows, 3 radial and axial rows by their own'),)
    starts = tuple({'time': time} for time in (0.5, 5.0, 50.0))

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        radial = values['share'] if values['rows'] != AXIAL else extension.creep_radial
        axial = values['share'] if values['rows'] != RADIAL else extension.creep_axial
        if values['rows'] == EACH:
            axial = values['share_axial']
        return replace(extension, creep_radial=radial, creep_axial=axial,
                       creep_time=values['time'])
