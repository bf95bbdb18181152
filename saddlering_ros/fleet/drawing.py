"""Small drawings of a fleet as SVG: a ring's history, and verdicts over time."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone

import numpy as np

from saddlering_ros.fleet.history import History
from saddlering_ros.fleet.observations import Array, SessionFigures

WIDTH, HEIGHT, MARGIN = 176, 96, 30

COLOURS = {
    'none': '#2f8f4e', 'named': '#1f6fb2', 'ambiguous': '#d9930d', 'unknown': '#d1495b',
    'failed': '#7b8794',
}
INK, SOFT = '#26323d', '#9aa5b1'


def history_drawing(history: History, title: str, clock: str) -> str:
    """Readings with two standard deviations, the filtered level, services as dashed lines.

    Logarithms are drawn as percent of the first level, exponents and sizes unchanged.
    """
    series = history.series
    first = history.level[0]
    relative = title.startswith(('stiffness', 'damping'))

    def shown(numbers: Array) -> Array:
        return np.asarray(100.0 * np.expm1(numbers - first)) if relative else numbers

    value, level = shown(series.value), shown(history.level)
    bottom, top = shown(series.value - 2.0 * series.std), shown(series.value + 2.0 * series.std)
    left, right = float(series.time[0]), float(series.time[-1])
    low, high = float(bottom.min()), float(top.max())
    pad = 0.08 * max(high - low, 1e-9)

    def x(time: float) -> float:
        return MARGIN + (WIDTH - MARGIN - 6) * (time - left) / max(right - left, 1e-12)

    def y(number: float) -> float:
        return HEIGHT - 16 - (HEIGHT - 34) * (number - low + pad) / (high - low + 2.0 * pad)

    parts = [f'<text x="{MARGIN}" y="11" font-size="10" fill="{INK}">{title}</text>']
    for time, renewed in zip(series.time, series.renewed, strict=True):
        if renewed:
            parts.append(f'<line x1="{x(time):.1f}" x2="{x(time):.1f}" y1="16" y2="{HEIGHT - 16}" '
                         f'stroke="{SOFT}" stroke-dasharray="3 2"/>')
    for time, number, under, over in zip(series.time, value, bottom, top, strict=True):
        parts.append(f'<line x1="{x(time):.1f}" x2="{x(time):.1f}" y1="{y(under):.1f}" '
                     f'y2="{y(over):.1f}" stroke="{SOFT}"/>')
        parts.append(f'<circle cx="{x(time):.1f}" cy="{y(number):.1f}" r="2" fill="{INK}"/>')
    points = ' '.join(f'{x(time):.1f},{y(number):.1f}'
                      for time, number in zip(series.time, level, strict=True))
    parts.append(f'<polyline points="{points}" fill="none" stroke="#1f6fb2" stroke-width="1.5"/>')
    for number in (low, high):
        label = f'{number:.0f} %' if relative else f'{number:.4g}'
        parts.append(f'<text x="0" y="{y(number) + 3:.1f}" font-size="8" fill="{SOFT}">'
                     f'{label}</text>')
    unit = 'h' if clock == 'service_hours' else 'years'
    parts.append(f'<text x="{WIDTH - 4}" y="{HEIGHT - 3}" font-size="8" fill="{SOFT}" '
                 f'text-anchor="end">{right - left:.4g} {unit}</text>')
    return _svg(WIDTH, HEIGHT, f'history of {title}', parts)


def verdicts_drawing(sessions: Sequence[SessionFigures]) -> str:
    """Sessions a month by verdict, as stacked columns; '' where no session has a date."""
    dated = [item for item in sessions if np.isfinite(item.time)]
    if not dated:
        return ''
    months: dict[str, dict[str, int]] = {}
    for item in sorted(dated, key=lambda one: one.time):
        month = datetime.fromtimestamp(item.time, timezone.utc).strftime('%Y-%m')
        own = months.setdefault(month, {})
        own[item.verdict] = own.get(item.verdict, 0) + 1
    highest = max(sum(own.values()) for own in months.values())
    width, height, base = 760, 150, 124
    step = min(60.0, (width - 40) / len(months))
    parts = []
    for place, (month, own) in enumerate(months.items()):
        top = float(base)
        for verdict, colour in COLOURS.items():
            size = 100.0 * own.get(verdict, 0) / highest
            top -= size
            if size:
                parts.append(f'<rect x="{30 + place * step:.1f}" y="{top:.1f}" '
                             f'width="{0.8 * step:.1f}" height="{size:.1f}" fill="{colour}"/>')
        if place % max(1, len(months) // 10) == 0:
            parts.append(f'<text x="{30 + place * step:.1f}" y="{base + 12}" font-size="9" '
                         f'fill="{INK}">{month}</text>')
    parts.append(f'<text x="0" y="{base - 96}" font-size="9" fill="{INK}">{highest}</text>')
    for place, (verdict, colour) in enumerate(COLOURS.items()):
        parts.append(f'<rect x="{30 + 90 * place}" y="{base + 17}" width="9" height="9" '
                     f'fill="{colour}"/><text x="{43 + 90 * place}" y="{base + 25}" '
                     f'font-size="10" fill="{INK}">{verdict}</text>')
    return _svg(width, height, 'sessions a month by verdict', parts)


def _svg(width: int, height: int, title: str, parts: Sequence[str]) -> str:
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'width="{width}" height="{height}" role="img" aria-label="{title}" '
            f'font-family="DejaVu Sans, sans-serif">{"".join(parts)}</svg>')
