"""The verdict on a set of bags: the diagnosis of the engine with the properties of the ring.

The engine's own fit of the base parameters serves its metric and counts model error and other
nuisance parameters. The contact law alone in a verdict is the identification of the same runs, so
that the same bags give the same K, n, D everywhere.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from saddlering_ros import discrepancy, quantities
from saddlering_ros.diagnosis import ring_wording
from saddlering_ros.diagnosis.proposed_law import proposal_document
from saddlering_ros.diagnosis.records import Array, LoadGrid, PreparedRecord
from saddlering_ros.diagnosis.rig_dimensions import title_of_dimension
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Diagnosis
from saddlering_ros.effects.raceway_waves import as_effect, Raceways, rms_of
from saddlering_ros.estimation.least_squares import AT_BOUND
from saddlering_ros.files import Provenance
from saddlering_ros.identification.result import Identification
from saddlering_ros.identification.uncertainty import reason_wide, reasons_at_bounds
from saddlering_ros.rig import CHANNELS, ContactParameters, PARAMETER_NAMES, PARAMETER_UNITS, Rig
from saddlering_ros.rig.geometry import measured_displacement, WINDOW_SECONDS, with_absent
from saddlering_ros.rig.parameter_file import ParameterSet, ParameterSource
from saddlering_ros.ring.small_errors import sound_deviation

MIN_COSINE = 0.3
"""Cosine below which two signatures are left out of the verdict's JSON."""


@dataclass(frozen=True)
class ContactLaw:
    """Contact parameters by name, alone (before) and beside the causes found (after).

    covariance (6, 6): of the values after; reasons by name: why the fitted runs do not
    determine a parameter; refusal: why the runs could not be identified, '' if they could.
    """

    before: Mapping[str, discrepancy.Estimate]
    after: Mapping[str, discrepancy.Estimate]
    covariance: Array
    reasons_before: Mapping[str, str]
    reasons_after: Mapping[str, str]
    refusal: str = ''

    def as_dict(self) -> dict[str, Any]:
        """The section `parameters` of the JSON."""
        return {
            'before': {name: estimate.value for name, estimate in self.before.items()},
            'after': {key: number for name, estimate in self.after.items() for key, number in (
                (name, estimate.value),
                (f'{name}_std', None if name in self.reasons_after else estimate.std))},
            'before_std': {name: None if name in self.reasons_before else estimate.std
                           for name, estimate in self.before.items()},
            'undetermined': {
                'before': dict(self.reasons_before), 'after': dict(self.reasons_after)}}


def contact_law(diagnosis: Diagnosis, alone: Identification | str, elevations: int) -> ContactLaw:
    """The contact law of the fitted runs, alone and after a diagnosis.

    alone: the identification of the runs, or the reason why they cannot be identified. With
    causes in the model, the values after are those of the engine.
    """
    # The base has waves of the raceways, too, where these are fitted.
    law_alone, law_beside = ({name: base[name] for name in PARAMETER_NAMES}
                             for base in (diagnosis.base_alone, diagnosis.base))
    covariance = diagnosis.fits.base_covariance[:len(law_beside), :len(law_beside)]
    if isinstance(alone, str):
        before = _still_open(law_alone, {}, elevations)
        after = _still_open(law_beside, before, elevations)
        return ContactLaw(law_alone, law_beside, covariance, before, after, alone)
    estimates = {
        name: discrepancy.Estimate(value, deviation, PARAMETER_UNITS[name])
        for name, value, deviation in zip(
            PARAMETER_NAMES, alone.parameters.contact.to_array().tolist(),
            np.sqrt(np.diag(alone.covariance)).tolist(), strict=True)}
    if not diagnosis.causes:
        of_noise = alone.parameters.source.covariance
        assert of_noise is not None
        return ContactLaw(estimates, estimates, of_noise, alone.reasons, alone.reasons)
    stopped = {name for name, place in zip(
        PARAMETER_NAMES, diagnosis.fits.after.theta_unit.tolist(), strict=False)
        if min(place, 1.0 - place) < AT_BOUND}
    after = _still_open(law_beside, reasons_at_bounds(stopped) | alone.reasons_even, elevations)
    return ContactLaw(estimates, law_beside, covariance, alone.reasons, after)


def _still_open(estimates: Mapping[str, discrepancy.Estimate], before: Mapping[str, str],
                elevations: int) -> dict[str, str]:
    """Reasons by name for parameters that a larger model leaves open.

    before: reasons of the contact law alone on even raceways. A parameter that was open before
    stays open, because further unknowns determine nothing.
    """
    reasons = dict(before)
    for name, estimate in estimates.items():
        relative = estimate.std / (1.0 if name[0] == 'n' else max(abs(estimate.value), 1e-300))
        reason = reason_wide(name, relative, elevations)
        if name not in reasons and reason is not None:
            reasons[name] = reason
    return reasons


