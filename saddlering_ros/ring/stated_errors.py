"""Dimensions of a rig file, and the errors of instruments and dimensions that certificates state.

An error is a size of effects of the catalogue or of dimensions, by their ids: an identification
and a diagnosis simulate the same one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from saddlering_ros.effects.extension import at_probe, NO_EXTENSION, RingExtension
from saddlering_ros.rig import Rig
from saddlering_ros.rig.description import place_of

SmallError = Mapping[str, Mapping[str, float]]
"""Sizes by parameter, by the id of an effect or a dimension."""


@dataclass(frozen=True)
class Dimension:
    """An entry of the rig file.

    usual: an error [unit] that a wrong drawing would give; reach: the largest that is searched;
    least: the smallest possible value.
    """

    entry: str
    title: str
    unit: str
    usual: float
    reach: float
    least: float = -np.inf

    def read(self, rig: Rig) -> float:
        part, field = place_of(self.entry)
        return float(getattr(getattr(rig, part), field))

    def changed(self, rig: Rig, change: float) -> Rig:
        """The rig with another value of the entry."""
        part, field = place_of(self.entry)
        return rig.changed(part, field, change)


DIMENSIONS: Mapping[str, Dimension] = {
    'rig_weight': Dimension('carriage.weight', 'Weight', 'N', 8e3, 1e5, 0.0),
    'rig_weight_x': Dimension('carriage.weight_x', 'Place of the weight', 'm', 0.05, 1.0),
    'rig_trunnion_x': Dimension('trunnion.x', 'trunnion.x', 'm', 0.05, 0.5),
    'rig_axial_span': Dimension(
        'probes.axial_span', 'Span of the axial probes', 'm', 0.03, 0.6, 0.1),
    'rig_axial_radius': Dimension(
        'axial_rows.pitch_radius', 'Pitch radius of the axial rows', 'm', 0.02, 0.3, 0.1),
    'rig_radial_row_height': Dimension(
        'middle_row.height', 'Height of the radial row', 'm', 0.02, 0.3)}
"""By the id of the effect."""

ROWS: Mapping[str, tuple[str, ...]] = {
    'axial_clearance': ('upper_row', 'lower_row'), 'radial_clearance': ('radial_row',)}
"""Rows of which an effect changes the clearance."""

CERTIFIED = {
    'load_gain': ('load_gain', 'load_gain', 'gain'),
    'load_offset': ('load_offset', 'load_offset', 'offset'),
    'load_nonlinearity': ('load_nonlinearity', 'load_nonlinearity', 'curvature'),
    'elevation': ('elevation', 'elevation_error', 'angle'),
    'probe_lag': ('probe_lag', 'probe_lag', 'time'), 'clock': ('clock', 'clock_offset', 'offset'),
    'clearance_axial': ('clearance', 'axial_clearance', 'change'),
    'clearance_radial': ('clearance', 'radial_clearance', 'change'),
    'weight': ('weight', 'rig_weight', 'change'),
    'trunnion_x': ('trunnion', 'rig_trunnion_x', 'change'),
    'trunnion_y': ('trunnion', 'moment_arm', 'offset'),
    'axial_span': ('axial_span', 'rig_axial_span', 'change'),
    'radial_height': ('radial_height', 'probe_height', 'height'),
    'probe_gain': ('probe_gain', 'probe_gain', 'gain'),
    'probe_nonlinearity': ('probe_nonlinearity', 'probe_nonlinearity', 'curvature')}
"""Entry of rig.instruments, effect or dimension, and its parameter, by source in a budget."""


def certified_errors(rig: Rig) -> dict[str, SmallError]:
    """One standard uncertainty of each instrument and dimension that a certificate states.

    By source in a budget. The size comes last, after the number of a probe.
    """
    errors: dict[str, SmallError] = {}
    for source, (entry, effect_id, parameter) in CERTIFIED.items():
        stated = getattr(rig.instruments, entry)
        if stated is None:
            continue
        if entry in ('probe_gain', 'probe_nonlinearity'):
            sizes = np.broadcast_to(stated, 4).tolist()
            for number in rig.probes.present:
                errors[f'{source}_{number}'] = {
                    effect_id: {'probe': float(number), parameter: sizes[number - 1]}}
        else:
            size = stated * rig.carriage.weight if entry == 'weight' else stated
            errors[source] = {effect_id: {parameter: size}}
    return errors


def with_error(rig: Rig, error: SmallError) -> tuple[Rig, RingExtension]:
    """The rig with the dimensions of an error, and the extension by its effects.

    The extension has a field for each of these effects, so that a catalogue may lack them.
    """
    changed: dict[str, Any] = {}
    for name, values in error.items():
        size = [*values.values()][-1]
        if name in DIMENSIONS:
            rig = DIMENSIONS[name].changed(rig, size)
        elif name in ROWS:
            changed |= {row: replace(getattr(NO_EXTENSION, row), gap=0.5 * size)
                        for row in ROWS[name]}
        else:
            field = getattr(NO_EXTENSION, name)
            changed[name] = at_probe(
                field, round(values.get('probe', 0.0)), size) if isinstance(field, tuple) else size
    return rig, replace(NO_EXTENSION, **changed)
