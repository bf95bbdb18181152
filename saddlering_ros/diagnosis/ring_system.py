"""The ring in the form of the engine: contact parameters, effects, roller scatter."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import compress
import math

import numpy as np

from saddlering_ros import effects as catalogue_of_effects
from saddlering_ros.diagnosis import rig_dimensions, ring_wording
from saddlering_ros.diagnosis.records import Array, LoadGrid
from saddlering_ros.discrepancy import Effect, Neighbourhood, Parameter, Point, RunBlocks
from saddlering_ros.effects.base import OvalGap
from saddlering_ros.effects.extension import MOTION, RingExtension
from saddlering_ros.effects.law import Law
from saddlering_ros.effects.raceway_waves import Raceways, waved
from saddlering_ros.rig import MICRO_UNITS, PARAMETER_NAMES, PARAMETER_UNITS, Rig, TRUE_TO_SCALE
from saddlering_ros.rig.geometry import size_factor
from saddlering_ros.ring import small_errors
from saddlering_ros.ring.sensitivity import has_tangent, Neighbourhoods
from saddlering_ros.ring.simulator import Additions, probe_batch

OTHER_SIGN = (0.15, 0.9, 2.7)
"""Sizes of the starts of the other sign, in usual sizes. They differ from all starts of this
sign."""

FINE_STEP = 2e-4
"""Step of sensitivities on a log scale and of K and n, as a share of the range. K and n of one
contact are so similar that the curvature over a step ten times as long looks like a difference,
and a refit then moves along their valley without an end."""

LOAD_STEP = 0.002
"""Change of the load by which its sensitivity is differenced, as a share of full scale."""

FAILED = 1e-3
"""Reading [m] of a failed simulation, far from any measured one."""

STEEP, MAX_STEEP = 3.0, 20
"""Steepness of a block, in usual ones, from which the noise of the load counts; and their largest
number in a run."""

WAVE_SPREAD = 1e-5
"""Standard deviation [m] of the amplitude of a wave where raceways are not even."""

WAVE_REACH = 1e-4
"""Largest size [m] of a combination of waves that is fitted beside causes."""

WAVE_STEP = 1e-7
"""Step [m] of its sensitivity: within it few rollers begin to touch."""

KEPT_POINTS = 4096
"""Number of stored extensions, because every run is simulated at the same effects."""

Candidate = tuple[Array, RingExtension]
"""A contact law (6,) and an extension of the ring."""


def by_tangents(system: 'RingSystem', groups: Sequence[Sequence[Point]]) -> Neighbourhood:
    """`along_tangents` of points, which are simulated where the user's own laws act."""
    if any(system.laws(group[0]) for group in groups):
        return lambda run: [system.predict_many(run, group) for group in groups]
    return along_tangents(
        system, [[system.candidate(point) for point in group] for group in groups])


def along_tangents(
    system: 'RingSystem', candidates: Sequence[Sequence[Candidate]]) -> Neighbourhood:
    """The first of each group simulated in any run, and its neighbours by exact tangents.

    A neighbour without a tangent is simulated, and so is a first one without any that has one.
    """
    # Whether a point after the first of its group has a tangent.
    tangents = [[has_tangent(group[0], other) for other in group[1:]] for group in candidates]
    passes = Neighbourhoods(system.rig, [
        (group[0], list(compress(group[1:], own)))
        for group, own in zip(candidates, tangents, strict=True) if any(own)])

    def predict(run: RunBlocks) -> list[Array]:
        # By tangents; NaN for a point that must be simulated.
        grid: LoadGrid = run.payload
        answers = []
        responses = iter(passes.along(grid.elevation, grid.time, grid.load, grid.zero_load,
                                      grid.max_step, (grid.first, grid.last)))
        for near in tangents:
            answer = np.full((1 + len(near), *run.channels.shape), np.nan)
            if any(near):
                response = next(responses)
                answer[0] = response.centre[system.seen]
                answer[1:][near] = response.neighbours[:, system.seen]
            answers.append(answer)
        missing = [
            (answer, index, candidate)
            for answer, group in zip(answers, candidates, strict=True)
            for index, candidate in enumerate(group) if not np.isfinite(answer[index]).all()]
        if missing:
            simulated = system.simulated(run, [candidate for _, _, candidate in missing])
            for (answer, index, _), values in zip(missing, simulated, strict=True):
                answer[index] = values
        return [np.clip(answer, -10.0 * FAILED, 10.0 * FAILED) for answer in answers]

    return predict


