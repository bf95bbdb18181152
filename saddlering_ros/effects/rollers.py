"""Causes in the rollers and raceways: clearances, shapes of a raceway, unequal rows, worn arcs."""

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any, ClassVar

from saddlering_ros.effects import base
from saddlering_ros.effects.base import Choice, EffectParameter, Outcomes, RingEffect, Variant
from saddlering_ros.effects.extension import RingExtension, Wear


class ClearanceEffect(RingEffect):
    """Another clearance mu than in the rig file; half the change is at each side of a row."""

    rows: ClassVar[tuple[str, ...]]
    formula = ('Another clearance than assumed: mu + e (1 + s u), half at each side, u in -1 to '
               '1 by roller')
    settled_by = ('Pull-push through zero load: the jump between the two directions is the '
                  'clearance.')
    stage = 'ring'
    form = 0.1  # rollers differ by a pattern of their own
    parameters = (
        EffectParameter('change', 'm', -4e-5, 1e-4, 2e-5, 0.0,
                        'true clearance minus the clearance in the rig file', amplitude=True),
        EffectParameter('spread', '1', 0.0, 1.0, 0.3, 0.0,
                        'difference of rollers: evenly from 1 - s to 1 + s times the change; 0: '
                        'all alike', one_sided=True))
    starts = ({'change': 2e-5, 'spread': 0.8}, {'change': -1e-5, 'spread': 0.8})

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """The extension with the gaps of the rows changed."""
        half = 0.5 * values['change']
        changed: dict[str, Any] = {}
        for name in self.rows:
            row = getattr(extension, name)
            changed[name] = replace(row, gap=row.gap + half,
                                    gap_spread=abs(half) * values['spread'])
        return replace(extension, **changed)


class AxialClearance(ClearanceEffect):
    title = 'Wrong axial clearance'
    words = ('The clearance of the axial rows differs from the rig file. Tilt and axial motion '
             'begin with a dead zone and then have a nearly constant error, because fewer or more '
             'rollers share the load.')
    outcomes = Outcomes(pull_push='an axial jump other than the clearance in the rig file')
    rows = ('upper_row', 'lower_row')
    channels = ('delta_y', 'gamma')


class RadialClearance(ClearanceEffect):
    title = 'Wrong radial clearance'
    words = ('The clearance of the radial row differs from the rig file. The radial channel '
             'begins with a dead zone and then has a nearly constant error, because fewer or more '
             'rollers share the load.')
    outcomes = Outcomes(pull_push='a radial jump other than the clearance in the rig file')
    rows = ('radial_row',)
    channels = ('delta_x',)


class OutOfRound(RingEffect):
    formula = 'A raceway out of round: radial gap + a cos(2 (phi - phi0))'
    title = 'Raceway out of round'
    words = ('The radial raceway is slightly oval from the start, so that the gap has two maxima '
             'around the ring. The radial channel looks much as with a wrong clearance: a dead '
             'zone and then a nearly constant offset.')
    settled_by = ('The ring slewed by 90 deg: the effect of an oval changes its sign, that of a '
                  'clearance does not.')
    outcomes = Outcomes(slewed_ring='a misfit of the opposite sign', pull_push=base.UNCLEAR)
    stage = 'ring'
    channels = ('delta_x',)
    parameters = (
        EffectParameter(
            'amplitude', 'm', -3e-5, 3e-5, 8e-6, 0.0,
            'largest change of the radial gap; positive: wider at phi0', amplitude=True),
        EffectParameter('angle', 'rad', 0.0, math.pi / 4, 0.2, 0.2,
                        'phi0 of the widest gap, from the rear', one_sided=True))
    # Not at 0, where the mirror image makes every change of the angle vanish.
    starts = ({'angle': 0.1}, {'angle': 0.4}, {'angle': 0.65})

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        row = replace(extension.radial_row, oval_amplitude=values['amplitude'],
                      oval_angle=values['angle'])
        return replace(extension, radial_row=row)


class UnequalRows(RingEffect):
    formula = 'Unequal axial rows: the lower row has (1 + e) K1'
    title = 'Unequal axial rows'
    words = ('The lower row is stiffer or softer than the upper one, by other rollers, wear or '
             'hardness. The ratio of axial motion to tilt differs from that of equal rows, over '
             'the whole load range.')
    settled_by = ('Pull-push through zero load, which exchanges the parts of the two rows; '
                  'swapped probes 2 and 4 rule out the instruments.')
    outcomes = Outcomes(pull_push='a misfit that changes its sign with the load')
    stage = 'ring'
    channels = ('delta_y', 'gamma')
    parameters = (EffectParameter(
        'excess', '1', -0.7, 2.0, 0.2, 0.0,
        'stiffness of the lower row over that of the upper row, minus 1', amplitude=True),)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        row = extension.lower_row
        stiffness = row.stiffness * (1.0 + values['excess'])
        return replace(extension, lower_row=replace(row, stiffness=stiffness))


