"""A diagnosis as numbers and arrays, for console, JSON and report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.detection_limits import DetectionLimit
from saddlering_ros.discrepancy.gain import Gain
from saddlering_ros.discrepancy.lack_of_fit import FastResidual, ShapeTest, SlowResidual
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.proposal import LawProposal
from saddlering_ros.discrepancy.separation import Separation
from saddlering_ros.discrepancy.system import Array, Effect, RunBlocks

Verdict = Literal['none', 'named', 'ambiguous', 'unknown']


@dataclass(frozen=True)
class Estimate:
    """A fitted number with its standard deviation."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Evidence:
    """A refitted candidate and its likelihood ratio test, for the table of the report."""

    step: int
    effects: tuple[str, ...]
    variants: tuple[int, ...]
    misfit: float
    delta_bic: float
    p_value: float
    visible: float
    values: Mapping[str, Mapping[str, float]]


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


@dataclass
class SearchLog:
    """Candidates in the order in which they were refitted, and findings that were immaterial."""

    candidates: list[Evidence] = field(default_factory=list)
    immaterial: list[Evidence] = field(default_factory=list)


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
class Observability:
    """Observability in these data: detection limits, and cosines between signatures."""

    limits: tuple[DetectionLimit, ...]
    labels: tuple[str, ...]
    cosines: Array


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
        from saddlering_ros.discrepancy.summary import summary_text

        return summary_text(self)

    def write_report(self, path: Path | str) -> None:
        """One HTML page that loads nothing from elsewhere."""
        from saddlering_ros.discrepancy.page import write_page

        write_page(self, Path(path))