@dataclass(frozen=True)
class RingSystem:
    """The engine's `System` for one rig.

    bounds_rig: the rig of the file, whose bounds the effects have also where a dimension of `rig`
    differs from the file; raceways: waves that are known; directions: combinations of their
    amplitudes (unit vectors), of which the sizes are base parameters beside the contact law; told:
    effects, variants and sizes that the runs show by themselves.
    """

    rig: Rig
    bounds_rig: Rig | None = None
    raceways: Raceways = ()
    directions: Raceways = ()
    told: Sequence[tuple[str, int, float]] = ()
    _kept: dict[tuple[object, ...], tuple[RingExtension, Sequence[Law]]] = field(
        default_factory=dict, repr=False, compare=False)

    @cached_property
    def channel_names(self) -> tuple[str, ...]:
        """The increments of the probes that the rig has."""
        return tuple(f'd{number}' for number in self.rig.probes.present)

    @cached_property
    def seen(self) -> list[int] | slice:
        """Rows of the probes that the rig has among those of all four."""
        probes = self.rig.probes
        return [number - 1 for number in probes.present] if probes.absent else slice(None)

    @cached_property
    def base_parameters(self) -> tuple[Parameter, ...]:
        starts = dict(zip(PARAMETER_NAMES, TRUE_TO_SCALE.to_array(), strict=True))
        law = (
            Parameter(*self.rig.bounds[name], name=name,
                      start=float(np.clip(starts[name], *self.rig.bounds[name])),
                      scale='linear' if name.startswith('n') else 'log',
                      unit=PARAMETER_UNITS[name], step=FINE_STEP)
            for name in PARAMETER_NAMES)
        sizes = (float(np.dot(one, np.ravel(self.raceways))) for one in self.directions)
        return (*law, *(
            Parameter(-WAVE_REACH, WAVE_REACH, name=f'waves {number}', unit='m',
                      start=float(np.clip(size, -WAVE_REACH, WAVE_REACH)),
                      step=WAVE_STEP / (2.0 * WAVE_REACH))
            for number, size in enumerate(sizes, 1)))

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        return tuple(one for effect in catalogue_of_effects.catalogue().values()
                     if not (self.directions and isinstance(effect, OvalGap))
                     for one in engine_effects(effect, self.rig))

    @cached_property
    def inputs(self) -> tuple[Effect, ...]:
        """Dimensions of the rig file, which may be wrong."""
        return rig_dimensions.dimension_effects(self.rig)

    @staticmethod
    def variant_words(effect_id: str, choices: Mapping[str, float]) -> str:
        """The place of an effect; '' if it has one."""
        return ring_wording.variant_words(effect_id, choices)

    @property
    def units(self) -> Mapping[str, str]:
        return {name: unit.removeprefix('µ') for name, unit in MICRO_UNITS.items()}

    @cached_property
    def views(self) -> Mapping[str, Array]:
        probes = self.rig.probes
        views = {
            'delta_x': np.array([0.5, 0.0, -0.5, 0.0]), 'delta_y': np.array([0.0, 0.5, 0.0, 0.5]),
            'gamma': np.array([0.0, 1.0, 0.0, -1.0]) / probes.axial_span,
            'parity': np.array([0.5, 0.0, 0.5, 0.0])}
        if not probes.absent:
            return views
        del views['parity']
        views['delta_x'] *= 2.0  # All of it is of one probe.
        return {name: weights[self.seen] for name, weights in views.items()}

    def predict_many(self, run: RunBlocks, points: Sequence[Point]) -> Array:
        if any(map(rig_dimensions.has_dimensions, points)):
            return np.concatenate(self._by_rig([[point] for point in points])(run))
        candidates = [self.candidate(point) for point in points]
        answer, grid = self.simulated(run, candidates), run.payload
        for number, point in enumerate(points):
            if not (laws := self.laws(point)):
                continue
            # The user's own laws change the load at the ring, or add to the channels (C, N).
            additions = Additions(self.rig, laws, float(grid.time[0]), grid.zero_load)
            at_ring, added = additions.push(grid.time, grid.load)
            if not np.array_equal(at_ring, grid.load):
                changed = replace(run, payload=replace(grid, load=at_ring))
                answer[number] = self.simulated(changed, [candidates[number]])[0]
            answer[number] += grid.block_means(np.ascontiguousarray(added.T[self.seen]))
        return answer

    def neighbourhood(self, groups: Sequence[Sequence[Point]]) -> Neighbourhood:
        """Groups of points with their extensions, and the tangents that each group allows."""
        if any(rig_dimensions.has_dimensions(point) for group in groups for point in group):
            return self._by_rig(groups)
        return by_tangents(self, groups)

    def _by_rig(self, groups: Sequence[Sequence[Point]]) -> Neighbourhood:
        """The groups, with the points of each rig together."""
        return rig_dimensions.neighbourhood_by_rig(
            self.rig, groups,
            lambda rig, own: by_tangents(replace(self, rig=rig, bounds_rig=self.rig), own))

    def simulated(
        self, run: RunBlocks, candidates: Sequence[Candidate]) -> Array:
        """Increments (B, C, N) of the probes that the rig has, for laws with extensions."""
        return self._four_probes(run, candidates)[:, self.seen]

    def _four_probes(
        self, run: RunBlocks, candidates: Sequence[Candidate]) -> Array:
        grid: LoadGrid = run.payload
        means = probe_batch(self.rig, candidates, grid.elevation, grid.time, grid.load,
                            grid.zero_load, grid.max_step, (grid.first, grid.last))
        known = np.nan_to_num(means, nan=FAILED, posinf=FAILED, neginf=-FAILED)
        return np.clip(known, -10.0 * FAILED, 10.0 * FAILED)

    def nuisances(self, runs: Sequence[RunBlocks], point: Point) -> list[Array]:
        """Nuisance columns: rollers, waves, clearances and weight, noise of the load.

        Every instrument with a certificate adds its own error.

        Where rollers begin to touch, a little load moves the ring far. An error of the
        load at the ring then shifts the place of that motion, so that the noise of the
        load shows as much as that of the probes.
        """
        return self.nuisances_at(runs, [point] * len(runs))

    def nuisances_at(self, runs: Sequence[RunBlocks], points: Sequence[Point]) -> list[Array]:
        """The same, each run at a point of its own."""
        parts, known = [], []
        for run, point in zip(runs, points, strict=True):
            usual = self.predict_many(run, [point])[0]  # A law of the user is in it.
            parts.append(np.concatenate(
                [self._roller_columns(run, point), self._wave_columns(run, point)], axis=2))
            known.append(np.stack([
                *small_errors.known_errors(
                    self.rig, partial(self._predict_by, run, point), usual),
                *self.instrument_errors(run, point.base)], axis=-1))
        return [np.concatenate(each, axis=2) for each in zip(
            _compressed(parts), self._load_noise(runs, points), known, strict=True)]

    def other_rollers(self, runs: Sequence[RunBlocks], points: Sequence[Point]) -> list[Array]:
        """Columns (C, N, k) by one standard deviation of unequal rollers, which all runs share."""
        return _compressed(list(map(self._roller_columns, runs, points)))

    def _roller_columns(self, run: RunBlocks, point: Point) -> Array:
        """Changes (C, N, k) by one standard deviation of each roller, and of their place."""
        law, usual = self.candidate(point)
        contacts = self._four_probes(run, [(law, usual.only(MOTION))])[0]
        grid: LoadGrid = run.payload
        static = run.rate is None or not np.any(run.rate)
        scatter = small_errors.scatter_columns(
            self.rig, law, grid.elevation, grid.zero_load, run.time, contacts,
            static=static)[self.seen]
        every = self.simulated(
            run, [(law, one) for one in (usual, *small_errors.at_other_phases(usual))])
        place = small_errors.phase_errors(every[1:] - every[0])
        return np.concatenate([scatter, np.moveaxis(place, 0, -1)], axis=2)

    def _wave_columns(self, run: RunBlocks, point: Point) -> Array:
        """Changes (C, N, k) by one standard deviation of each wave; none without waves."""
        if not self.raceways:
            return np.empty((*run.channels.shape, 0))
        law, usual = self.candidate(point)
        shape = np.shape(self.raceways)
        others = [(law, waved(usual, wave.reshape(shape).tolist()))
                  for wave in WAVE_STEP * np.eye(math.prod(shape))]
        [every] = along_tangents(self, [[(law, usual), *others]])(run)
        columns = np.moveaxis((every[1:] - every[0]) * (WAVE_SPREAD / WAVE_STEP), 0, -1)
        if not self.directions:
            return columns
        fitted = np.array(self.directions)
        return np.asarray(columns - columns @ fitted.T @ fitted)

    def _predict_by(self, run: RunBlocks, point: Point, rig: Rig) -> Array:
        """Channels (C, N) of a run if the ring had the dimensions of another rig."""
        return np.asarray(replace(self, rig=rig).predict_many(run, [point])[0])

    def instrument_errors(self, run: RunBlocks, base: Array) -> list[Array]:
        """Changes (C, N) of a run by one standard uncertainty of each stated instrument.

        Clearances and weight, which every ring has uncertain, are not among them.
        """
        errors = [error for source, error in small_errors.certified_errors(self.rig).items()
                  if source not in small_errors.KNOWN]
        if not errors:
            return []
        predicted = self.predict_many(run, [Point(base), *(Point(base, one) for one in errors)])
        return [one - predicted[0] for one in predicted[1:]]

    def _load_noise(self, runs: Sequence[RunBlocks], points: Sequence[Point]) -> list[Array]:
        """Changes (C, N, k) by noise of the load where a little load moves the ring far.

        There is one column per block; k counts over all runs, each with its own blocks.
        """
        wander = small_errors.LOAD_WANDER * self.rig.full_scale_load
        step = LOAD_STEP * self.rig.full_scale_load
        changes, places = [], []
        for run, point in zip(runs, points, strict=True):
            grid: LoadGrid = run.payload
            law, extension = self.candidate(point)
            # Change (C, N) by one more newton in all of the run, its zero included.
            less, more = self.simulated(run, [
                (law, replace(extension, load_offset=extension.load_offset + change))
                for change in (step, -step)])
            by_newton = (more - less) / (2.0 * step)
            # Of each block or its neighbour, whichever is larger: the block in which a motion
            # ends has as much of its error as the block before.
            widened = np.pad(by_newton, ((0, 0), (1, 1)), mode='edge')
            near = np.stack([widened[:, :-2], by_newton, widened[:, 2:]])
            largest = np.argmax(np.linalg.norm(near, axis=1), axis=0)
            per_newton = near[largest, :, np.arange(largest.size)].T
            white = 0.0 if grid.load_noise is None else grid.load_noise
            changes.append(per_newton * np.hypot(white, wander))
            # Blocks in which a newton moves the ring much further than under load.
            load = next(iter(run.inputs.values()))
            moves = np.linalg.norm(per_newton, axis=0)
            usual = float(np.median(moves[load >= 0.5 * load.max()]))
            steepest = np.argsort(-moves)[:MAX_STEEP]
            places.append(np.sort(steepest[moves[steepest] > STEEP * usual]))
        total, answer, before = sum(map(len, places)), [], 0
        for run, change, place in zip(runs, changes, places, strict=True):
            columns = np.zeros((*run.channels.shape, total))
            columns[:, place, before + np.arange(len(place))] = change[:, place]
            before += len(place)
            answer.append(columns)
        return answer

    def targets(self, run: RunBlocks, point: Point) -> dict[str, Array]:
        """Change by one more newton at the ring, for laws that add to its load.

        The zero of the probes stays where it is: a law counts from there.
        """
        grid, step = run.payload, LOAD_STEP * self.rig.full_scale_load
        less, more = (
            self.simulated(replace(run, payload=replace(grid, load=grid.load + change)),
                           [self.candidate(point)])[0]
            for change in (-step, step))
        return {'hydraulic_load': (more - less) / (2.0 * step)}

    def start_of(self, run: RunBlocks) -> float:
        """The start of the zero window."""
        return float(run.payload.time[0])

    def candidate(self, point: Point) -> Candidate:
        """The contact law of a point, and the extension that its effects and waves set."""
        law = point.base[:len(PARAMETER_NAMES)]
        return law, waved(self._read(point)[0], self.raceways_at(point.base))

    def raceways_at(self, base: Array) -> Raceways:
        """The waves of a ring with these base parameters."""
        if not self.directions:
            return self.raceways
        known, directions = np.ravel(self.raceways), np.array(self.directions)
        moved = (base[len(PARAMETER_NAMES):] - directions @ known) @ directions
        amplitudes: Raceways = (known + moved).reshape(np.shape(self.raceways)).tolist()
        return amplitudes

    def laws(self, point: Point) -> Sequence[Law]:
        """The laws of the user's own effects at a point."""
        return self._read(point)[1]

    def _read(self, point: Point) -> tuple[RingExtension, Sequence[Law]]:
        """The effects of a point as extension and laws of the ring."""
        key = tuple((name, *values.items()) for name, values in point.effects.items())
        if key not in self._kept:
            if len(self._kept) >= KEPT_POINTS:
                self._kept.clear()
            effects = rig_dimensions.without_dimensions(point).effects
            self._kept[key] = (
                catalogue_of_effects.extension_of(effects, self.bounds_rig or self.rig),
                catalogue_of_effects.laws_of(effects))
        return self._kept[key]


