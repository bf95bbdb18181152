"""The drawing of a rig in the plane of the load, and the draft of a commented rig file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from pathlib import Path
import re
from typing import Any

from saddlering_ros.errors import did_you_mean, plain_number, whole_number
from saddlering_ros.files import whole_file
from saddlering_ros.rig.description import FIELDS, Rig, rig_from_parameters, short_digest
from saddlering_ros.rig.ros_yaml import plain_exponents, RigError

STEEL, FIXED, PROBE, LOAD, SIGN = '#c6d4e3', '#d9d5cc', '#0072B2', '#D55E00', '#222222'
DRAWN_ELEVATION_DEG = 50.0
SUFFIXES = ('.svg', '.png', '.pdf')


def save_drawing(path: Path | str, rig: Rig, elevation_deg: float = DRAWN_ELEVATION_DEG) -> None:
    """Write the drawing of a rig as SVG, PNG or PDF, by the suffix."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise RigError(f'{path}: this kind of drawing is not supported: give a name that ends in '
                       f'{", ".join(SUFFIXES)}')
    with whole_file(path, RigError) as temporary:
        _save(rig_figure(rig, elevation_deg), temporary, path.suffix.lower().lstrip('.'))


def drawing_svg(rig: Rig, elevation_deg: float = DRAWN_ELEVATION_DEG) -> str:
    """The drawing as the text of an SVG element, for a page."""
    from io import StringIO

    text = StringIO()
    _save(rig_figure(rig, elevation_deg), text, 'svg')
    svg = text.getvalue()[text.getvalue().index('<svg'):]
    return re.sub(r'width="[^"]*" height="[^"]*"', 'width="100%"', svg, count=1)


def _save(figure: Any, place: Any, kind: str) -> None:
    """Save a figure; equal drawings as equal files, and their text as text."""
    from matplotlib import rc_context

    with rc_context({'svg.fonttype': 'none', 'svg.hashsalt': 'rig'}):
        figure.savefig(place, format=kind, dpi=130,
                       metadata={'Date': None} if kind == 'svg' else None)


