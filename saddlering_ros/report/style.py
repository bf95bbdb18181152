"""How channels, units and colours are shown, the same in every figure and table."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from saddlering_ros.rig import MICRO_UNITS

MEASURED = '#26323d'
BEFORE = '#d1495b'
AFTER = '#1f6fb2'
NOISE = '#9aa5b1'
UP, DOWN = '#c77700', '#00798c'

MICRO = 1e6
"""Metres to micrometres, radians to microradians."""

SYMBOLS = {'delta_x': 'δx', 'delta_y': 'δy', 'gamma': 'γ', 'parity': 'parity'}

FONT = {
    'font.family': 'DejaVu Sans', 'font.size': 9.0, 'axes.titlesize': 10.0,
    'axes.labelsize': 9.0, 'legend.fontsize': 8.0, 'axes.grid': True, 'grid.color': '#e4e8ec',
    'grid.linewidth': 0.7, 'axes.edgecolor': '#7b8794', 'axes.linewidth': 0.8,
    'axes.axisbelow': True, 'axes.spines.top': False, 'axes.spines.right': False,
    'legend.frameon': False, 'lines.linewidth': 1.2, 'xtick.color': '#3e4c59',
    'ytick.color': '#3e4c59', 'axes.unicode_minus': True,
}


@contextmanager
def drawing() -> Iterator[None]:
    """The look of every figure, for the time of drawing it."""
    import matplotlib

    with matplotlib.rc_context(FONT):
        yield


def axis_label(channel: str) -> str:
    """Label of an axis that shows a channel."""
    return f'{SYMBOLS[channel]} / {MICRO_UNITS[channel]}'
