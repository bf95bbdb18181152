"""What several effects share: friction loops, clearances, oval gaps, choice of a probe, arcs."""

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any, ClassVar

from saddlering_ros.effects.base import Choice, EffectParameter, RingEffect, UNCLEAR, Variant
from saddlering_ros.effects.extension import Hysteron, RingExtension, Wear


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


LOOP_OUTCOMES = {
    'second_rate': 'a loop of the same height',
    'repeat_cycle': 'a loop that repeats and stays open during the holds', 'pull_push': UNCLEAR}
"""What the tests on the rig show of friction."""


class FrictionEffect(RingEffect):
    """A friction element of `RingExtension`, of the height of the first parameter."""

    element: ClassVar[str]

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """The extension with the friction element set."""
        changed: dict[str, Any] = {self.element: hysteron(values[self.parameters[0].name], values)}
        return replace(extension, **changed)


class ClearanceEffect(RingEffect):
    """Another clearance than in the rig file; half the change is at each side of a row."""

    rows: ClassVar[tuple[str, ...]]
    settled_by = ('Pull-push through zero load: the jump between the two directions is the '
                  'clearance.')
    stage = 'ring'
    form = 0.1  # rollers differ by a pattern of their own
    parameters = (
        EffectParameter('change', 'm', -4e-5, 1e-4, 2e-5, 0.0,
                        'true clearance minus the clearance in the rig file', amplitude=True),
        EffectParameter('spread', '1', 0.0, 1.0, 0.3, 0.0,
                        'difference of rollers: evenly from 1 - s to 1 + s times the change; 0: '
                        'all alike, 1: also what waves round the raceways do', one_sided=True))
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


class OvalGap(RingEffect):
    """A gap with two maxima around the ring: + a cos(2 (phi - phi0))."""

    settled_by = ('The ring slewed by 90 deg: the effect of an oval changes its sign, that of a '
                  'clearance does not.')
    outcomes = {'slewed_ring': 'a misfit of the opposite sign', 'pull_push': UNCLEAR}
    stage = 'ring'
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            'amplitude', 'm', -3e-5, 3e-5, 8e-6, 0.0,
            'largest change of the gap; positive: wider at phi0', amplitude=True),
        EffectParameter('angle', 'rad', 0.0, math.pi / 4, 0.2, 0.2,
                        'phi0 of the widest gap, from the rear', one_sided=True))
    # Not at 0, where the mirror image makes every change of the angle vanish.
    starts: ClassVar[tuple[Mapping[str, float], ...]] = (
        {'angle': 0.1}, {'angle': 0.4}, {'angle': 0.65})

    def slewed(self, values: Mapping[str, float]) -> dict[str, float]:
        return {**values, 'amplitude': -values['amplitude']}


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
stood in for unequal rows could be this wide. One that stood in for a clearance of the whole row
could have no width."""

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
            limiting_case=(0.0, WHOLE_ROW)),
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
    """A worn arc of a row."""

    settled_by = 'The ring slewed by 90 deg: the arc leaves the load zone.'
    outcomes = {
        'slewed_ring': 'a misfit that disappears or moves to another load', 'pull_push': UNCLEAR}
    stage = 'ring'
    form = 0.2  # worn arcs end softly, and no two rollers on them alike
    # The load zone at the rear (not at 0, where a mirror image hides the influence of the centre),
    # the place between and the load zone at the front, to show where an arc is not visible.
    starts = ({'centre': 0.15, 'half_width': 0.4}, {'centre': 0.8, 'half_width': 0.4},
              {'centre': 0.4, 'half_width': 1.0}, {'centre': 1.6}, {'centre': 2.7})

    def slewed(self, values: Mapping[str, float]) -> dict[str, float]:
        centre = values['centre'] + math.pi / 2
        return {**values, 'centre': min(centre, 2.0 * math.pi - centre)}
