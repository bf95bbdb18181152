"""Effects, their parameters, the tests that separate causes, and shapes that effects share.

The `outcomes` of an effect hold the result of these tests, by their id, if that effect is the
cause: a noun with its clause. A test without an entry has the outcome of most effects.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
from typing import Any, ClassVar

from saddlering_ros.effects.extension import at_probe, Hysteron, OwnParameter, RingExtension, Wear
from saddlering_ros.errors import SaddleringError
from saddlering_ros.quantities import compact
from saddlering_ros.rig import Rig
from saddlering_ros.rig.geometry import size_factor

UNCLEAR = ''
"""The outcome of a test that does not separate an effect from the others."""


@dataclass(frozen=True)
class RigTest:
    """One test: its id, its instruction, and the outcome of effects without an entry."""

    id: str
    instruction: str
    otherwise: str = UNCLEAR


RIG_TESTS = (
    RigTest('second_rate', 'Record a dynamic test at a second loading rate, four times slower.',
            'a misfit that does not depend on the rate'),
    RigTest('repeat_cycle', 'Record two cycles with holds of 30 s at preload and at full load.',
            'the same misfit in both cycles'),
    RigTest('zero_load', 'Record ten minutes at constant preload, at the highest sampling rate.',
            'no misfit at constant preload'),
    RigTest('swapped_probes', 'Swap probes 1 and 3, and probes 2 and 4, and repeat the static '
            'test.', 'a misfit that does not move'),
    RigTest('slewed_ring', 'Slew the ring by 90 deg and repeat the static test.',
            'a misfit that does not change'),
    RigTest('other_elevation', 'Repeat the static test at another elevation.'),
    RigTest('reference_load', 'Put a calibrated load cell in line with the cylinder and repeat '
            'the static test.', 'a load that agrees with the reference'),
    RigTest('inclinometer', 'Put an inclinometer on the loading axis and repeat the static test.',
            'an angle as recorded'),
    RigTest('pull_push', 'Pull and push the ring slowly through zero load.',
            'no unexpected jump at zero load'),
    RigTest('heights', 'Measure the heights of the loading axis and of probes 1 and 3 over the '
            'mid-plane of the ring.', 'heights as in the rig file'),
    RigTest('other_gap', 'Set the gap of the probe wider at zero load and repeat the static test.',
            'the same misfit'))
"""Order of preference among tests that separate as much."""


class EffectError(SaddleringError):
    """An effect or one of its parameters does not exist or is out of its bounds."""


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: SI unit, bounds, `scale` (a typical size on a real rig), start value.

    one_sided: physics fixes the sign. amplitude: the effect vanishes if this parameter is
    `neutral`; the other parameters only shape it. The first parameter of an effect is an
    amplitude. logarithmic: searched on a log scale (low > 0), for instance time constants.
    limiting_case: values of a shape at which the effect is another one or none: a cause whose
    interval includes such a value is not established. whole: the bound of a size that nature sets,
    such as a share of 1: a cause of this size can be established. adds_to: the extension parameter
    to which it is added, if that is all that it does; the name of one that effects share, or one
    of its own.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    start: float
    words: str
    amplitude: bool = False
    one_sided: bool = False
    neutral: float = 0.0
    logarithmic: bool = False
    limiting_case: tuple[float, ...] = ()
    whole: float | None = None
    adds_to: str | OwnParameter = ''

    def sized_for(self, rig: Rig) -> 'EffectParameter':
        """The same with bounds, typical size and start of a rig."""
        factor = size_factor(self.unit, rig)
        if factor == 1.0:
            return self
        return replace(
            self, low=factor * self.low, high=factor * self.high, scale=factor * self.scale,
            start=factor * self.start, neutral=factor * self.neutral,
            limiting_case=tuple(factor * value for value in self.limiting_case))


@dataclass(frozen=True)
class Variant:
    """A discrete choice inside one effect (which probe, which row): fixed values and a label.

    channels: where this choice shows, if not in all channels of the effect. frees: parameters
    with a meaning in this choice alone, for instance one size for each coordinate. contains:
    effects that this choice can imitate completely, so that it is no alternative to them.
    """

    label: str
    values: Mapping[str, float]
    channels: tuple[str, ...] = ()
    frees: tuple[str, ...] = ()
    contains: tuple[str, ...] = ()


@dataclass(frozen=True)
class Choice:
    """A parameter that is chosen and not fitted: its values in order of the variants, in words."""

    name: str
    values: tuple[float, ...]
    words: str


class RingEffect:
    """One cause of a difference between measurement and simulation; one subclass, one file.

    A subclass states the class attributes; a walk of the folder finds it. Its id is the name of
    its file. What it does is stated by its parameters (`adds_to`), or by its own `extend`.
    is_searched: whether a diagnosis looks for it; else it stands in parameter files only.
    starts: first guesses for effects that need several (searched places, times); a missing name
    takes the start of its parameter. The first variant is the default. channels: in which the
    cause shows, by default in every coordinate of the motion.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    words: ClassVar[str]
    settled_by: ClassVar[str]
    outcomes: ClassVar[Mapping[str, str]] = {}
    stage: ClassVar[str]                      # one of STAGES
    channels: ClassVar[tuple[str, ...]] = ('delta_x', 'delta_y', 'gamma')  # and parity
    parameters: ClassVar[tuple[EffectParameter, ...]]
    variants: ClassVar[tuple[Variant, ...]] = (Variant('', {}),)
    choices: ClassVar[tuple[Choice, ...]] = ()
    starts: ClassVar[tuple[Mapping[str, float], ...]] = ()
    dynamic_only: ClassVar[bool] = False
    is_searched: ClassVar[bool] = True
    line: ClassVar[bool] = False              # a steady line, at rest too
    form: ClassVar[float] = 0.0               # share of the size that its idealised law may err

    def __init_subclass__(cls) -> None:
        cls.id = cls.__module__.rpartition('.')[2]

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """The extension with this effect added; `values` holds every parameter and choice.

        What belongs to one of the four probes is added at the probe chosen. Parameters that only
        another variant frees are not added.
        """
        idle = {name for one in self.variants for name in one.frees
                if any(values[key] != value for key, value in one.values.items())}
        changed: dict[str, Any] = {}
        for item in self.parameters:
            if item.name not in values or item.name in idle:
                continue
            if isinstance(item.adds_to, OwnParameter):
                extension = item.adds_to.add(extension, values[item.name])
            elif item.adds_to:
                before, value = getattr(extension, item.adds_to), values[item.name]
                changed[item.adds_to] = (at_probe(before, round(values['probe']), value)
                                         if isinstance(before, tuple) else before + value)
        return replace(extension, **changed)

    def slewed(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values after the ring is turned by a quarter; the same where nothing turns with it."""
        return dict(values)

    def parameters_on(self, rig: Rig | None) -> tuple[EffectParameter, ...]:
        """All parameters with the bounds of a rig; None: the rig of the catalogue."""
        if rig is None:
            return self.parameters
        return tuple(item.sized_for(rig) for item in self.parameters)

    def parameters_of(self, variant: Variant,
                      rig: Rig | None = None) -> tuple[EffectParameter, ...]:
        """Parameters with a meaning in one of the variants."""
        others = {name for item in self.variants for name in item.frees} - set(variant.frees)
        return tuple(item for item in self.parameters_on(rig) if item.name not in others)

    def complete(self, values: Mapping[str, float], rig: Rig | None = None) -> dict[str, float]:
        """`values` with start values for missing ones.

        EffectError for a name that does not exist, a number out of bounds or a choice not offered.
        """
        parameters = self.parameters_on(rig)
        known = {parameter.name: parameter.start for parameter in parameters}
        known.update(self.variants[0].values)
        for name in values:
            if name not in known:
                raise EffectError(f'effects.{self.id}.{name} does not exist: '
                                  f'choose from {", ".join(known)}')
        complete = {**known, **values}
        for parameter in parameters:
            value = complete[parameter.name]
            slack = 1e-9 * (parameter.high - parameter.low)
            if not parameter.low - slack <= value <= parameter.high + slack:
                unit = '' if parameter.unit == '1' else f' {parameter.unit}'
                raise EffectError(
                    f'effects.{self.id}.{parameter.name} is {compact(value)}: give a number from '
                    f'{compact(parameter.low)} to {compact(parameter.high)}{unit}')
        for choice in self.choices:
            if complete[choice.name] not in choice.values:
                offered = ', '.join(f'{value:g}' for value in choice.values)
                raise EffectError(f'effects.{self.id}.{choice.name} is {complete[choice.name]:g}: '
                                  f'choose from {offered} ({choice.words})')
        return complete


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


class FrictionEffect(RingEffect):
    """A friction element of `RingExtension`, of the height of the first parameter."""

    element: ClassVar[str]
    outcomes: ClassVar[Mapping[str, str]] = {
        'second_rate': 'a loop of the same height',
        'repeat_cycle': 'a loop that repeats and stays open during the holds',
        'pull_push': UNCLEAR}

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

    @staticmethod
    def waves(values: Mapping[str, float]) -> tuple[float, ...]:
        """Waves [m] of a row with one and with two maxima."""
        turn = 2.0 * values['angle']
        return 0.0, 0.0, values['amplitude'] * math.cos(turn), values['amplitude'] * math.sin(turn)


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
        for probe in (1, 2, 3, 4))


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
    choices: ClassVar[tuple[Choice, ...]] = (KIND,)
    form = 0.2  # worn arcs end softly, and no two rollers on them alike
    # The load zone at the rear (not at 0, where a mirror image hides the influence of the centre),
    # the place between and the load zone at the front, to show where an arc is not visible.
    starts = ({'centre': 0.15, 'half_width': 0.4}, {'centre': 0.8, 'half_width': 0.4},
              {'centre': 0.4, 'half_width': 1.0}, {'centre': 1.6}, {'centre': 2.7})

    def slewed(self, values: Mapping[str, float]) -> dict[str, float]:
        centre = values['centre'] + math.pi / 2
        return {**values, 'centre': min(centre, 2.0 * math.pi - centre)}
