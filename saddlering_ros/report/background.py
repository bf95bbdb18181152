"""What surrounds a result: rig and tests at the head, data quality, how to get it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.pages import html
from saddlering_ros.pages.html import Cell, number
from saddlering_ros.quantities import allowed_misfit, percent, quantity
from saddlering_ros.record import displacement_of_run, Record
from saddlering_ros.record.quality import white_noise
from saddlering_ros.report.figures import SYMBOLS
from saddlering_ros.rig import (
    CHANNELS,
    force_decimals,
    force_range,
    force_words,
    Rig,
    RollerRow,
    short_digest,
)
from saddlering_ros.rig.drawing import drawing_svg

Array = NDArray[np.float64]

EARLIEST = 946_684_800_000_000_000
"""Stamps [ns] before the year 2000 count from some other zero and give no date."""

GAP_PERIODS = 5.0


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


def head_line(run: Record, *, held_out: bool = False) -> HeadLine:
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
    rows: list[list[str | Cell]] = [
        [item.bag, item.test, number(f'{item.elevation_deg:g}°'),
         'held out' if item.held_out else 'fitted', item.date or '–', item.operator or '–',
         item.run or '–'] for item in tests]
    return '\n'.join([
        f'<h1>{html.escape(title)}</h1>',
        f'<p class="soft">Rig: {html.escape(named)}, hash <code title="{digest}">'
        f'{short_digest(digest)}</code></p>',
        html.table(['test', 'kind', number('elevation'), 'role', 'date', 'operator', 'run'], rows),
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
        ('probes, polarity of 1 to 4', ', '.join(f'{sign:+g}' for sign in rig.probes.polarity)),
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


@dataclass(frozen=True)
class RunQuality:
    """How good one run's data are.

    duration [s]; rate [Hz] by the median period; load [N] lowest and highest; incomplete: load
    samples at which a probe has no reading; gaps in the load's stamps, longest_gap [s];
    zero_load [N] and whether that is the preload; noise: white noise of a sample [m, rad] by
    channel; notes: faults of the bag that do not prevent its use;
    force_unit: in which loads are shown.
    """

    name: str
    test: str
    elevation_deg: float
    samples: int
    duration: float
    rate: float
    load: tuple[float, float]
    incomplete: int
    gaps: int
    longest_gap: float
    zero_load: float
    is_zeroed_at_preload: bool
    noise: Mapping[str, float]
    notes: tuple[str, ...] = ()
    force_unit: str = 't'

    @property
    def decimals(self) -> int:
        """Decimals of the loads of this run."""
        return force_decimals(self.load[1], self.force_unit)


@dataclass(frozen=True)
class Background:
    """Texts of a page beside its result; empty ones are left out.

    covariance (6, 6) of the contact parameters in the order of PARAMETER_NAMES; quality by run;
    command: the command line that made the page; curves_file: the name of the file of its curves;
    force_unit: unit in which loads are shown.
    """

    covariance: Array | None = None
    quality: Sequence[RunQuality] = field(default=())
    command: str = ''
    curves_file: str = ''
    force_unit: str = 't'


def quality_of(run: Record, rig: Rig) -> RunQuality:
    """Judge the data of one run."""
    measured = displacement_of_run(rig, run)
    steps = np.diff(run.stamps) / 1e9
    period = float(np.median(steps))
    long = steps[steps > max(GAP_PERIODS * period, 0.005)]
    return RunQuality(
        name=run.path.name, test=run.test, elevation_deg=float(np.degrees(run.elevation)),
        samples=len(run.stamps), duration=float(run.time[-1]), rate=1.0 / period,
        load=(float(run.load.min()), float(run.load.max())),
        incomplete=int((~measured.complete).sum()), gaps=len(long),
        longest_gap=float(long.max(initial=0.0)), zero_load=measured.zero.load,
        is_zeroed_at_preload=measured.zero.near_preload,
        noise={name: white_noise(np.asarray(getattr(measured.displacement, name)))
               for name in CHANNELS},
        notes=tuple(run.notes), force_unit=rig.force_unit)


def data_quality(runs: Sequence[RunQuality]) -> str:
    """Chapter: the quality of each run's data."""
    rows: list[list[str | Cell]] = [[
        run.name, number(f'{run.samples}'), number(f'{run.duration:.1f} s'),
        number(f'{run.rate:.4g} Hz'),
        number(force_range(*run.load, run.force_unit, run.decimals + 1)),
        number(f'{run.incomplete}', 'bad' if run.incomplete > 0.01 * run.samples else ''),
        number('none' if not run.gaps else f'{run.gaps} (≤ {run.longest_gap:.3g} s)',
               'bad' if run.gaps else ''),
        number(force_words(run.zero_load, run.force_unit, run.decimals + 2),
               '' if run.is_zeroed_at_preload else 'bad'),
        *(number(quantity(run.noise[name], 'rad' if name == 'gamma' else 'm'))
          for name in CHANNELS)] for run in runs]
    said = [f'{run.name}: {note}' for run in runs for note in run.notes]
    return html.section('Data quality', html.table(
        ['run', number('load samples'), number('duration'), number('rate'), number('load'),
         number('without all probes'), number('gaps'), number('zero at'),
         *(number(f'noise {SYMBOLS[name]}') for name in CHANNELS)], rows,
        'Noise: white noise of one sample, from second differences. Red: more than 1 % of the '
        'samples lack a probe, the stamps have gaps, or the zero is not at preload.'),
        html.bullets(said) if said else html.paragraph(
            'These bags have no other fault.' if runs else '', 'soft'))