def engine_effects(effect: catalogue_of_effects.RingEffect, rig: Rig) -> tuple[Effect, ...]:
    """A ring effect as an engine effect, and its wider forms, which free more parameters.

    The variants of each have the same parameters, of which the amplitude comes first.
    """
    plain = sum(not variant.frees for variant in effect.variants)
    # Channels of each variant of a line on one probe, or on all probes for 0.
    probes = [int(item.values['probe']) for item in effect.variants] if effect.line else []
    effects = []
    for first, stop in [(0, plain), *((n, n + 1) for n in range(plain, len(effect.variants)))]:
        variant = effect.variants[first]
        ordered = sorted(effect.parameters_of(variant, rig), key=lambda item: not item.amplitude)
        parameters = {
            item.name: Parameter(
                item.low, item.high, unit=item.unit,
                scale='log' if item.logarithmic else 'linear',
                start=float(np.clip(item.start, item.low, item.high)),
                neutral=item.neutral if item.amplitude or item is ordered[0] else None,
                limiting_case=item.limiting_case, whole=item.whole,
                step=FINE_STEP if item.logarithmic else float(
                    np.clip(0.003 * abs(item.scale) / (item.high - item.low), 1e-6, 0.02)))
            for item in ordered}
        effects.append(Effect(
            effect.title, parameters,
            variants=tuple(dict(item.values) for item in effect.variants[:stop]),
            starts=_starts(effect, ordered, rig), settled_by=effect.settled_by,
            line=tuple((probe - 1,) if probe else (0, 1, 2, 3) for probe in probes),
            form=effect.form, id=effect.id, first_variant=first, contains=variant.contains))
    return tuple(effects)


