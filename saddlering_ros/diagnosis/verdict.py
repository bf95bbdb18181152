"""The verdict on a set of bags: the diagnosis of the engine with the properties of the ring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.diagnosis.contact_law import ContactLaw
from saddlering_ros.diagnosis.contract import VerdictDocument
from saddlering_ros.diagnosis.document import verdict_document
from saddlering_ros.diagnosis.records import Array, PreparedRecord
from saddlering_ros.discrepancy import Diagnosis, RunBlocks
from saddlering_ros.files import Provenance
from saddlering_ros.rig import (
    CHANNELS,
    ContactParameters,
    measured_displacement,
    ParameterSet,
    ParameterSource,
    Rig,
    with_absent,
)


@dataclass(frozen=True)
class ChannelMisfit:
    """One channel of one run: rms misfit and noise over the channel's measured range."""

    nrmse_before: float
    nrmse_after: float
    noise_floor: float


@dataclass(frozen=True)
class RunFigures:
    """One run with its channels, and its arrays: displacement (4, N) in the order of CHANNELS."""

    record: PreparedRecord
    channels: Mapping[str, ChannelMisfit]
    measured: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class Verdict:
    """The verdict on a set of bags: the engine's diagnosis with the figures of the ring.

    effect_files: where the effects of a proposed law were written, if they were.
    """

    diagnosis: Diagnosis
    runs: tuple[RunFigures, ...]
    notes: tuple[str, ...]
    next_test: str | None
    rig: Rig
    seed: int
    contact_law: ContactLaw
    effect_files: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        return self.diagnosis.verdict

    def extended_parameters(self) -> ParameterSet:
        """Contact parameters after the diagnosis, with the effects found.

        Steady lines are left out, because their phase is new in every run.
        """
        found = self.diagnosis
        values = np.array([estimate.value for estimate in self.contact_law.after.values()])
        effects = (
            {
                cause.effect: {name: item.value for name, item in cause.parameters.items()}
                for cause in found.causes
                if not cause.definition.line
            }
            if found.verdict in ('named', 'ambiguous')
            else {}
        )
        made = self.provenance(held_out=False)
        source = ParameterSource(
            method='diagnose',
            bags=tuple(origin.path for origin in made.bags),
            objective=float(found.fits.after.misfit),
            covariance=self.contact_law.covariance,
            note=f'verdict {found.verdict}, seed {self.seed}',
            sha256=tuple(origin.sha256 for origin in made.bags),
            versions=made.versions_in_words,
            undetermined=self.contact_law.reasons_after,
            rig_hash=self.rig.digest,
        )
        return ParameterSet(ContactParameters.from_array(values), effects, source)

    def provenance(self, *, held_out: bool = True) -> Provenance:
        """Its bags (with those held out, if requested) and the software versions."""
        return Provenance(
            tuple(
                figures.record.test_run.origin
                for figures in self.runs
                if held_out or not figures.record.run.held_out
            )
        )

    def to_json(self) -> VerdictDocument:
        """The contract of interfaces.md, with additions beside it."""
        return verdict_document(self)


def run_figures(
    rig: Rig, found: Diagnosis, record: PreparedRecord, before: Array, after: Array
) -> RunFigures:
    """Misfits and curves of one run, from predictions before and after (C, N)."""
    run = record.run
    seen = [_displacement(rig, item) for item in (run.channels, before, after)]
    channels = {}
    views = found.fits.metric.experiment.system.views
    for index, name in enumerate(CHANNELS):
        if name not in views:
            continue  # A probe is absent.
        measured, first, last = (item[index] for item in seen)
        span = max(float(np.ptp(measured)), 1e-12)
        weights = views[name]
        noise = _noise_floor(found, run, weights)
        channels[name] = ChannelMisfit(
            _rms(first - measured) / span, _rms(last - measured) / span, noise / span
        )
    return RunFigures(record, channels, *seen)


ZERO_SPAN = 0.5
"""Length [s] of the mean that is the zero of a run."""


def _noise_floor(found: Diagnosis, run: RunBlocks, weights: Array) -> float:
    """Rms noise of a view over the block means of the run, with the noise of the zero."""
    known = found.fits.metric.noise
    fitted = run.name if (run.name, 0) in known else _alike(found, run)
    start = float(run.time[0])
    power = sum(
        float(weight) ** 2
        * float(
            np.mean(
                known[fitted, channel].since(run.time, run.width, start - ZERO_SPAN, ZERO_SPAN)
                ** 2
            )
        )
        for channel, weight in enumerate(weights)
        if weight
    )
    return math.sqrt(power)


def _alike(found: Diagnosis, run: RunBlocks) -> str:
    """The fitted run with block means as long as those of a held-out run."""
    width = float(np.median(run.width))
    fitted = found.fits.metric.experiment.runs
    return min(fitted, key=lambda item: abs(np.log(np.median(item.width) / width))).name


def _displacement(rig: Rig, increments: Array) -> NDArray[np.float64]:
    """Channels (4, N) from the increments (C, N) of the probes that the rig has."""
    motion = measured_displacement(rig.probes, with_absent(rig.probes, increments))
    return np.stack([np.asarray(getattr(motion, name)) for name in CHANNELS])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
