"""The types of a verdict's document, the JSON of interfaces.md.

Terminal, report, live page and demo print from the document, and mypy checks the keys that they
read.
"""

from __future__ import annotations

from typing import Any, cast, TypedDict

Shares = dict[str, float]


class SizeEntry(TypedDict):
    """A parameter of a cause in SI units; std 0 for a chosen parameter that is not fitted."""

    value: float
    std: float
    unit: str


class EvidenceEntry(TypedDict):
    """Evidence for a cause."""

    p_value: float | None
    delta_bic: float | None


class ReductionEntry(TypedDict):
    """Shares by which the misfit falls; held_out None without held-out runs."""

    fit: float
    held_out: float | None


class TotalReductionEntry(ReductionEntry):
    """Gain of all causes together; how: 'held out' or 'held out in turn'."""

    how: str


class _CausePartial(TypedDict, total=False):
    partial: bool
    title: str
    share_of_range: float


class CauseEntry(_CausePartial):
    """A cause of the catalogue; group: every id that these data cannot separate from it."""

    effect: str
    group: list[str]
    parameters: dict[str, SizeEntry]
    evidence: EvidenceEntry
    gain: ReductionEntry


class _ShapeWords(TypedDict, total=False):
    shape: str


class ShapeEntry(_ShapeWords):
    """A part of the misfit that no cause explains."""

    channel: str
    coordinate: str
    p_value: float | None
    share_of_range: float


class ChannelEntry(TypedDict):
    """Misfits of a channel as shares of its range in the run."""

    nrmse_before: float | None
    nrmse_after: float | None
    noise_floor: float | None


class RunEntry(TypedDict):
    """One run with its channels by name."""

    bag: str
    elevation_deg: float
    test: str
    held_out: bool
    channels: dict[str, ChannelEntry]


class _ParametersMore(TypedDict, total=False):
    before_std: dict[str, float | None]
    undetermined: dict[str, dict[str, str]]


class ParametersEntry(_ParametersMore):
    """Contact parameters by name; `after` holds K1_std to D2_std as well."""

    before: dict[str, float]
    after: dict[str, Any]


class CandidateEntry(TypedDict):
    """A model that was fitted: its effects, the last one new in its step."""

    effects: list[str]
    step: int
    p_value: float | None
    share_of_range: float | None
    delta_bic: float | None
    misfit: float | None
    parameters: dict[str, dict[str, float]]


class ImmaterialEntry(TypedDict):
    """Effects that are real and too small to matter."""

    effects: list[str]
    p_value: float | None
    share_of_range: float | None


class LimitEntry(TypedDict):
    """Detection limit of one effect in these data: sizes of its first parameter."""

    effect: str
    limit: float | None
    best_limit: float | None
    material_limit: float | None
    unit: str
    share: float
    testable: bool
    places: list[dict[str, Any]]


class ShapesEntry(TypedDict):
    """Every test of the misfit against a coordinate, before and after."""

    before: list[ShapeEntry]
    after: list[ShapeEntry]


class SimulatedTestEntry(TypedDict):
    """A test of an `ambiguous` verdict, simulated with each open model as the truth in turn.

    share_alone: share of the draws that leave only the true model; share_kept: share that
    leave it at all; by_truth: share_alone by the effects of the true model.
    """

    test: str
    kind: str
    draws: int
    share_alone: float
    interval_95: list[float]
    share_kept: float
    by_truth: Shares


class _VerdictMore(TypedDict, total=False):
    simulated_tests: list[SimulatedTestEntry]
    gain: TotalReductionEntry
    detection_limits: list[LimitEntry]
    immaterial: list[ImmaterialEntry]
    unexplained: list[ShapeEntry]
    candidates: list[CandidateEntry]
    shapes: ShapesEntry
    signature_cosines: dict[str, Shares]
    notes: list[str]
    provenance: dict[str, Any]
    seed: int
    seconds: float
    proposal: dict[str, Any] | None


class VerdictDocument(_VerdictMore):
    """The whole document; causes: first the shapes of an `unknown`, then causes."""

    verdict: str
    causes: list[CauseEntry | ShapeEntry]
    runs: list[RunEntry]
    parameters: ParametersEntry
    next_test: str | None


def causes_of(document: VerdictDocument) -> list[CauseEntry]:
    """The causes that are effects of the catalogue."""
    return [cast(CauseEntry, cause) for cause in document['causes'] if 'effect' in cause]


def shapes_of(document: VerdictDocument) -> list[ShapeEntry]:
    """The parts of the misfit that no cause explains."""
    return [cause for cause in document['causes'] if 'effect' not in cause]
