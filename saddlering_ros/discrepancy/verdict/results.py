"""A diagnosis as numbers and arrays, for console, JSON and report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from saddlering_ros.discrepancy.law.proposal import LawProposal
from saddlering_ros.discrepancy.next_test import Separation
from saddlering_ros.discrepancy.problem.experiment import Metric
from saddlering_ros.discrepancy.problem.fits import Fit, Gain
from saddlering_ros.discrepancy.problem.system import Array, Effect, RunBlocks
from saddlering_ros.discrepancy.search.comparison import SearchLog
from saddlering_ros.discrepancy.search.lack_of_fit import FastResidual, ShapeTest, SlowResidual
from saddlering_ros.discrepancy.search.limits import Observability
from saddlering_ros.quantities import (
    CHANCE,
    compact,
    percent,
    probability,
    quantity,
    VERDICT_WORDS,
)

Verdict = Literal['none', 'named', 'ambiguous', 'unknown']


@dataclass(frozen=True)
class Estimate:
    """A fitted number with its standard deviation."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Cause:
    """A found cause: the id of its effect, its alternatives, its evidence and its gain.

    partial: the cause is real, and something else is wrong besides.
    """

    effect: str
    definition: Effect
    variant: int
    group: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    p_value: float
    delta_bic: float
    visible: float
    gain: Gain
    partial: bool = False


@dataclass(frozen=True)
class RunPrediction:
    """Predictions for one run, (C, N) each, with offsets: without and with the causes."""

    run: RunBlocks
    before: Array
    after: Array


@dataclass(frozen=True)
class Residual:
    """The residual of a model: slow and fast structure, and tests on shapes in each coordinate.

    consistency: tests whether parameters and laws fit everywhere alike, for declared models.
    """

    slow: SlowResidual
    fast: FastResidual
    shapes: tuple[ShapeTest, ...]
    consistency: tuple[ShapeTest, ...] = ()

    def inflation(self, error_rate: float) -> float:
        """Factor of the variances for a remaining misfit, even one too small to matter.

        Misfit with the shapes of the parameters changes the parameters.
        """
        ratios = [1.0 + self.slow.excess / self.slow.dimensions]
        ratios += [
            item.statistic / item.dimensions
            for item in self.consistency
            if item.p_value < error_rate
        ]
        return max(1.0, *ratios)


@dataclass(frozen=True)
class PublishedFits:
    """The published fits of the base, and of base and causes, by parameters alone.

    base_covariance: of the base parameters beside the causes, in their units.
    """

    metric: Metric
    before: Fit
    after: Fit
    base_covariance: Array


@dataclass(frozen=True)
class Diagnosis:
    """The whole result: the verdict, and the fits and tests behind it.

    base: base parameters beside the causes; base_alone: without causes; explained: share of
    the misfit; warnings: reasons for a reader's doubt; converged: whether every fit behind the
    verdict converged. law: a proposed law, with `unknown` only. separations: proposed tests,
    the best first, with their separation of an `ambiguous` group.
    """

    verdict: Verdict
    causes: tuple[Cause, ...]
    base: Mapping[str, Estimate]
    base_alone: Mapping[str, Estimate]
    gain: Gain
    explained: float
    next_test: str | None
    warnings: tuple[str, ...]
    converged: bool
    runs: tuple[RunPrediction, ...]
    fits: PublishedFits
    law: LawProposal | None
    residual_before: Residual
    residual_after: Residual
    observability: Observability
    search: SearchLog
    simulations: int
    seconds: float
    separations: tuple[Separation, ...] = ()

    def summary(self) -> str:
        """The verdict in plain lines."""
        from saddlering_ros.discrepancy.verdict.results import summary_text

        return summary_text(self)

    def write_report(self, path: Path | str) -> None:
        """One HTML page that loads nothing from elsewhere."""
        from saddlering_ros.discrepancy.verdict.page import write_page

        write_page(self, Path(path))


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
