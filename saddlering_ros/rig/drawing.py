"""The drawing of a rig in the plane of the load, and the draft of a commented rig file."""

from collections.abc import Mapping, Sequence
import io
import math
from operator import attrgetter
from pathlib import Path
import re
from typing import Any, TextIO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
import yaml

from saddlering_ros.errors import did_you_mean
from saddlering_ros.files import whole_file
from saddlering_ros.plain_yaml import parse_strict_yaml
from saddlering_ros.rig.description import place_of, Rig, rig_from_parameters, short_digest
from saddlering_ros.rig.parameter_file import plain_exponents, RigError, unfold

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEEL, FIXED, ROLLER, PROBE = '#c6d4e3', '#d9d5cc', '#666666', '#0072B2'
LOAD, SIGN, MEASURE = '#D55E00', '#222222', '#777777'
DRAWN_ELEVATION_DEG = 50.0  # of most shipped tests

Floats = tuple[float, float] | NDArray[np.float64]


def save_drawing(path: Path | str, rig: Rig, elevation_deg: float = DRAWN_ELEVATION_DEG) -> None:
    """Write the drawing of a rig as SVG, PNG or PDF, by the suffix."""
    kind = Path(path).suffix.lower().lstrip('.')
    if kind not in ('svg', 'png', 'pdf'):
        raise RigError(f'{path}: this kind of drawing is not supported: give a name that ends in '
                       '.svg, .png, .pdf')
    with whole_file(path, RigError) as temporary:
        _save(rig, elevation_deg, temporary, kind)


def drawing_svg(rig: Rig, elevation_deg: float = DRAWN_ELEVATION_DEG) -> str:
    """The drawing as the text of an SVG element, for a page."""
    text = io.StringIO()
    _save(rig, elevation_deg, text, 'svg')
    svg = text.getvalue()[text.getvalue().index('<svg'):]
    return re.sub(r'width="[^"]*" height="[^"]*"', 'width="100%"', svg, count=1)