def rig_figure(rig: Rig, elevation_deg: float = DRAWN_ELEVATION_DEG) -> Any:
    """The drawing as a matplotlib figure, the load at `elevation_deg`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 6.4))
    side = figure.add_axes((0.01, 0.02, 0.66, 0.9))
    above = figure.add_axes((0.69, 0.42, 0.3, 0.5))
    words = figure.add_axes((0.69, 0.02, 0.3, 0.38))
    _Side(side, rig).draw(elevation_deg)
    _draw_from_above(above, rig)
    _write_words(words, rig)
    side.set_title('In the plane of the load; the arrows at the probes show where the gap grows',
                   fontsize=10, loc='left', x=0.03)
    above.set_title('From above', fontsize=10, loc='left')
    return figure


class _Side:
    """The view from the side, in units of the axial rows' pitch radius."""

    def __init__(self, axes: Any, rig: Rig) -> None:
        self.axes = axes
        self.rig = rig
        self.radius = rig.axial_rows.pitch_radius
        self.half_span = rig.probes.axial_span / 2.0 / self.radius
        self.reach = max(1.62, self.half_span + 0.42)
        self.probe_height = max(-0.6, min(0.6, rig.probes.radial_height / self.radius))

    def draw(self, elevation_deg: float) -> None:
        """Everything that is seen from the side."""
        self._rings()
        self._probes()
        self._signs()
        self._load(math.radians(elevation_deg), elevation_deg)
        self._dimensions()
        top = max(1.15, self._trunnion()[1] + 1.05)
        self.axes.set_xlim(-self.reach - 0.75, self.reach + 0.75)
        self.axes.set_ylim(-1.35, top)
        self.axes.set_aspect('equal')
        self.axes.axis('off')

    def _box(self, x: float, y: float, width: float, height: float, colour: str,
             hatch: str = '') -> None:
        from matplotlib.patches import Rectangle

        self.axes.add_patch(Rectangle((x, y), width, height, facecolor=colour, hatch=hatch,
                                      edgecolor='#666666', linewidth=0.8))

    def _arrow(self, start: tuple[float, float], stop: tuple[float, float], colour: str,
               width: float = 1.6, style: str = '-|>') -> None:
        self.axes.annotate('', stop, start, arrowprops={
            'arrowstyle': style, 'color': colour, 'linewidth': width, 'shrinkA': 0, 'shrinkB': 0,
            'mutation_scale': 13})

    def _text(self, x: float, y: float, text: str, colour: str = SIGN, size: float = 9.0,
              **options: Any) -> None:
        options.setdefault('ha', 'center')
        options.setdefault('va', 'center')
        self.axes.text(x, y, text, color=colour, fontsize=size, **options)

    def _rings(self) -> None:
        """The lower ring fixed below, the upper ring with its targets, three rows of rollers."""
        reach = self.reach
        self._box(-reach - 0.35, -0.98, 2 * reach + 0.7, 0.16, FIXED, '///')
        self._text(-reach - 0.3, -1.1, 'lower ring and carriage, fixed', size=8.5, ha='left')
        for side in (-1.0, 1.0):
            self._box(side - 0.09, -0.82, 0.18, 1.02, FIXED, '///')
            inner, outer = side * 1.14, side * 1.42
            self._box(min(inner, outer), -0.34, 0.28, 0.68, STEEL)
            for height, colour in ((0.26, '#888888'), (-0.26, '#888888')):
                self._box(side * 0.98 - 0.045, height - 0.045, 0.09, 0.09, colour)
            self._box(side * 1.115 - 0.035, -0.05, 0.07, 0.1, '#444444')
        self._box(-reach, 0.34, 2 * reach, 0.16, STEEL)
        for side in (-1.0, 1.0):
            self._box(side * reach - 0.05, -0.62, 0.1, 0.96, STEEL)
        self._text(0.0, 0.42, 'upper ring and carriage', size=8.5)

    def _probes(self) -> None:
        polarity = self.rig.probes.polarity
        for number, side in ((1, 1.0), (3, -1.0)):
            if number != self.rig.probes.absent:
                self._radial_probe(number, side, polarity[number - 1])
        for number, side in ((2, -1.0), (4, 1.0)):
            self._axial_probe(number, side, polarity[number - 1])

    def _radial_probe(self, number: int, side: float, polarity: float) -> None:
        """Inside of its target with polarity 1: the gap grows as the ring goes its way."""
        face = side * (self.reach - 0.05 * polarity)
        away = -side * polarity
        height = self.probe_height - 0.42
        body = face + away * 0.1
        tail = body + away * 0.2
        self._box(min(body, tail), height - 0.04, 0.2, 0.08, PROBE)
        self._arrow((face, height - 0.15), (face - away * 0.3, height - 0.15), PROBE)
        self.axes.plot([side, tail], [height, height], color='#666666', linewidth=2.5, zorder=0)
        self._label(number, polarity, face - away * 0.18, height - 0.29)

    def _axial_probe(self, number: int, side: float, polarity: float) -> None:
        """Below the upper ring with polarity 1: the gap grows as its side rises."""
        x = side * self.half_span
        face = 0.34 if polarity > 0 else 0.5
        body = face - polarity * 0.09
        tail = body - polarity * 0.2
        self._box(x - 0.04, min(body, tail), 0.08, 0.2, PROBE)
        self._arrow((x + side * 0.12, face), (x + side * 0.12, face + polarity * 0.3), PROBE)
        self._label(number, polarity, x + side * 0.12, face + polarity * 0.4)

    def _label(self, number: int, polarity: float, x: float, y: float) -> None:
        sign = '+' if polarity > 0 else '−'
        self._text(x, y, f'{number} ({sign})', PROBE, 11, weight='bold')

    def _signs(self) -> None:
        self._arrow((0.0, 0.0), (0.5, 0.0), SIGN)
        self._arrow((0.0, -0.001), (0.0, 0.3), SIGN)
        self.axes.plot([0.0], [0.0], 'o', color=SIGN, markersize=4)
        self._text(-0.09, -0.02, 'C', weight='bold')
        self._text(0.56, -0.09, 'x, δx\nto the rear', size=8.5, va='top', ha='center')
        self._text(0.06, 0.24, 'y, δy', size=8.5, ha='left')
        from matplotlib.patches import FancyArrowPatch

        self.axes.add_patch(FancyArrowPatch(
            (-0.3, -0.24), (0.3, -0.24), connectionstyle='arc3,rad=-0.45', arrowstyle='-|>',
            mutation_scale=12, color=SIGN, linewidth=1.4))
        self._text(0.0, -0.3, 'γ: the rear goes down', size=8.5, va='top')
        self._text(self.reach + 0.4, -0.72, 'rear', size=9, style='italic')
        self._text(-self.reach - 0.42, -0.72, 'front', size=9, style='italic')

    def _trunnion(self) -> tuple[float, float]:
        trunnion = self.rig.trunnion
        return trunnion.x / self.radius, trunnion.y / self.radius

    def _load(self, elevation: float, degrees: float) -> None:
        x, y = self._trunnion()
        back = (x - 1.0 * math.cos(elevation), y + 1.0 * math.sin(elevation))
        self.axes.plot([-0.25, x, 0.25], [0.5, y, 0.5], color='#999999', linewidth=1.2, zorder=0)
        self._arrow(back, (x, y), LOAD, 2.4)
        self.axes.plot([x], [y], 'o', color=LOAD, markersize=6)
        self._text(back[0] - 0.06, back[1], f'load P > 0\nat {degrees:g}° elevation', LOAD, 9.5,
                   ha='right')
        self._text(x + 0.1, y + 0.04, 'trunnion', LOAD, 9, ha='left')
        weight = self.rig.carriage.weight_x / self.radius
        self._arrow((weight + 0.42, 0.84), (weight + 0.42, 0.54), '#555555', 1.6)
        self._text(weight + 0.47, 0.72, f'W, x = {self.rig.carriage.weight_x:g} m', '#555555',
                   8.5, ha='left')

    def _dimensions(self) -> None:
        x, y = self._trunnion()
        right = self.reach + 0.3
        self._measure((right, 0.0), (right, y), f'y_t = {self.rig.trunnion.y:g} m')
        self.axes.plot([x + 0.05, right], [y, y], color='#bbbbbb', linewidth=0.7, zorder=0)
        self.axes.plot([0.6, right], [0.0, 0.0], color='#bbbbbb', linewidth=0.7, zorder=0)
        span, level = self.half_span, 0.98
        for side in (-1.0, 1.0):
            self.axes.plot([side * span] * 2, [0.5, level + 0.04], color='#bbbbbb',
                           linewidth=0.7, zorder=0)
        self._measure((-span, level), (span, level), '')
        self._text(-0.55 * span, level + 0.08, f'L = {self.rig.probes.axial_span:g} m', size=8.5)
        self._measure((0.0, -1.22), (1.0, -1.22), '')
        self._text(0.5, -1.3, f'R = {self.radius:g} m', size=8.5)
        self._text(x - 0.08, y - 0.12, f'x_t = {self.rig.trunnion.x:g} m', LOAD, 8.5, ha='right')

    def _measure(self, start: tuple[float, float], stop: tuple[float, float], text: str) -> None:
        self._arrow(start, stop, '#777777', 0.9, '<|-|>')
        if text:
            self._text(start[0] + 0.05, (start[1] + stop[1]) / 2, text, size=8.5, ha='left',
                       rotation=90)


