"""Causes that are steady lines, searched on stretches at rest, beside the fitted causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.detection_limits import DetectionLimit
from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.gain import Gain
from saddlering_ros.discrepancy.lines import find_line, Line, line_gain
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.results import Cause, Estimate, Evidence
from saddlering_ros.discrepancy.settings import Settings
from saddlering_ros.discrepancy.slow_lines import find_slow_lines, SlowLine
from saddlering_ros.discrepancy.system import Effect, RunBlocks
from saddlering_ros.estimation.rest import RestSegment


@dataclass(frozen=True)
class SteadyLines:
    """Lines that are causes, lines that are too small, and the detection limit."""

    causes: tuple[Cause, ...]
    immaterial: tuple[Evidence, ...]
    limits: tuple[DetectionLimit, ...]


def find_steady_lines(
    experiment: Experiment, runs: Sequence[RunBlocks], settings: Settings, trials: int
) -> SteadyLines:
    """Lines in the stretches at rest of the fitted runs, for every effect that is a line."""
    rest = [segment for run in experiment.runs for segment in run.rest]
    held_out = [segment for run in runs if run.held_out for segment in run.rest]
    causes, immaterial, limits = [], [], []
    for effect in experiment.system.effects:
        if not effect.line:
            continue
        search = find_line(rest, settings.error_rate / trials)
        limits.append(_limit(effect, search.limit, _material_limit(experiment, settings)))
        if search.line is None:
            continue
        cause = _cause(experiment, effect, search.line, rest, held_out)
        if cause.visible >= settings.materiality:
            causes.append(cause)
        else:
            immaterial.append(_evidence(cause))
    return SteadyLines(tuple(causes), tuple(immaterial), tuple(limits))


@dataclass(frozen=True)
class Swings:
    """Slow steady lines that are causes, and all runs without them."""

    causes: tuple[Cause, ...]
    runs: tuple[RunBlocks, ...]


def find_swings(
    metric: Metric, base: Fit, runs: Sequence[RunBlocks], settings: Settings, trials: int
) -> Swings | None:
    """The material slow lines in the residual of the base fit, in motion or not."""
    experiment = metric.experiment
    effect = next((item for item in experiment.system.effects if item.line), None)
    if effect is None:
        return None
    left = metric.without_nuisances(base.prediction - experiment.measured)
    fitted = dict(zip([run.name for run in experiment.runs], experiment.by_run(left), strict=True))
    residuals = [
        fitted[run.name]
        if run.name in fitted
        else experiment.system.predict_many(run, [base.point])[0] - run.channels
        for run in runs
    ]
    found, cleaned = find_slow_lines(runs, residuals, settings.error_rate / trials)
    causes = [_swing_cause(experiment, effect, item) for item in found]
    material = tuple(cause for cause in causes if cause.visible >= settings.materiality)
    return Swings(material, cleaned) if material else None


def _swing_cause(experiment: Experiment, effect: Effect, found: SlowLine) -> Cause:
    cause = _cause(experiment, effect, found.line, found.segments, ())
    return replace(cause, gain=replace(cause.gain, how='in the residual, its phase free'))


def _material_limit(experiment: Experiment, settings: Settings) -> float:
    """Amplitude of a line with the smallest material rms in some view."""
    widest = max(
        float(np.abs(weights).max()) / experiment.view_ranges[view]
        for view, weights in experiment.system.views.items()
    )
    return float(settings.materiality * np.sqrt(2.0) / widest)


def _limit(effect: Effect, limit: float, material: float) -> DetectionLimit:
    seen = bool(np.isfinite(limit))
    return DetectionLimit(effect.id, float(seen), limit, limit, material, effect.size.unit, seen)


def _cause(
    experiment: Experiment,
    effect: Effect,
    line: Line,
    rest: Sequence[RestSegment],
    held_out: Sequence[RestSegment],
) -> Cause:
    """The line as a cause, in the variant whose channels are closest to those with the line."""
    hit = {int(channel) for channel in np.flatnonzero(line.own)}
    variant = min(range(len(effect.line)), key=lambda item: len({*effect.line[item]} ^ hit))
    own = line.amplitude * line.own
    visible = max(
        float(np.abs(weights) @ own) / experiment.view_ranges[view]
        for view, weights in experiment.system.views.items()
    ) / np.sqrt(2.0)
    gain = Gain(
        line_gain(rest, line.frequency, own),
        line_gain(held_out, line.frequency, own) if held_out else None,
        'at rest, its phase free',
    )
    return Cause(
        effect=effect.id,
        definition=effect,
        variant=variant,
        group=(effect.id,),
        parameters=_parameters(effect, variant, line),
        p_value=line.p_value,
        delta_bic=line.delta_bic,
        visible=float(visible),
        gain=gain,
    )


def _parameters(effect: Effect, variant: int, line: Line) -> dict[str, Estimate]:
    channels = np.zeros(line.amplitude.size)
    channels[list(effect.line[variant])] = 1.0
    amplitude = float(channels @ line.amplitude / channels.sum())
    deviation = float(np.sqrt(channels @ line.deviation**2) / channels.sum())
    # Linear interpolation to common instants reduces a swing by up to this share.
    lost = (2.0 * np.pi * line.frequency * line.step) ** 2 / 8.0
    deviation = float(np.hypot(deviation, lost * amplitude))
    cosine, sine, frequency = effect.ordered
    return {
        cosine.name: Estimate(amplitude, deviation, cosine.unit),
        sine.name: Estimate(0.0, deviation, sine.unit),
        frequency.name: Estimate(line.frequency, 0.0, frequency.unit),
        **{
            key: Estimate(float(value), 0.0, '') for key, value in effect.variants[variant].items()
        },
    }


def _evidence(cause: Cause) -> Evidence:
    return Evidence(
        step=0,
        effects=(cause.effect,),
        variants=(cause.variant,),
        misfit=0.0,
        delta_bic=cause.delta_bic,
        p_value=cause.p_value,
        visible=cause.visible,
        values={cause.effect: {name: item.value for name, item in cause.parameters.items()}},
    )
