"""A figure as data: panels with lines, bands and heat maps.

`drawing.py` makes the picture that is printed of it, `interactive.py` the figure that a browser
zooms into; both show the same because both are made from this.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.report.style import NOISE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Series:
    """One line or row of markers.

    dash: '-', '--', ':' or '' for none; marker: '^', 'v', 'o', 'D', '.', '|' or '' for none;
    width and size in points; name: in the legend, once for all series of that name ('': not).
    """

    x: Array
    y: Array
    colour: str
    name: str = ''
    dash: str = '-'
    marker: str = ''
    width: float = 1.2
    size: float = 4.5
    is_open: bool = False
    opacity: float = 1.0


@dataclass(frozen=True)
class ShadedBand:
    """A band of y across the whole panel; name: in the legend ('': not)."""

    low: float
    high: float
    colour: str = NOISE
    opacity: float = 0.3
    name: str = ''


@dataclass(frozen=True)
class Ticks:
    """Ticks with words instead of numbers; size of the words in points."""

    at: tuple[float, ...]
    words: tuple[str, ...]
    size: float = 8.0
    is_upright: bool = False


@dataclass(frozen=True)
class HeatMap:
    """Values (R, C) from the top row down, NaN where there are none.

    colours: from `low` to `high`, evenly spaced; rows, columns: names that a hover shows;
    label: of the colour bar, drawn if not ''.
    """

    values: Array
    colours: tuple[str, ...]
    low: float
    high: float
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    label: str = ''
    background: str = '#ffffff'


@dataclass(frozen=True)
class Panel:
    """One pair of axes at a place of the grid.

    x_label and y_label name the quantities; shows_x and shows_y: whether they stand at the
    axis, with its tick labels (a panel that shares an axis leaves them to its neighbour).
    levels: heights of thin lines across the panel.
    """

    row: int
    column: int
    x_label: str
    y_label: str
    series: tuple[Series, ...] = ()
    bands: tuple[ShadedBand, ...] = ()
    levels: tuple[float, ...] = ()
    heat: HeatMap | None = None
    title: str = ''
    shows_x: bool = True
    shows_x_label: bool = True
    shows_y: bool = True
    shows_y_label: bool = True
    x_ticks: Ticks | None = None
    y_ticks: Ticks | None = None
    x_is_log: bool = False
    y_is_log: bool = False
    y_range: tuple[float, float] | None = None
    has_y_grid: bool = True


@dataclass(frozen=True)
class Chart:
    """Panels on a grid; width and height in inches, heights: ratios of its rows.

    shares_x: panels of one column share their x axis.
    """

    panels: tuple[Panel, ...]
    width: float
    height: float
    heights: tuple[float, ...] = (1.0,)
    columns: int = 1
    shares_x: bool = False
    legend_columns: int = 5

    @property
    def named(self) -> list[Series | ShadedBand]:
        """Entries of the legend: the first series or band of each name."""
        found: dict[str, Series | ShadedBand] = {}
        for panel in self.panels:
            items: list[Series | ShadedBand] = [*panel.series, *panel.bands]
            for item in items:
                if item.name:
                    found.setdefault(item.name, item)
        return list(found.values())


def line(x: ArrayLike, y: ArrayLike, colour: str, name: str = '', dash: str = '-',
         width: float = 1.2, opacity: float = 1.0) -> Series:
    """A line through points."""
    return Series(np.asarray(x, float), np.asarray(y, float), colour, name, dash, '', width,
                  opacity=opacity)


def markers(x: ArrayLike, y: ArrayLike, marker: str, colour: str, name: str = '',
            size: float = 4.5, *, is_open: bool = False) -> Series:
    """Markers at points."""
    return Series(np.asarray(x, float), np.asarray(y, float), colour, name, '', marker, size=size,
                  is_open=is_open)


def without_inner_labels(panels: Sequence[Panel], rows: int) -> Iterator[Panel]:
    """Panels of a grid that share x by column: only those of the last row show it."""
    for panel in panels:
        is_last = panel.row == rows - 1
        yield replace(panel, shows_x=is_last, shows_x_label=is_last)