def _draw_from_above(axes: Any, rig: Rig) -> None:
    from matplotlib.patches import Circle

    rows, middle = rig.axial_rows, rig.radial_row
    ratio = middle.pitch_radius / rows.pitch_radius
    axes.add_patch(Circle((0, 0), 1.18 * max(1.0, ratio), facecolor=STEEL, edgecolor='#666666'))
    axes.add_patch(Circle((0, 0), 0.82 * min(1.0, ratio), facecolor='white', edgecolor='#666666'))
    for count, radius, colour, size in ((rows.rollers, 1.0, '#888888', 0.035),
                                        (middle.rollers, ratio * 1.07, '#444444', 0.02)):
        for index in range(count):
            angle = 2.0 * math.pi * index / count
            axes.add_patch(Circle((radius * math.cos(angle), radius * math.sin(angle)), size,
                                  facecolor=colour, linewidth=0))
    span = rig.probes.axial_span / 2.0 / rows.pitch_radius
    outer = max(1.18, span + 0.1) + 0.14
    for number, x in ((1, outer), (2, -span), (3, -outer), (4, span)):
        if number == rig.probes.absent:
            continue
        axes.plot([x], [0], 's', color=PROBE, markersize=6)
        axes.text(x, 0.1, str(number), color=PROBE, fontsize=10, weight='bold', ha='center',
                  bbox={'facecolor': 'white', 'edgecolor': 'none', 'pad': 0.6, 'alpha': 0.8})
    axes.annotate('', (0.5, 0), (0, 0), arrowprops={'arrowstyle': '-|>', 'color': SIGN})
    axes.text(0.3, -0.12, 'x, to the rear', fontsize=8.5, ha='center')
    axes.plot([0], [0], 'o', color=SIGN, markersize=3)
    axes.text(-0.08, 0.06, 'C', fontsize=9, weight='bold')
    limit = outer + 0.2
    axes.set_xlim(-limit, limit)
    axes.set_ylim(-1.35, 1.35)
    axes.set_aspect('equal')
    axes.axis('off')


