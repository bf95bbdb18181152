"""Pictures of the documentation, made by the code: python docs/pictures.py writes images/."""

from __future__ import annotations

from html import escape
from pathlib import Path
import re

from gallery import sheet
from matplotlib.figure import Figure
import numpy as np

from saddlering_ros import discrepancy
from saddlering_ros.discrepancy.verdict.page import channels_of
from saddlering_ros.pages.charts import AFTER, BEFORE, drawing, MEASURED, NOISE
from saddlering_ros.pages.html import png
from saddlering_ros.rig import default_rig, ParameterSet, TONNE, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import simulate

IMAGES = Path(__file__).resolve().parent / 'images'
AXIS_PAGE = IMAGES.parent / 'own_simulator.md'
CHANNELS = (('delta_x', 'δx / µm'), ('delta_y', 'δy / µm'), ('gamma', 'γ / µrad'))
ELEVATION = np.radians(50.0)

LOOK_ALIKES = (
    ('dry friction in the radial row', {'radial_friction': {'force': 5e3}}),
    ('friction in the cylinder', {'cylinder_friction': {}}),
    ('creep of the oil film', {'film_creep': {}}),
    ('load cell reads 1 % too much', {'load_gain': {'gain': 0.01}}),
    ('more radial clearance', {'radial_clearance': {'change': 1e-5}}),
    ('radial compliance in series', {'radial_compliance': {}}),
)


def cycle() -> tuple[np.ndarray, np.ndarray]:
    """One slow cycle from preload to full load and back: time [s], load [N]."""
    time = np.arange(0.0, 62.0, 0.1)
    load = TONNE * np.interp(time, [0.0, 1.0, 31.0, 61.0], [0.5, 0.5, 25.0, 0.5])
    return time, load


def simulated(effects: dict[str, dict[str, float]]) -> dict[str, np.ndarray]:
    """Displacements over the cycle with these effects."""
    time, load = cycle()
    found = simulate(default_rig(), ParameterSet(TRUE_TO_SCALE, effects), ELEVATION, time, load)
    return {'load': load[found.first:found.first + len(found.time)] / TONNE,
            **{name: 1e6 * np.asarray(getattr(found.displacement, name)) for name, _ in CHANNELS}}


def model() -> Figure:
    """What the model does: three channels over load, and a roller's force over penetration."""
    with drawing():
        figure = Figure(figsize=(11.0, 2.9), layout='constrained')
        axes = figure.subplots(1, 4)
        plain = simulated({})
        for place, (name, label) in zip(axes, CHANNELS, strict=False):
            place.plot(plain['load'], plain[name], color=MEASURED)
            place.set(xlabel='load / t', ylabel=label)
        depth = np.linspace(0.0, 4e-5, 100)
        law = TRUE_TO_SCALE
        axes[3].plot(1e6 * depth, law.K1 * depth**law.n1 / 1e3, color=AFTER)
        axes[3].set(xlabel='penetration / µm', ylabel='force of one roller / kN')
        for place, title in zip(axes, ('radial', 'axial', 'tilt',
                                       'contact law'), strict=True):
            place.set_title(title)
        return figure


def look_alikes() -> Figure:
    """What single causes add to the radial displacement: some look alike, some do not."""
    with drawing():
        figure = Figure(figsize=(11.0, 4.6), layout='constrained')
        grid = figure.subplots(2, 3, sharex=True)
        plain = simulated({})
        for place, (title, effects) in zip(grid.flat, LOOK_ALIKES, strict=True):
            changed = simulated(effects)
            top = int(np.argmax(changed['load']))
            added = changed['delta_x'] - plain['delta_x']
            place.plot(changed['load'][:top], added[:top], color=BEFORE, label='load rising')
            place.plot(changed['load'][top:], added[top:], color=AFTER, label='load falling')
            place.axhline(0.0, color=NOISE, lw=0.8)
            place.set_title(title)
        for place in grid[1]:
            place.set_xlabel('load / t')
        for place in grid[:, 0]:
            place.set_ylabel('added to δx / µm')
        grid[0][0].legend()
        return figure


def inexact() -> Figure:
    """Four cases of the axis of own_simulator.md, made by the code of that page."""
    code = re.findall(r'^```python\n(.*?)^```', AXIS_PAGE.read_text(encoding='utf-8'),
                      re.DOTALL | re.MULTILINE)[1]
    axis = {'np': np, **vars(discrepancy)}
    exec(code, axis)
    cases = []
    for friction, declared in ((0.0, 0.0), (0.0, 0.002), (1.0, 0.0), (1.0, 0.01)):
        true = {**axis['sound'], 'coulomb.force': friction}
        answer = discrepancy.diagnose(
            axis['axis'](declared), [axis['record'](*run, true) for run in (
                ('slow', 1.0), ('fast', 2.5))], hold_out=[axis['record']('other', 1.7, true)])
        shown, (noise, *allowed) = answer.runs[-1], channels_of(answer)[0].bands.values()
        measured = shown.run.channels[0]
        cases.append({
            'cause': '', 'verdict': answer.verdict, 'words': answer.headline,
            'title': f'{f"friction of {friction:g} N" if friction else "sound"}, '
                     f'{f"{100 * declared:g} % declared" if declared else "nothing declared"}',
            'run': shown.run.name, 'over': 'time / s', 'at': shown.run.time, 'noise': noise / 2.0,
            'allowed': sum(allowed) / 2.0, 'channel': 'force / N',
            'before': measured - shown.before[0], 'after': measured - shown.after[0]})
    return sheet(cases, 2, 'without friction')