def _starts(effect: catalogue_of_effects.RingEffect,
            ordered: Sequence[catalogue_of_effects.EffectParameter],
            rig: Rig) -> tuple[dict[str, float], ...]:
    """Three sizes at the usual shape, and the starts that the effect declares."""
    size, *shapes = ordered
    factors = (0.2, 1.0, 3.0) if size.neutral == 0.0 else (0.5, 1.0, 1.5)
    sizes = [float(np.clip(factor * size.scale, size.low, size.high)) for factor in factors]
    if size.low < size.neutral < size.high:
        # Only one of the signs may change the contacts of the ring.
        sizes += [float(np.clip(-part * size.scale, size.low, size.high)) for part in OTHER_SIGN]
    usual = {item.name: item.start for item in shapes}
    starts = [{size.name: value, **usual} for value in sizes]
    rig_factors = {item.name: size_factor(item.unit, rig) for item in effect.parameters}
    for declared in effect.starts:
        other = {name: value * rig_factors.get(name, 1.0) for name, value in declared.items()}
        if size.name in other or any(
                other.get(item.name, item.start) != item.start for item in shapes):
            starts.append({**usual, size.name: sizes[1], **other})
    for item in shapes:
        if item.amplitude:
            starts.append({size.name: 0.2 * sizes[1], **usual, item.name: item.scale})
        elif item.logarithmic and not effect.starts:
            starts += [
                {size.name: sizes[1], **usual,
                 item.name: item.low * (item.high / item.low) ** share}
                for share in (0.15, 0.85)]
    return tuple(starts)


def _compressed(parts: Sequence[Array]) -> list[Array]:
    """Columns (C, N, k) of each run with the covariance of `parts`, whose errors runs share."""
    joined = small_errors.compressed(
        np.concatenate([part.reshape(-1, part.shape[-1]) for part in parts]))
    blocks = np.split(joined, np.cumsum([part[..., 0].size for part in parts])[:-1])
    return [block.reshape(*part.shape[:2], -1) for block, part in zip(blocks, parts, strict=True)]