@dataclass(frozen=True)
class ChannelMisfit:
    """One channel of one run: rms misfit and noise over the channel's measured range.

    sound: what unequal rollers, clearances and the weight of a sound ring may add.
    """

    nrmse_before: float
    nrmse_after: float
    noise_floor: float
    sound: float


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

    @property
    def raceways(self) -> Raceways:
        """Waves of the raceways beside the causes; none where they were not fitted."""
        system = self.diagnosis.fits.metric.problem.system
        assert isinstance(system, RingSystem)
        return system.raceways_at(self.diagnosis.fits.after.point.base)

    def extended_parameters(self) -> ParameterSet:
        """Contact parameters after the diagnosis, with the effects found and waves of raceways.

        Steady lines are left out, because their phase is new in every run, and dimensions, which
        belong in the rig file.
        """
        values = np.array([estimate.value for estimate in self.contact_law.after.values()])
        effects = {
            cause.effect: {name: size.value for name, size in cause.parameters.items()}
            for cause in self.diagnosis.causes if self.verdict in ('named', 'ambiguous')
            and not cause.definition.line and not title_of_dimension(cause.effect)}
        effects |= as_effect(self.raceways)
        made = self.provenance(held_out=False)
        source = ParameterSource(
            method='diagnose', bags=tuple(origin.path for origin in made.bags),
            objective=float(self.diagnosis.fits.after.misfit),
            covariance=self.contact_law.covariance,
            note=f'verdict {self.verdict}, seed {self.seed}',
            sha256=tuple(origin.sha256 for origin in made.bags), versions=made.versions_in_words,
            undetermined=self.contact_law.reasons_after, rig_hash=self.rig.digest)
        return ParameterSet(ContactParameters.from_array(values), effects, source)

    def provenance(self, *, held_out: bool = True) -> Provenance:
        """Its bags (with those held out, if requested) and the software versions."""
        return Provenance(tuple(
            figures.record.test_run.origin for figures in self.runs
            if held_out or not figures.record.run.held_out))

    def to_json(self) -> ring_wording.VerdictDocument:
        """The JSON of docs/diagnosis.md."""
        diagnosis, gain, law = self.diagnosis, self.diagnosis.gain, self.contact_law
        shapes_after = [_shape_entry(shape) for shape in diagnosis.residual_after.shapes]
        document: ring_wording.VerdictDocument = quantities.finite_json({
            'verdict': diagnosis.verdict,
            'causes': _cause_entries(diagnosis),
            'runs': [
                {'bag': str(figures.record.test_run.path),
                 'elevation_deg': float(np.degrees(figures.record.test_run.elevation)),
                 'test': figures.record.test_run.test, 'held_out': figures.record.run.held_out,
                 'channels': {name: vars(misfit) for name, misfit in figures.channels.items()}}
                for figures in self.runs],
            'parameters': law.as_dict(),
            'next_test': self.next_test,
            **diagnosis.certainty(),
            'simulated_tests': [
                {'test': one.proposal.sentence, 'kind': one.proposal.kind, 'draws': one.draws,
                 'share_alone': one.share, 'interval_95': list(one.interval),
                 'share_kept': one.kept / one.draws, 'refitted': one.refitted,
                 'by_truth': {' + '.join(ids): share for ids, share in one.by_truth.items()}}
                for one in diagnosis.separations],
            'detection_limits': [limit_entry(limit) for limit in diagnosis.observability.limits],
            'immaterial': [_evidence_entry(one) for one in diagnosis.search.immaterial],
            'unexplained': shapes_after[:8],
            'candidates': [
                {**_evidence_entry(one), 'step': one.step, 'delta_bic': one.delta_bic,
                 'misfit': one.misfit,
                 'parameters': {effect: dict(values) for effect, values in one.values.items()}}
                for one in diagnosis.search.candidates],
            'shapes': {
                'before': [_shape_entry(shape) for shape in diagnosis.residual_before.shapes],
                'after': shapes_after},
            'signature_cosines': signature_cosines(diagnosis),
            'gain': {'fit': gain.fit, 'held_out': gain.held_out, 'how': gain.how},
            'proposal': proposal_document(diagnosis.law, self.effect_files),
            'notes': list(self.notes),
            'provenance': self.provenance().as_dict(),
            'seed': self.seed,
            'seconds': diagnosis.seconds,
            **({'raceways': rms_of(self.raceways)} if self.raceways else {})})
        document['headline'] = ring_wording.headline(document)
        return document