def misfit_reductions(document: Mapping[str, Any]) -> str:
    """Chapter: by how much the misfit falls, run by run, with the extended model."""
    total = document.get('gain') or {}
    if document['verdict'] == 'none' or total.get('fit') is None:
        return ''
    rows: list[list[str | Cell]] = []
    for run in document['runs']:
        rows.append([
            str(run['bag']).rstrip('/').rsplit('/', 1)[-1],
            'held out' if run['held_out'] else 'fitted',
            *(number(_reduction_words(run['channels'].get(name))) for name in CHANNELS[:3]),
            number('–')])
    blank = ['–'] * 3
    rows.append(['all fitted runs', 'fitted', *map(number, blank), number(percent(total['fit']))])
    if total.get('held_out') is not None:
        in_turn = total.get('how') == 'held out in turn'
        rows.append(['all runs in turn' if in_turn else 'all held-out runs', 'held out',
                     *map(number, blank), number(percent(total['held_out']))])
    return html.section('Misfit reduction', html.table(
        ['run', 'role', *(number(f'misfit reduction in {SYMBOLS[name]}') for name in CHANNELS[:3]),
         number('in all channels')], rows,
        'Misfit reduction: the share by which the cause in the simulation reduces the rms misfit. '
        'It is negative if the misfit rises, and in brackets if the misfit was within twice the '
        'noise before. The last column weights the channels by their noise.'))


def _reduction_words(item: Mapping[str, float | None] | None) -> str:
    before, after = (item or {}).get('nrmse_before'), (item or {}).get('nrmse_after')
    if not before or after is None:
        return '–'
    gain = 1.0 - after / before
    words = f'{100.0 * gain:.0f} %' if abs(gain) >= 5e-3 else '0 %'
    floor = (item or {}).get('noise_floor')
    return f'({words})' if before <= allowed_misfit(floor) else words


def reproduction(document: Mapping[str, Any], command: str = '', curves_file: str = '') -> str:
    """Chapter: the command, the versions and the hashes that lead to the same numbers again."""
    made = document.get('provenance') or {}
    rows: list[list[str | Cell]] = []
    for kind in ('bags', 'files'):
        rows += [[item['path'], Cell(
            f'<code class="hash">{html.escape(item.get("sha256") or "not a file")}</code>',
            is_html=True)] for item in made.get(kind, ())]
    versions = ', '.join(f'{name} {version}' for name, version in made.get('versions', {}).items())
    return html.section(
        'To reproduce this result',
        html.commands([command] if command else []),
        html.table(['input', 'SHA-256'], rows, 'The hash of a bag is that of the '
                   'lines which sha256sum prints for its files.'),
        html.paragraph(f'{curves_file}, beside this page, holds the curves of all figures in SI '
                       'units.' if curves_file else '', 'note'),
        html.paragraph(f'Made with {versions}.' if versions else '', 'note'))