def _write_words(axes: Any, rig: Rig) -> None:
    rows, middle, probes = rig.axial_rows, rig.radial_row, rig.probes
    signs = ', '.join('absent' if number == probes.absent else '+1' if sign > 0 else '-1'
                      for number, sign in enumerate(probes.polarity, 1))
    lines = [
        ('axial rows', f'2 x {rows.rollers} rollers, R = {rows.pitch_radius:g} m'),
        ('', f'clearance {rows.clearance * 1e6:g} µm'),
        ('radial row', f'{middle.rollers} rollers, R = {middle.pitch_radius:g} m'),
        ('', f'clearance {middle.clearance * 1e6:g} µm, height {middle.height:g} m'),
        ('full scale', f'{rig.force_words(rig.full_scale_load, 1)}, preload '
                       f'{rig.force_words(rig.preload, 2)}'),
        ('upper part', f'{rig.carriage.mass:g} kg, W = {rig.carriage.weight / 1e3:g} kN'),
        ('probes', f'L = {probes.axial_span:g} m, h_s = {probes.radial_height:g} m'),
        ('', f'range {probes.min_range * 1e3:g} to {probes.max_range * 1e3:g} mm'),
        ('polarity', signs),
        ('rig hash', short_digest(rig.digest)),
    ]
    for row, (name, text) in enumerate(lines):
        height = 0.94 - row * 0.098
        axes.text(0.02, height, name, fontsize=9, color='#666666', transform=axes.transAxes)
        axes.text(0.28, height, text, fontsize=9, transform=axes.transAxes)
    axes.axis('off')


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
        number = plain_exponents(_text(values[name]))
        entry = f'{"        " if above else "      "}{key}: {number}'
        lines.append(f'{entry:<36} # {words}' + ('' if name in given else ' (TO CHECK)'))
    lines.append('    bounds:                  # search range of an identification')
    lines += [plain_exponents(f'      {name}: [{low!r}, {high!r}]')
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
        '--set')
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
            return [whole_number(part) for part in value.strip('[]').split(',')]
        if isinstance(example, str):
            return value
        return whole_number(value) if isinstance(example, int) else plain_number(value)
    except ValueError as problem:
        raise RigError(f'--set {text!r}: give a number, for the polarity four like 1,1,1,-1'
                       ) from problem


def _text(value: Any) -> str:
    return repr(value) if not isinstance(value, str) else value