def run_figures(rig: Rig, diagnosis: Diagnosis, record: PreparedRecord, before: Array,
                after: Array) -> RunFigures:
    """Misfits and curves of one run, from predictions before and after (C, N)."""
    run, channels, metric = record.run, {}, diagnosis.fits.metric
    views, start = metric.problem.system.views, float(run.time[0])
    # The noise of a held-out run is that of the fitted run with block means of about its length.
    noises = [float(np.mean(metric.noise[metric.alike(run).name, channel].since(
        run.time, run.width, start - WINDOW_SECONDS, WINDOW_SECONDS)**2))
        for channel in range(len(run.channels))]
    motions = [measured_displacement(rig.probes, with_absent(rig.probes, increments))
               for increments in (run.channels, before, after)]
    curves = [np.stack([np.asarray(getattr(motion, name)) for name in CHANNELS])
              for motion in motions]
    grid: LoadGrid = run.payload
    law = diagnosis.fits.before.point.base[:len(PARAMETER_NAMES)]
    sound = np.append(sound_deviation(
        rig, law, grid.elevation, grid.block_means(grid.load), grid.zero_load), 0.0)
    for index, name in enumerate(CHANNELS):
        if name not in views:
            continue  # A probe is absent.
        measured, first, last = (curve[index] for curve in curves)
        span = max(float(np.ptp(measured)), 1e-12)
        alone, extended = (
            float(np.sqrt(np.mean((one - measured)**2))) / span for one in (first, last))
        noise = math.sqrt(sum(
            weight**2 * of_channel
            for weight, of_channel in zip(views[name].tolist(), noises, strict=True) if weight))
        channels[name] = ChannelMisfit(alone, extended, noise / span, float(sound[index]) / span)
    return RunFigures(record, channels, *curves)


def unpredicted(runs: Sequence[RunFigures],
                units: Mapping[str, str]) -> list[discrepancy.Remainder]:
    """Misfits of held-out runs that `validate` does not allow a sound ring."""
    return [
        discrepancy.Remainder(
            run.record.run.name, name, misfit.nrmse_after,
            misfit.nrmse_after / misfit.noise_floor, '',
            misfit.nrmse_after * float(np.ptp(run.measured[CHANNELS.index(name)])),
            units[name])
        for run in runs if run.record.run.held_out for name, misfit in run.channels.items()
        if name != 'parity'
        and misfit.nrmse_after > quantities.allowed_misfit(misfit.noise_floor, misfit.sound)]


def limit_entry(limit: discrepancy.DetectionLimit) -> dict[str, Any]:
    """The entry of a limit in a verdict document."""
    names = ('effect', 'limit', 'best_limit', 'material_limit', 'unit', 'share', 'testable')
    return {
        **{name: getattr(limit, name) for name in names},
        'places': [{'values': dict(one.values), 'limit': one.limit,
                    'material_limit': one.material_limit} for one in limit.configurations]}


def _cause_entries(diagnosis: Diagnosis) -> list[discrepancy.CauseEntry | ring_wording.ShapeEntry]:
    """The causes; with `unknown`, first the shapes that no cause explains."""
    if diagnosis.verdict == 'none':
        return []
    causes: list[discrepancy.CauseEntry] = [
        {**cause.entry(), 'titles': [ring_wording.title_of(name) for name in cause.group]}
        for cause in diagnosis.causes]
    if diagnosis.verdict != 'unknown':
        return [*causes]
    after, fast = diagnosis.residual_after, diagnosis.residual_after.fast
    shapes = [_shape_entry(one) for one in shapes_left(after)[:4]]
    entries: list[discrepancy.CauseEntry | ring_wording.ShapeEntry] = [
        {'shape': ring_wording.shape_words(entry), **entry} for entry in shapes]
    if fast.visible >= quantities.MATERIAL:
        entries.append({
            'shape': f'{discrepancy.wording.fast_words(fast, "s")}, '
                     f'{quantities.percent(fast.visible)} of range rms',
            'channel': fast.view, 'coordinate': 'time', 'p_value': fast.p_value,
            'share_of_range': fast.visible})
    for cause in causes:
        cause['partial'] = True
    return [*entries, *causes]


def _evidence_entry(one: discrepancy.Evidence) -> dict[str, Any]:
    return {'effects': list(one.effects), 'p_value': one.p_value, 'share_of_range': one.visible}


def shapes_left(after: discrepancy.Residual) -> list[discrepancy.ShapeTest]:
    """The shapes of a residual that are neither chance nor too small to matter."""
    return [shape for shape in after.shapes if quantities.is_left(shape.p_value, shape.visible)]


def _shape_entry(shape: discrepancy.ShapeTest) -> ring_wording.ShapeEntry:
    return {
        'channel': shape.view, 'coordinate': shape.coordinate, 'p_value': shape.p_value,
        'share_of_range': shape.visible}


def signature_cosines(diagnosis: Diagnosis) -> dict[str, dict[str, float]]:
    """Every signature with similar ones: 1 means that these data cannot separate them."""
    labels = diagnosis.observability.labels
    return {
        label: {other: round(float(value), 3) for other, value in zip(labels, row, strict=True)
                if other != label and value >= MIN_COSINE}
        for label, row in zip(labels, diagnosis.observability.cosines, strict=True)}
