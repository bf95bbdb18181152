"""The head of a report: rig, tests, dates and operators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone

import numpy as np

from saddlering_ros.bags import TestRun
from saddlering_ros.report import html
from saddlering_ros.report.html import Cell, number
from saddlering_ros.rig import Rig, RollerRow, short_digest
from saddlering_ros.rig.drawing import drawing_svg

EARLIEST = 946_684_800_000_000_000
"""Stamps [ns] before the year 2000 count from some other zero and give no date."""


@dataclass(frozen=True)
class HeadLine:
    """One test as the head names it; date and operator are '' if the bag does not state them."""

    bag: str
    test: str
    elevation_deg: float
    rig: str
    run: str
    date: str
    operator: str
    held_out: bool = False


def head_line(run: TestRun, *, held_out: bool = False) -> HeadLine:
    """The line of the head for one run."""
    return HeadLine(
        bag=run.path.name, test=run.test,
        elevation_deg=round(float(np.degrees(run.elevation)), 2), rig=run.rig, run=run.run,
        date=run.details.get('date', '') or date_of(int(run.stamps[0])),
        operator=run.details.get('operator', ''), held_out=held_out)


def date_of(stamp: int) -> str:
    """'2026-11-20 08:15 UTC' of a stamp [ns]; '' if the stamp is no date."""
    if stamp < EARLIEST:
        return ''
    return datetime.fromtimestamp(stamp / 1e9, timezone.utc).strftime('%Y-%m-%d %H:%M UTC')


def head(title: str, rig: Rig, tests: Sequence[HeadLine]) -> str:
    """Title, rig with its hash, tests; the rig's dimensions folded below."""
    named = ', '.join(sorted({item.rig for item in tests if item.rig})) or 'not named in the bags'
    digest = rig.digest
    columns: list[str | Cell] = [
        'test', 'kind', number('elevation'), 'role', 'date', 'operator', 'run']
    rows: list[list[str | Cell]] = [
        [item.bag, item.test, number(f'{item.elevation_deg:g}°'),
         'held out' if item.held_out else 'fitted', item.date or '–', item.operator or '–',
         item.run or '–'] for item in tests]
    shown = [place for place in range(len(columns)) if place < 4 or any(
        row[place] != '–' for row in rows)]
    return '\n'.join([
        f'<h1>{html.escape(title)}</h1>',
        f'<p class="soft">Rig: {html.escape(named)}, hash <code title="{digest}">'
        f'{short_digest(digest)}</code></p>',
        html.table([columns[place] for place in shown],
                   [[row[place] for place in shown] for row in rows]),
        html.folded('Dimensions of the rig', _picture(rig, tests) + html.table(
            ['dimension', number('value')],
            [(html.Cell(name), number(value)) for name, value in dimensions(rig)],
            f'Rig hash {digest}')),
    ])


def _picture(rig: Rig, tests: Sequence[HeadLine]) -> str:
    """The drawing of the rig, its load at the elevation of the first test."""
    svg = drawing_svg(rig, tests[0].elevation_deg) if tests else drawing_svg(rig)
    return f'<div role="img" aria-label="Drawing of the rig with probes and signs">{svg}</div>'


def dimensions(rig: Rig) -> list[tuple[str, str]]:
    """The rig's dimensions as a reader checks them."""
    height = 1e3 * (rig.radial_row.height or 0.0)
    return [
        *_row_dimensions('axial rows (each)', rig.axial_rows),
        *_row_dimensions('radial row', rig.radial_row),
        ('radial row, height over the mid-plane', f'{height:g} mm'),
        ('trunnion, x and y', f'{1e3 * rig.trunnion.x:g} mm, {1e3 * rig.trunnion.y:g} mm'),
        ('probes 2 and 4, distance', f'{1e3 * rig.probes.axial_span:g} mm'),
        ('probes 1 and 3, height', f'{1e3 * rig.probes.radial_height:g} mm'),
        ('probes, polarity of 1 to 4',
         ', '.join(f'{sign:+g}' for sign in rig.probes.polarity)),
        *([('probe that is absent', f'{rig.probes.absent}')] if rig.probes.absent else []),
        ('probes, span', f'{1e3 * rig.probes.min_range:g} to {1e3 * rig.probes.max_range:g} mm'),
        ('carriage, mass', f'{rig.carriage.mass:g} kg'),
        ('preload', rig.force_words(rig.preload, 2)),
        ('full scale of the load', rig.force_words(rig.full_scale_load)),
    ]


def _row_dimensions(name: str, row: RollerRow) -> list[tuple[str, str]]:
    return [(f'{name}, rollers', f'{row.rollers}'),
            (f'{name}, pitch radius', f'{1e3 * row.pitch_radius:g} mm'),
            (f'{name}, clearance', f'{1e6 * row.clearance:g} µm')]
