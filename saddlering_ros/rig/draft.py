"""A commented rig file, from a rig and the entries that a user states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from saddlering_ros.errors import did_you_mean
from saddlering_ros.rig.description import Rig, rig_from_parameters
from saddlering_ros.rig.digest import FIELDS
from saddlering_ros.rig.errors import RigError

ENTRIES: tuple[tuple[str, str], ...] = (
    ('axial_rows.rollers', 'rollers in the upper row, and as many in the lower one'),
    ('axial_rows.pitch_radius', "m, R: from the ring's axis to the rollers"),
    ('axial_rows.clearance', 'm, mu1: half of it above, half below'),
    ('middle_row.rollers', 'rollers in the radial row'),
    ('middle_row.pitch_radius', 'm'),
    ('middle_row.clearance', 'm, mu2'),
    ('middle_row.height', 'm, h_m: of the radial row over the reference point C'),
    ('carriage.mass', 'kg, of all that the upper ring carries'),
    ('carriage.inertia', 'kg m2, about C, for tilting in the plane of the load'),
    ('carriage.weight', 'N'),
    ('carriage.weight_x', 'm, where the weight acts; to the rear is positive'),
    ('trunnion.x', 'm, x_t: where the load acts, from C to the rear'),
    ('trunnion.y', 'm, y_t: and upwards'),
    ('probes.axial_span', 'm, L: distance of probes 2 (front) and 4 (rear)'),
    ('probes.radial_height', 'm, h_s: probes 1 (rear) and 3 (front) over C'),
    ('probes.polarity', 'of probes 1 to 4; 1: the gap grows as the drawing shows, -1: it shrinks'),
    ('probes.min_range', 'm, the span of the probes'),
    ('probes.max_range', 'm'),
    ('probes.absent', 'radial probe (1 or 3) that the rig does not have; 0: it has all four'),
    ('preload', 'N: at this load displacements are zero'),
    ('full_scale_load', 'N, of the cylinder; every limit of loads is a share of it'),
    ('full_scale_time', 's: a change by full scale in less time is impossible and is refused'),
    ('force_unit', 't or kN: unit in which loads are printed'),
)
"""Every entry of the section `rig` in the order of the file, with its meaning."""

_HEAD = """\
# The rig, read by every node and command. SI units. Compare the drawing with your ring, entry by
# entry: a wrong dimension misfits every channel. Then run `saddlering rig --check BAG --rig FILE`.
/**:
  ros__parameters:
    rig:
"""


def draft_rig_file(rig: Rig, stated: Sequence[str]) -> tuple[str, Rig]:
    """The text of a rig file and the rig that it describes.

    stated: entries as NAME=VALUE, like axial_rows.rollers=48, in place of those of `rig`.
    """
    values = {name: _value(rig, name) for name, _ in ENTRIES}
    given = _stated(stated, values)
    values.update(given)
    lines = []
    section = ''
    for name, words in ENTRIES:
        above, _, key = name.rpartition('.')
        if above and above != section:
            lines.append(f'      {above}:')
        section = above
        number = _plain_exponents(_text(values[name]))
        entry = f'{"        " if above else "      "}{key}: {number}'
        lines.append(f'{entry:<36} # {words}' + ('' if name in given else ' (TO CHECK)'))
    lines.append('    bounds:                  # search range of an identification')
    lines += [_plain_exponents(f'      {name}: [{low!r}, {high!r}]')
              for name, (low, high) in rig.bounds.items()]
    nested: dict[str, Any] = {}
    for name, value in values.items():
        place = nested
        *parents, last = name.split('.')
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value
    described = rig_from_parameters(
        {'rig': nested, 'bounds': {name: list(pair) for name, pair in rig.bounds.items()}},
        'saddlering rig --set')
    return _HEAD + '\n'.join(lines) + '\n', described


def _value(rig: Rig, name: str) -> Any:
    value: Any = rig
    for part in name.split('.'):
        value = getattr(value, FIELDS.get(part, part))
    return [int(sign) for sign in value] if name == 'probes.polarity' else value


def _stated(texts: Sequence[str], known: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition('=')
        name = name.strip().removeprefix('rig.')
        if not equals or name not in known:
            raise RigError(f'--set {text!r}: there is no entry {name!r}'
                           f'{did_you_mean(name, list(known))} (write NAME=VALUE; names: '
                           f'{", ".join(known)})')
        found[name] = _parsed(value.strip(), known[name], text)
    return found


def _parsed(value: str, example: Any, text: str) -> Any:
    try:
        if isinstance(example, list):
            return [int(part) for part in value.strip('[]').split(',')]
        if isinstance(example, str):
            return value
        return int(value) if isinstance(example, int) else float(value)
    except ValueError as problem:
        raise RigError(f'--set {text!r}: give a number, for the polarity four like 1,1,1,-1'
                       ) from problem


def _text(value: Any) -> str:
    return repr(value) if not isinstance(value, str) else value


def _plain_exponents(line: str) -> str:
    """Exponents as YAML 1.1 reads them: 4e-05 as 4.0e-05."""
    import re

    line = re.sub(r'(?<![\d.])(\d+)e([+-]?\d+)', r'\1.0e\2', line)
    return re.sub(r'(\d\.\d+)e(\d)', r'\1e+\2', line)