def _save(rig: Rig, elevation_deg: float, place: Path | TextIO, kind: str) -> None:
    """Draw and save; equal rigs give equal files, and their text is text."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 6.4))
    axes = figure.add_axes((0.01, 0.12, 0.98, 0.82))
    axes.set_title('In the plane of the load; the arrows at the probes show where the gap grows',
                   fontsize=10)
    # Lengths are in units of the pitch radius of the axial rows.
    reach = max(1.62, rig.probes.axial_span / 2.0 / rig.axial_rows.pitch_radius + 0.42)
    _draw_ring(axes, rig, elevation_deg, reach)
    probes, radius = rig.probes, rig.axial_rows.pitch_radius
    level = max(-0.6, min(0.6, probes.radial_height / radius)) - 0.42
    for number, sign in enumerate(probes.polarity, 1):
        if number == probes.absent:
            continue
        side = 1.0 if number in (1, 4) else -1.0
        if number in (1, 3):
            face = np.array([side * (reach - 0.05 * sign), level])
            grows, aside = np.array([side * sign, 0.0]), np.array([0.0, -0.15])
        else:
            face = np.array([side * probes.axial_span / 2.0 / radius, 0.42 - 0.08 * sign])
            grows, aside = np.array([0.0, sign]), np.array([side * 0.12, 0.0])
        half_width = 0.04 * grows[::-1]
        _box(axes, face - 0.1 * grows - half_width, face - 0.3 * grows + half_width, PROBE)
        _arrow(axes, face + aside, face + aside + 0.3 * grows, PROBE)
        x, y = face + aside + 0.45 * grows
        _text(axes, x, y, f'{number} ({"+" if sign > 0 else "−"})', PROBE, fontsize=11,
              weight='bold')
    axes.set(xlim=(-reach - 0.75, reach + 0.75), aspect='equal',
             ylim=(-1.35, max(1.15, rig.trunnion.y / rig.axial_rows.pitch_radius + 1.05)))
    axes.axis('off')
    rows, middle, probes = rig.axial_rows, rig.radial_row, rig.probes
    figure.text(0.03, 0.02, (
        f'axial: 2 x {rows.rollers} rollers, R = {rows.pitch_radius:g} m, clearance '
        f'{rows.clearance * 1e6:g} µm; radial: {middle.rollers}, R = {middle.pitch_radius:g} m, '
        f'clearance {middle.clearance * 1e6:g} µm, height {middle.height:g} m\n'
        f'full scale {rig.force_words(rig.full_scale_load, 1)}, preload '
        f'{rig.force_words(rig.preload, 2)}; {rig.carriage.mass:g} kg; probes: h_s = '
        f'{probes.radial_height:g} m, range {probes.min_range * 1e3:g} to '
        f'{probes.max_range * 1e3:g} mm, {f"number {probes.absent}" if probes.absent else "none"} '
        f'absent\nrig hash {short_digest(rig.digest)}'), fontsize=8.5)
    with rc_context({'svg.fonttype': 'none', 'svg.hashsalt': 'rig'}):
        figure.savefig(place, format=kind, dpi=130,
                       metadata={'Date': None} if kind == 'svg' else None)


def _box(axes: 'Axes', corner: Floats, opposite: Floats, colour: str, hatch: str = '') -> None:
    xs, ys = zip(corner, opposite, strict=True)
    axes.fill([xs[0], xs[1], xs[1], xs[0]], [ys[0], ys[0], ys[1], ys[1]], facecolor=colour,
              hatch=hatch, edgecolor='#666666', linewidth=0.8)


def _arrow(axes: 'Axes', start: Floats, stop: Floats, colour: str, width: float = 1.6,
           **style: Any) -> None:
    axes.annotate('', (stop[0], stop[1]), (start[0], start[1]), arrowprops={
        'arrowstyle': '-|>', 'color': colour, 'linewidth': width, 'shrinkA': 0, 'shrinkB': 0,
        'mutation_scale': 13, **style})


def _text(axes: 'Axes', x: float, y: float, text: str, colour: str = SIGN, **style: Any) -> None:
    axes.text(x, y, text, color=colour, va='center', **{'ha': 'center', 'fontsize': 8.5, **style})


def _draw_ring(axes: 'Axes', rig: Rig, degrees: float, reach: float) -> None:
    """The fixed ring below, the upper ring, the rows of rollers, the load, and the dimensions."""
    _box(axes, (-reach - 0.35, -0.98), (reach + 0.35, -0.82), FIXED, '///')
    _box(axes, (-reach, 0.34), (reach, 0.5), STEEL)
    for side in (-1.0, 1.0):
        _box(axes, (side - 0.09, -0.82), (side + 0.09, 0.2), FIXED, '///')
        _box(axes, (side * 1.14, -0.34), (side * 1.42, 0.34), STEEL)
        _box(axes, (side * reach - 0.05, -0.62), (side * reach + 0.05, 0.34), STEEL)
        for x, y in ((0.98, 0.26), (0.98, -0.26), (1.115, 0.0)):
            _box(axes, (side * x - 0.04, y - 0.045), (side * x + 0.04, y + 0.045), ROLLER)
    _text(axes, -reach - 0.3, -1.1, 'front: lower ring and carriage, fixed', ha='left')
    _text(axes, reach + 0.3, -1.1, 'rear', ha='right')
    _text(axes, 0.0, 0.42, 'upper ring and carriage')
    _arrow(axes, (0.0, 0.0), (0.5, 0.0), SIGN)
    _arrow(axes, (0.0, 0.0), (0.0, 0.3), SIGN)
    _arrow(axes, (-0.3, -0.24), (0.3, -0.24), SIGN, 1.4, connectionstyle='arc3,rad=-0.45')
    _text(axes, -0.09, -0.02, 'C', weight='bold')
    _text(axes, 0.56, -0.16, 'x, δx\nto the rear')
    _text(axes, 0.06, 0.24, 'y, δy', ha='left')
    _text(axes, 0.0, -0.34, 'γ: the rear goes down')
    radius, trunnion = rig.axial_rows.pitch_radius, rig.trunnion
    x, y, right = trunnion.x / radius, trunnion.y / radius, reach + 0.3
    span, weight = rig.probes.axial_span / 2.0 / radius, rig.carriage.weight_x / radius + 0.42
    angle = math.radians(degrees)
    axes.plot([-0.25, x, 0.25], [0.5, y, 0.5], color='#999999', linewidth=1.2, zorder=0)
    _arrow(axes, (x - math.cos(angle), y + math.sin(angle)), (x, y), LOAD, 2.4)
    _text(axes, x - math.cos(angle) - 0.06, y + math.sin(angle),
          f'load P > 0\nat {degrees:g}° elevation', LOAD, ha='right')
    _text(axes, x + 0.1, y + 0.06, f'trunnion, x_t = {trunnion.x:g} m', LOAD, ha='left')
    _arrow(axes, (weight, 0.84), (weight, 0.54), MEASURE)
    _text(axes, weight + 0.05, 0.72, f'W, x = {rig.carriage.weight_x:g} m', MEASURE, ha='left')
    for start, stop in (((-span, 0.98), (span, 0.98)), ((0.0, -1.22), (1.0, -1.22)),
                        ((right, 0.0), (right, y))):
        _arrow(axes, start, stop, MEASURE, 0.9, arrowstyle='<|-|>')
    _text(axes, -0.5 * span, 1.06, f'L = {rig.probes.axial_span:g} m')
    _text(axes, 0.5, -1.3, f'R = {radius:g} m')
    _text(axes, right + 0.08, y / 2, f'y_t = {trunnion.y:g} m', rotation=90)


ENTRIES: tuple[tuple[str, str], ...] = (
    ('axial_rows.rollers', 'rollers in the upper row, and as many in the lower one'),
    ('axial_rows.pitch_radius', "m, R: from the ring's axis to the rollers"),
    ('axial_rows.clearance', 'm, mu1: half of it above, half below'),
    ('middle_row.rollers', 'rollers in the radial row'),
    ('middle_row.pitch_radius', "m: from the ring's axis to its rollers"),
    ('middle_row.clearance', 'm, mu2'),
    ('middle_row.height', 'm, h_m: of the radial row over the reference point C'),
    ('carriage.mass', 'kg, of the slewing parts: all that the upper ring carries'),
    ('carriage.inertia', 'kg m2, about C, for tilting in the plane of the load'),
    ('carriage.weight', 'N, dead weight of the slewing parts'),
    ('carriage.weight_x', 'm, where the weight acts, from C; to the rear is positive'),
    ('trunnion.x', 'm, x_t: where the load acts, from C to the rear'),
    ('trunnion.y', 'm, y_t: where the load acts, from C upwards'),
    ('probes.axial_span', 'm, L: distance of probes 2 (front) and 4 (rear)'),
    ('probes.radial_height', 'm, h_s: probes 1 (rear) and 3 (front) over C'),
    ('probes.polarity', 'of probes 1 to 4; 1: the gap grows as the drawing shows, -1: it shrinks'),
    ('probes.min_range', 'm, the smallest gap that a probe reads'),
    ('probes.max_range', 'm, the largest gap that a probe reads'),
    ('probes.absent', 'radial probe (1 or 3) that the rig does not have; 0: it has all four'),
    ('preload', 'N: at this load displacements are zero'),
    ('full_scale_load', 'N, of the cylinder; every limit of loads is a share of it'),
    ('full_scale_time', 's: a change by full scale in less time is impossible and is refused'),
    ('force_unit', 't or kN: unit in which loads are printed'))
"""Every entry of the section `rig` in the order of the file, with its meaning."""

_HEAD = """\
# The rig, read by every node and command. SI units. Compare the drawing with your ring, entry by
# entry: a wrong dimension misfits every channel. Then run `saddlering rig --check BAG --rig FILE`.
/**:
  ros__parameters:
    rig:
"""


def entry_values(rig: Rig) -> dict[str, Any]:
    """The value of every entry, as a rig file states it."""
    values = {name: attrgetter('.'.join(place_of(name)))(rig) for name, _ in ENTRIES}
    return values | {'probes.polarity': [int(sign) for sign in rig.probes.polarity]}


def dotted(rig: Rig, values: Mapping[str, Any]) -> dict[str, Any]:
    """Entries beside the bounds of a rig, by the names that parameters of a node have."""
    return {**{f'rig.{name}': value for name, value in values.items()},
            **{f'bounds.{name}': list(pair) for name, pair in rig.bounds.items()}}


def draft_rig_file(rig: Rig, stated: Sequence[str]) -> tuple[str, Rig]:
    """Text of a rig file, and its rig; stated: entries NAME=VALUE in place of those of `rig`."""
    values = entry_values(rig)
    given = set()
    for text in stated:
        name, equals, value = text.partition('=')
        name = name.strip().removeprefix('rig.')
        if not equals or name not in values:
            raise RigError(f'--set {text!r}: there is no entry {name!r}'
                           f'{did_you_mean(name, list(values))} (write NAME=VALUE; names: '
                           f'{", ".join(values)})')
        try:
            values[name] = parse_strict_yaml(f'[{value.strip("[] ")}]' if ',' in value else value)
        except yaml.YAMLError as problem:
            raise RigError(f'--set {text!r}: give a number, for the polarity four like 1,1,1,-1'
                           ) from problem
        given.add(name)
    lines = []
    section = ''
    for name, words in ENTRIES:
        above, _, key = name.rpartition('.')
        if above and above != section:
            lines.append(f'      {above}:')
        section = above
        entry = f'{"        " if above else "      "}{key}: {plain_exponents(str(values[name]))}'
        lines.append(f'{entry:<36} # {words}' + ('' if name in given else ' (TO CHECK)'))
    lines.append('    bounds:                  # search range of an identification')
    lines += [plain_exponents(f'      {name}: [{low!r}, {high!r}]')
              for name, (low, high) in rig.bounds.items()]
    described = rig_from_parameters(unfold(dotted(rig, values), '--set', RigError), '--set')
    return _HEAD + '\n'.join(lines) + '\n', described
