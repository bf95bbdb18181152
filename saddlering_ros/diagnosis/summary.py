"""The verdict in words for a terminal."""

from __future__ import annotations

from saddlering_ros.diagnosis.diagnose import describe, Verdict
from saddlering_ros.discrepancy import Cause
from saddlering_ros.rig.units import as_read, stiffness_per_millimetre


def verdict_text(verdict: Verdict) -> str:
    """What was found, what it is worth, what is still open; plain lines."""
    found = verdict.diagnosis
    lines = [f'verdict: {found.verdict}', '']
    if found.verdict == 'none':
        lines.append('What is left is noise, or too small to matter.')
    for cause in found.causes:
        lines += _cause_lines(cause)
    if found.verdict == 'unknown':
        lines.append('Something is wrong that the catalogue does not explain:')
        lines += [
            f'  {describe(item)}'
            for item in found.shapes_after[:4]
            if item.p_value < 0.01 and item.visible >= 1e-3
        ]
    lines += ['', 'misfit, % of range (before / after / noise):']
    for figures in verdict.runs:
        parts = [
            f'{name} {100 * item.nrmse_before:.2f}/{100 * item.nrmse_after:.2f}/'
            f'{100 * item.noise_floor:.2f}'
            for name, item in figures.channels.items()
        ]
        sealed = ' (held out)' if figures.record.run.held_out else ''
        lines.append(f'  {figures.record.run.name}{sealed}: ' + ', '.join(parts))
    lines += ['', 'contact parameters (before -> after):']
    for name, last in found.base_after.items():
        first = found.base_before[name]
        lines.append(
            f'  {name}: {first.value:.4g} -> {last.value:.4g} '
            f'+/- {last.std:.2g} {last.unit.replace("1", "")}'.rstrip()
        )
    stiffness = [
        (stiffness_per_millimetre(item[f'K{row}'].value, item[f'n{row}'].value), row)
        for row in (1, 2) for item in (found.base_before, found.base_after)
    ]
    for (before, row), (after, _) in zip(stiffness[::2], stiffness[1::2], strict=True):
        lines.append(f'  K{row}: {before:.4g} -> {after:.4g} N/mm^n')
    if verdict.next_test:
        lines += ['', f'next test: {verdict.next_test}']
    lines += [f'note: {note}' for note in verdict.notes]
    return '\n'.join(lines)


def _cause_lines(cause: Cause) -> list[str]:
    values = ', '.join(
        f'{name} {as_read(item.value, item.unit, item.std)}'
        if item.std
        else f'{name} {item.value:g}'
        for name, item in cause.estimates.items()
    )
    kept = (
        ''
        if cause.gain.held_out is None
        else (f', {100 * cause.gain.held_out:.0f} % on runs {cause.gain.how}')
    )
    lines = [
        f'  {cause.effect.id}: {cause.effect.title}',
        f'    {values}',
        f'    gain {100 * cause.gain.fit:.0f} % on runs fitted{kept}; p {cause.p_value:.1e}',
    ]
    if len(cause.group) > 1:
        lines.append(f'    these data cannot tell it from: {", ".join(cause.group[1:])}')
    return lines