BOXES = {
    'rig': (20, 30, 150, 62, 'the rig', 'a DAQ driver', '#fff'),
    'bag': (20, 130, 150, 62, 'a bag', 'rosbag2, MCAP', '#fff'),
    'replay': (230, 130, 160, 62, 'replay', 'clock, load, probes', '#eef5fc'),
    'raw': (230, 30, 160, 62, '/rig/...', 'load, 4 gaps', '#f5f7fa'),
    'displacement': (460, 10, 190, 52, 'ring_displacement', 'zero, align, measure', '#eef5fc'),
    'simulator': (460, 86, 190, 52, 'ring_simulator', 'contact law, effects', '#eef5fc'),
    'residual': (800, 48, 160, 52, 'ring_residual', 'same stamps only', '#eef5fc'),
    'people': (1010, 22, 170, 104, 'people and tools', 'saddlering live, record,', '#fff'),
    'offline': (230, 240, 160, 62, 'bags, ring', 'the same code, offline', '#f5f7fa'),
    'identification': (460, 200, 190, 52, 'ring_identification', 'swarm, fit, uncertainty',
                       '#eef5fc'),
    'diagnosis': (460, 276, 190, 52, 'ring_diagnosis', 'what is missing, and why', '#eef5fc'),
    'report': (1010, 240, 170, 62, 'report, verdict', 'HTML, JSON, YAML', '#fff'),
}
WAYS = (
    ('rig', 'raw', 'h', ''), ('bag', 'replay', 'h', ''), ('replay', 'raw', 'v', ''),
    ('raw', 'displacement', 'h', ''), ('raw', 'simulator', 'h', ''),
    ('displacement', 'residual', 'h', '/ring/displacement'),
    ('simulator', 'residual', 'h', '/ring/simulated_...'),
    ('residual', 'people', 'h', ''), ('bag', 'offline', 'e', ''),
    ('offline', 'identification', 'h', ''), ('offline', 'diagnosis', 'h', ''),
    ('identification', 'simulator', 'u', '/ring/parameters'),
    ('diagnosis', 'report', 'h', ''), ('identification', 'report', 'h', ''),
)


def architecture() -> str:
    """The data's way as SVG."""
    parts = ['<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1200 350" role="img" '
             'font-family="DejaVu Sans, sans-serif" font-size="13"><title>The way of the data'
             '</title><rect width="1200" height="350" fill="#fff"/><defs><marker id="a" '
             'viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
             '<path d="M0 0L8 4L0 8z" fill="#52606d"/></marker></defs>']
    for start, end, kind, words in WAYS:
        parts.append(_way(BOXES[start], BOXES[end], kind, words))
    for x, y, width, height, title, text, fill in BOXES.values():
        parts.append(
            f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="8" fill="{fill}" '
            f'stroke="#7b8794"/><text x="{x + width / 2}" y="{y + 22}" text-anchor="middle" '
            f'font-weight="bold" fill="#1f2933">{escape(title)}</text><text x="{x + width / 2}" '
            f'y="{y + 42}" text-anchor="middle" fill="#52606d" font-size="12">{escape(text)}'
            '</text>')
    for line, text in enumerate(('PlotJuggler, Foxglove,', 'your own node')):
        parts.append(f'<text x="1095" y="{82 + 19 * line}" text-anchor="middle" fill="#52606d" '
                     f'font-size="12">{text}</text>')
    return '\n'.join([*parts, '</svg>', ''])


def _way(start: tuple, end: tuple, kind: str, words: str) -> str:
    x0, y0, w0, h0 = start[:4]
    x1, y1, w1, h1 = end[:4]
    if kind == 'h':
        points = (x0 + w0, y0 + h0 / 2, x1, y1 + h1 / 2)
    elif kind in 'vu':
        points = (x0 + w0 / 2, y0, x1 + w1 / 2, y1 + h1)
    else:
        points = (x0 + w0 / 2, y0 + h0, x1, y1 + h1 / 2)
    a, b, c, d = points
    bend = (f'M{a} {b}C{(a + c) / 2} {b} {(a + c) / 2} {d} {c} {d}' if kind == 'h' else
            f'M{a} {b}L{c} {d}' if kind in 'vu' else f'M{a} {b}Q{a} {d} {c} {d}')
    text = ''
    if words:
        x, y, anchor = ((a + c) / 2 + 8, (b + d) / 2 + 4, 'start') if kind == 'u' else (
            (a + c) / 2, b - 8 if d > b else b + 18, 'middle')
        text = (f'<text x="{x}" y="{y}" text-anchor="{anchor}" fill="#1f6fb2" font-size="11">'
                f'{escape(words)}</text>')
    return (f'<path d="{bend}" fill="none" stroke="#52606d" stroke-width="1.4" '
            f'marker-end="url(#a)"/>{text}')


if __name__ == '__main__':
    IMAGES.mkdir(exist_ok=True)
    (IMAGES / 'model.png').write_bytes(png(model()))
    (IMAGES / 'look_alikes.png').write_bytes(png(look_alikes()))
    (IMAGES / 'inexact.png').write_bytes(png(inexact()))
    (IMAGES / 'architecture.svg').write_text(architecture(), encoding='utf-8')
