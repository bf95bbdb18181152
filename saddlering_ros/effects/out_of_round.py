"""A raceway out of round: radial gap + a cos(2 (phi - phi0))."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import OvalGap
from saddlering_ros.effects.extension import RingExtension


class OutOfRound(OvalGap):
    title = 'Raceway out of round'
    words = ('The radial raceway is slightly oval from the start, so that the gap has two maxima '
             'around the ring. The radial channel looks much as with a wrong clearance: a dead '
             'zone and then a nearly constant offset.')
    channels = ('delta_x',)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        return replace(extension, radial_row=extension.radial_row.beside(self.waves(values)))
