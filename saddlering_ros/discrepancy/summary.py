"""A diagnosis in plain lines."""

from __future__ import annotations

from collections.abc import Mapping

from saddlering_ros.discrepancy.results import Cause, Diagnosis, Estimate
from saddlering_ros.quantities import (
    CHANCE,
    compact,
    percent,
    probability,
    quantity,
    VERDICT_WORDS,
)

WORDS = VERDICT_WORDS


def summary_text(found: Diagnosis) -> str:
    """Verdict, causes, misfit reduction, parameters, warnings."""
    lines = [f'verdict: {found.verdict} ({WORDS[found.verdict]})']
    for cause in found.causes:
        lines += _cause_lines(cause)
    if found.separations:
        best = found.separations[0]
        lines.append(f'next test: {best.proposal.sentence} It leaves the true cause alone in '
                     f'{round(100 * best.share)} of 100 simulated draws.')
    if found.causes:
        lines.append(f'misfit reduction: {gain_words(found.gain.fit, found.gain.held_out)}')
    if found.verdict == 'unknown':
        after = found.residual_after
        tests = sorted((*after.consistency, *after.shapes), key=lambda item: item.p_value)
        shapes = [item for item in tests if item.p_value < CHANCE][:4]
        lines += [
            f'  residual: {item.view} along {item.coordinate}, {percent(item.visible)} of range'
            for item in shapes
        ]
    lines += ['', 'base parameters (alone -> with the causes):']
    lines += parameter_lines(found.base_alone, found.base)
    lines += [f'warning: {item}' for item in found.warnings]
    if not found.converged:
        lines.append('not converged: a fit on which the verdict rests ended before its optimum')
    return '\n'.join(lines)


def _cause_lines(cause: Cause) -> list[str]:
    values = ', '.join(f'{name} {estimate_words(item)}' for name, item in cause.parameters.items())
    part = ' (part of the cause only)' if cause.partial else ''
    lines = [f'  {cause.effect}: {cause.definition.title}{part}', f'    {values}']
    lines.append(
        f'    misfit reduction {gain_words(cause.gain.fit, cause.gain.held_out)}; '
        f'p {probability(cause.p_value)}'
    )
    if len(cause.group) > 1:
        lines.append('    alternatives that explain these data equally well: '
                     f'{", ".join(cause.group[1:])}')
    return lines


def gain_words(fitted: float, held_out: float | None) -> str:
    """Misfit reductions as percentages."""
    words = f'{percent(fitted)} on fitted runs'
    return words if held_out is None else f'{words}, {percent(held_out)} on held-out runs'


def estimate_words(item: Estimate) -> str:
    """A value with its standard deviation and unit."""
    return quantity(item.value, item.unit, item.std) if item.std or item.unit else (
        compact(item.value))


def parameter_lines(alone: Mapping[str, Estimate], found: Mapping[str, Estimate]) -> list[str]:
    """One line per base parameter."""
    return [
        f'  {name}: {estimate_words(alone[name])} -> {estimate_words(item)}'
        for name, item in found.items()
    ]