STIFFNESS, GAP = 0.0, 1.0
KINDS = ((STIFFNESS, 'softer rollers'), (GAP, 'larger gap'))
KIND = Choice('kind', (STIFFNESS, GAP), '0 softer rollers, 1 larger gap')

FULL_GAP = 1e-4
"""Extra gap [m] at a wear of 1."""

SOFT = 0.3
"""Softness of an arc's ends [rad] from which the search starts: sharp ones make a valley of every
roller."""

WHOLE_ROW = 1.5
"""Half width [rad] of an arc that is, with its mirror image, nearly the whole row. On independent
and dirty rings the 95 % intervals of right arcs ended at 1.15 rad or below, and four arcs that
stood in for unequal rows could be this wide."""

STARTS = (
    {'centre': 0.15, 'half_width': 0.4}, {'centre': 0.8, 'half_width': 0.4},
    {'centre': 0.4, 'half_width': 1.0}, {'centre': 1.6}, {'centre': 2.7})
"""The load zone at the rear (not at 0, where a mirror image hides the influence of the centre),
the place between and the load zone at the front."""


def arc_parameters(centre: float) -> tuple[EffectParameter, ...]:
    """Parameters of a worn arc; `centre` [rad] is where the search for it starts."""
    return (
        EffectParameter(
            'wear', '1', 0.0, 1.0, 0.3, 0.3,
            'share of stiffness lost on the arc, or its extra gap in units of 0.1 mm',
            amplitude=True, one_sided=True),
        EffectParameter(
            'centre', 'rad', 0.0, math.pi, 0.5, centre,
            'middle of the arc from the rear (x > 0); its mirror image has the same effect',
            one_sided=True),
        EffectParameter(
            'half_width', 'rad', 0.15, WHOLE_ROW, 0.5, 0.6,
            'half the length of the arc, to the middle of its ends', one_sided=True,
            limiting_case=WHOLE_ROW),
        EffectParameter(
            'edge', 'rad', 0.02, 0.8, 0.2, SOFT,
            'width of the ends of the arc: most of the change lies within twice this',
            one_sided=True))


def worn_arc(values: Mapping[str, float]) -> Wear:
    """The arc at `centre` [rad] with `half_width` and `edge` [rad], worn by `wear`."""
    wear = values['wear']
    loss, gap = (wear, 0.0) if values['kind'] == STIFFNESS else (0.0, FULL_GAP * wear)
    return Wear(values['centre'], values['half_width'], loss, gap, values['edge'])


class WornSector(RingEffect):
    """A worn arc of one or two rows."""

    settled_by = 'The ring slewed by 90 deg: the arc leaves the load zone.'
    outcomes = Outcomes(
        slewed_ring='a misfit that disappears or moves to another load', pull_push=base.UNCLEAR)
    stage = 'ring'
    form = 0.2  # worn arcs end softly, and no two rollers on them alike
    starts: ClassVar[tuple[Mapping[str, float], ...]] = STARTS


BOTH, UPPER, LOWER = 0.0, 1.0, 2.0
ROWS = ((BOTH, 'both rows'), (UPPER, 'upper row'), (LOWER, 'lower row'))


class WornSectorAxial(WornSector):
    formula = 'A worn arc of the axial rows: rollers there are softer, or have a larger gap'
    title = 'Worn sector of the axial rows'
    words = ('On one arc the axial rollers or their raceway are worn, so that they carry less or '
             'come into contact later. Tilt and axial motion are softer when the arc lies in the '
             'load zone (front for the upper row, rear for the lower one), and right elsewhere.')
    channels = ('delta_y', 'gamma')
    parameters = arc_parameters(centre=1.2)
    variants = tuple(
        Variant(f'{row_label}, {kind_label}', {'row': row, 'kind': kind})
        for row, row_label in ROWS for kind, kind_label in KINDS
    )
    choices = (Choice('row', tuple(row for row, _ in ROWS), '0 both rows, 1 upper, 2 lower'), KIND)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        wear = worn_arc(values)
        row = values['row']
        upper, lower = extension.upper_row, extension.lower_row
        return replace(
            extension, upper_row=upper if row == LOWER else replace(upper, wear=wear),
            lower_row=lower if row == UPPER else replace(lower, wear=wear))


class WornSectorRadial(WornSector):
    formula = 'A worn arc of the radial row: rollers there are softer, or have a larger gap'
    title = 'Worn sector of the radial row'
    words = ('On one arc the radial rollers or their raceway are worn, so that they carry less or '
             'come into contact later. The radial channel is softer when the arc lies at the '
             'rear, where the load is, and right elsewhere.')
    channels = ('delta_x',)
    parameters = arc_parameters(centre=0.5)
    variants = tuple(Variant(label, {'kind': kind}) for kind, label in KINDS)
    choices = (KIND,)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        row = replace(extension.radial_row, wear=worn_arc(values))
        return replace(extension, radial_row=row)
