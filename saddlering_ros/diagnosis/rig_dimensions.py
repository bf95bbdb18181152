"""What a rig file states as possible causes: dimensions, and instruments with a certificate.

A dimension is an effect whose size is its error. It enters a search only where something is wrong.
Height of the trunnion, clearances and height of the radial probes are effects of the catalogue
already.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.discrepancy import Cause, Effect, Neighbourhood, Parameter, Point, RunBlocks
from saddlering_ros.quantities import lowered
from saddlering_ros.rig import Rig
from saddlering_ros.ring.small_errors import certified_errors, DIMENSIONS

REVERSED = 'rig_polarity'
"""A probe whose sign is reversed. It acts on the readings."""

ENTRIES = {
    'moment_arm': 'rig.trunnion.y', 'axial_clearance': 'rig.axial_rows.clearance',
    'radial_clearance': 'rig.middle_row.clearance', 'probe_height': 'rig.probes.radial_height',
    REVERSED: 'rig.probes.polarity'}
"""Entry of the rig file by the effect that its error would look like."""


def dimension_effects(rig: Rig) -> tuple[Effect, ...]:
    """Every dimension, and the sign of every probe, as an effect."""
    effects = []
    for name, one in DIMENSIONS.items():
        low = max(-one.reach, one.least - one.read(rig))
        effects.append(Effect(
            title_of_dimension(name),
            {'change': Parameter(low, one.reach, unit=one.unit, neutral=0.0)},
            starts=({'change': one.usual}, {'change': max(-one.usual, 0.5 * low)}), id=name))
    effects.append(Effect(
        title_of_dimension(REVERSED), {'reversal': Parameter(0.5, 1.5, start=1.0, neutral=0.0)},
        variants=tuple({'probe': float(number)} for number in rig.probes.present),
        starts=({'reversal': 1.0},), id=REVERSED))
    return tuple(effects)


def title_of_dimension(effect_id: str) -> str:
    """The title of a dimension; '' for other effects."""
    title = changed_title(effect_id)
    if effect_id in DIMENSIONS:
        title = f'Wrong {lowered(title)}'
    return f'{title} in the rig file' if title else ''


def changed_title(effect_id: str) -> str:
    """The title of a dimension that differs between two sessions; '' for other effects."""
    if effect_id == REVERSED:
        return 'Reversed sign of a probe'
    return DIMENSIONS[effect_id].title if effect_id in DIMENSIONS else ''


def entry_of(effect_id: str) -> str:
    """The entry of the rig file whose error an effect is or would look like; '' for others."""
    return (f'rig.{DIMENSIONS[effect_id].entry}' if effect_id in DIMENSIONS else
            ENTRIES.get(effect_id, ''))


def entries_of(rig: Rig, causes: Sequence[Cause]) -> list[str]:
    """Entries of the rig file that would make one of the causes or its alternatives.

    'rig.probes.axial_span (1.25 m in the file, 1.3 m by these data)'
    """
    entries: dict[str, str] = {}
    for cause in causes:
        for name in cause.group:
            entry = entry_of(name)
            if name in DIMENSIONS and name == cause.effect:
                one = DIMENSIONS[name]
                value, change = one.read(rig), cause.parameters['change'].value
                entry += (f' ({value:.4g} {one.unit} in the file, {value + change:.4g} '
                          f'{one.unit} by these data)')
            entries.setdefault(name, entry)
    return [*filter(None, entries.values())]


def has_dimensions(point: Point) -> bool:
    """Whether a point has a dimension or a sign of its own."""
    return any(map(title_of_dimension, point.effects))


def without_dimensions(point: Point) -> Point:
    """The same point on the rig of the file."""
    return Point(point.base, {name: values for name, values in point.effects.items()
                              if not title_of_dimension(name)})


def neighbourhood_by_rig(
    rig: Rig, groups: Sequence[Sequence[Point]],
    prepare: Callable[[Rig, list[list[Point]]], Neighbourhood],
) -> Neighbourhood:
    """Groups of points of which some have another rig: those of one rig are prepared together.

    prepare: the neighbourhood of points on a rig. Signs of the channels act on its readings.
    """
    rigs: dict[tuple[tuple[str, float], ...], dict[int, list[int]]] = {}
    for number, group in enumerate(groups):
        for row, point in enumerate(group):
            key = tuple((name, values['change']) for name, values in point.effects.items()
                        if name in DIMENSIONS)
            rigs.setdefault(key, {}).setdefault(number, []).append(row)
    # For each rig its points, and the group and the rows of each of its groups.
    parts: list[tuple[Neighbourhood, list[tuple[int, list[int]]]]] = []
    for key, places in rigs.items():
        changed = rig
        for name, change in key:
            changed = DIMENSIONS[name].changed(changed, change)
        own = [[without_dimensions(groups[number][row]) for row in rows]
               for number, rows in places.items()]
        parts.append((prepare(changed, own), list(places.items())))
    # Factors (B, C) of each group.
    none = {'probe': 0.0, 'reversal': 0.0}
    signs = [np.array([
        [1.0 - 2.0 * reversed_['reversal'] * (number == reversed_['probe'])
         for number in rig.probes.present]
        for reversed_ in (point.effects.get(REVERSED, none) for point in group)])
        for group in groups]

    def predict(run: RunBlocks) -> list[NDArray[np.float64]]:
        answers = [np.empty((*sign.shape, run.time.size)) for sign in signs]
        for neighbourhood, places in parts:
            for (group, rows), values in zip(places, neighbourhood(run), strict=True):
                answers[group][rows] = values
        return [answer * sign[:, :, None] for answer, sign in zip(answers, signs, strict=True)]

    return predict


def certificate_notes(rig: Rig, causes: Iterable[Cause]) -> list[str]:
    """For each cause on an instrument with a certificate, how far it lies beyond it."""
    notes = []
    for cause in causes:
        stated = [error[cause.effect] for error in certified_errors(rig).values()
                  if cause.effect in error]
        if stated:
            parameter = list(stated[0])[-1]
            uncertainty = max(values[parameter] for values in stated)
            times = abs(cause.parameters[parameter].value) / uncertainty
            notes.append(f'{cause.definition.title} is {times:.1f} times the '
                         f'standard uncertainty of its certificate ({uncertainty:g})')
    return notes


def assumed_notes(rig: Rig) -> list[str]:
    """What is assumed of instruments without a certificate, and how to state it."""
    missing = ', '.join(rig.instruments.not_stated)
    return [f'no certificate states {missing}: they count as exact in an identification, and a '
            'diagnosis may accuse them; give their standard uncertainties as rig.instruments'
            ] if missing else []
