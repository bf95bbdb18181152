"""Errors of a ring that an identification allows for: rollers, waves of the raceways, small ones.

A wave moves the ring over the load nearly as another K and n do, so that K and n of a ring whose
raceways are not even are wrong by more than noise and unequal rollers explain. Waves are
independent errors, whose standard deviation is a power of the number of their maxima, the same in
each row. Sizes and powers are compared, together with the noise beside them, and count by the
restricted likelihood of the residuals (H. D. Patterson and R. Thompson, Biometrika 58 (1971) 545).

Friction, creep, structure and probes of every rig have small errors, which act on D and K, too.
They are drawn from the catalogue, a share of the typical sizes of its effects.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
import math

import numpy as np

from saddlering_ros.effects import (
    catalogue,
    EffectParameter,
    NO_EXTENSION,
    RingEffect,
    RingExtension,
    Variant,
)
from saddlering_ros.effects.raceway_waves import RacewayWaves, ROWS, WAVES
from saddlering_ros.estimation.least_squares import SearchSpace
from saddlering_ros.estimation.process import Array
from saddlering_ros.estimation.whitening import SharedErrors
from saddlering_ros.identification.objective import (
    BEFORE,
    idle,
    OnWork,
    predict,
    Refinement,
    scattered,
    stay_at,
    WeightedObjective,
)
from saddlering_ros.identification.observation import Observation
from saddlering_ros.rig import ContactParameters, Displacement, Rig
from saddlering_ros.rig.geometry import displacement_to_probes, probes_to_displacement
from saddlering_ros.ring.small_errors import (
    at_other_phases,
    certified_errors,
    compressed,
    KNOWN,
    known_errors,
    phase_errors,
    scatter_columns,
    SmallError,
    with_error,
)

WAVE = 1e-6
"""Size [m] by which waves are simulated."""

EACH_WAVE = [
    RacewayWaves().extend(NO_EXTENSION, {one.name: WAVE})
    for one in RacewayWaves.parameters if '_cosine_' in one.name]
"""A wave each. Sines move a ring that is loaded in its plane of symmetry by their square only."""

MAXIMA = np.tile(np.arange(1, WAVES // 2 + 1), len(ROWS))
"""Number of maxima of each wave."""

SIZES = np.geomspace(0.05, 200.0, 31)
"""Standard deviations of a wave with one maximum that are compared, in WAVE."""

POWERS = (0.0, -1.0, -2.0)
"""Powers of the maxima that are compared: errors of form grow with their length on a ring."""

MIN_EXPLAINED = 0.5
"""Share of the power of the misfit beyond noise from which waves count. Waves of 1 to 6 um rms
explain 0.71 to 1.0 of it, friction up to 0.65, many small errors together up to 0.48. A moment
arm, an elevation or a bent load cell explain as much as waves, and bend K and n as they do."""

DRAWS = 128
"""Number of draws of errors. Their errors of deviations are 6 %."""

SMALL_ERRORS = (
    'axial_compliance', 'cylinder_friction', 'film_creep', 'probe_bracket', 'probe_drift',
    'probe_gain', 'probe_height', 'probe_nonlinearity', 'radial_compliance', 'radial_friction',
    'ring_ovalisation', 'settling', 'tilt_compliance', 'tilt_friction')
"""Effects of which every rig has a small error."""

SMALL = 0.1
"""Standard deviation of a small error, as a share of the typical size of its effect."""

LINEARITY = 1e-3
"""Standard deviation of the half waves of a probe's characteristic, as a share of its travel."""

PASSES = 2
"""Number of fits of a law beside errors. A third one moved ln K2 of one of seven rings by 0.05,
all else by 0.02 at most."""

MAX_FIRST_CHI_SQUARE = 2.0
"""Reduced chi square of the first such fit from which it is the last one. Rings with small errors
or waves have 0.93 to 1.6; of 14 rings with one large cause eight have more."""

MAX_USUAL_ERROR = 2.0
"""Error of a given course, in usual ones, up to which errors explain a misfit. A load offset of
1.5 kN has 2.5. A trunnion 60 mm too high has 1.2: ln D1 is 0.06 off, 2.6 stated deviations."""

MAX_PARITY, MAX_IN_PARITY = 1.3, 8.0
"""Parity over its noise up to which usual errors explain it, and what they do together along the
direction in which they are most unlikely, in deviations. On 18 rings with small errors they left
up to 1.12 and did up to 7.0; beside a wedge under two probes 2.2 and 17."""

MIN_EVIDENCE = 5.99
"""Twice the logarithm of the likelihood ratio from which waves count: 95 % quantile of chi square
of size and power. Even rings reach 1.4."""


@dataclass(frozen=True)
class Waves:
    """Standard deviation of each wave (W,), in WAVE, and the share of the misfit they explain."""

    sizes: Array
    share: float

    def drawn(self, seed: int) -> list[RingExtension]:
        """Draws of cosine and sine of each wave."""
        names = [one.name for one in RacewayWaves.parameters]
        sizes = WAVE * np.repeat(self.sizes, 2)
        draws = sizes * np.random.default_rng(seed).standard_normal((DRAWS, sizes.size))
        return [RacewayWaves().extend(NO_EXTENSION, dict(zip(names, one, strict=True)))
                for one in draws.tolist()]

    @property
    def rms(self) -> float:
        """Rms [m] of the waves of a raceway."""
        return WAVE * math.sqrt(float(self.sizes @ self.sizes) / len(ROWS) / 2.0)


def waves_of(residual: Array, sound: Array, waves: Array, freedom: int) -> Waves:
    """The waves that whitened residuals (R,) show, or sizes of 0 where they need none.

    sound (M, R), waves (W, R): changes of the residuals by small errors of a sound ring and by
    each wave; freedom: of the residuals. All are what the free parameters cannot imitate.
    """
    errors = np.vstack([sound, waves])
    power, along, products = float(residual @ residual), errors @ residual, errors @ errors.T
    noise = np.geomspace(0.5, 2.0 * max(power / freedom, 1.0), 60)[:, None]
    found = []
    for sizes in (0.0 * MAXIMA, *(size * MAXIMA**power for power in POWERS for size in SIZES)):
        scale = np.concatenate([np.ones(len(sound)), sizes])
        values, vectors = np.linalg.eigh(products * np.outer(scale, scale))
        values, seen = np.maximum(values, 0.0), (vectors.T @ (scale * along)) ** 2
        # Twice the negative logarithm of the likelihood, by noise.
        deviance = (freedom * np.log(noise[:, 0]) + np.log1p(values / noise).sum(axis=1)
                    + (power - (seen / (noise + values)).sum(axis=1)) / noise[:, 0])
        place = int(np.argmin(deviance))
        found.append((float(deviance[place]), float(noise[place, 0]), sizes))
    least, remains, sizes = min(found, key=lambda one: one[0])
    share = (power / freedom - remains) / max(power / freedom - 1.0, 1e-12)
    if found[0][0] - least < MIN_EVIDENCE:
        return Waves(0.0 * sizes, min(max(share, 0.0), 1.0))
    weights = np.exp(0.5 * (least - np.array([deviance for deviance, _, _ in found])))
    variances = weights @ np.array([sizes**2 for _, _, sizes in found]) / weights.sum()
    return Waves(np.sqrt(variances), min(share, 1.0))


@dataclass(frozen=True)
class RingErrors:
    """Changes of the whitened residuals (M, R) of a fit by one deviation of errors of its ring.

    known: by clearances and the weight; each_wave: by errors that are the waves together; others:
    further ones that the intervals allow for.
    """

    rollers: Array
    known: Array
    waves: Waves
    each_wave: Array
    others: Array

    @property
    def sound(self) -> Array:
        """Those of a ring with even raceways and exact instruments."""
        return np.vstack([self.rollers, self.known])


def errors_of_ring(
    objective: WeightedObjective, best: Refinement, on_work: OnWork = idle) -> RingErrors:
    """Errors of a fit on even raceways, and the waves that explain most of its misfit."""
    rollers, known = _sound_errors(objective, best.contact)
    each = objective.whiten(_changes(objective, best.contact, EACH_WAVE, on_work))
    waves = waves_of(
        unlike(best, objective.residuals(best.contact[None])[0]),
        unlike(best, compressed(np.vstack([rollers, known]).T).T), unlike(best, each),
        degrees_of_freedom(objective, best))
    if waves.share < MIN_EXPLAINED:
        waves = replace(waves, sizes=0.0 * waves.sizes)
    return RingErrors(rollers, known, waves, waves.sizes[:, None] * each, each[:0])


@dataclass(frozen=True)
class Beside:
    """An objective beside errors of ring and rig.

    steady: number of those of a given course, which come first; waves: that the residuals show.
    """

    objective: WeightedObjective
    steady: int
    waves: Waves

    def is_usual(self, contact: Array) -> bool:
        """Whether a law (6,) makes errors of usual size of a given course likely."""
        return bool(np.abs(self.objective.likely(contact)[:self.steady]).max() <= MAX_USUAL_ERROR)


def beside_errors(objective: WeightedObjective, space: SearchSpace, law: ContactParameters,
                  usual: Sequence[SmallError], seed: int, on_work: OnWork) -> Beside | None:
    """The objective beside errors of the ring, and `usual` and certified ones of its rig.

    None if these do not explain the parity, which a rigid ring does not move.
    """
    contact, rig = law.to_array(), objective.rig
    steady = _steady_changes(objective, contact, usual, on_work)
    stated = objective.changes(contact, [
        with_error(rig, error) for source, error in certified_errors(rig).items()
        if source not in KNOWN], on_work)
    count = len(steady[0])
    given = [np.concatenate(both) for both in zip(steady, stated, strict=True)]
    if not is_parity_usual(objective.observations, given):
        return None
    further = np.vstack([objective.whiten(given), *_sound_errors(objective, contact)])
    loops = _changes(objective, contact, loops_drawn(rig, seed), on_work)
    beside = objective.beside([loops], further)
    here = stay_at(beside, space, law)
    waves = waves_of(
        unlike(here, beside.residuals(contact[None])[0]), further[:0],
        unlike(here, beside.whiten(_changes(objective, contact, EACH_WAVE, on_work))),
        degrees_of_freedom(beside, here))
    if not waves.rms:
        return Beside(beside, count, waves)
    wavy = _changes(objective, contact, waves.drawn(seed), on_work)
    return Beside(objective.beside([loops, wavy], further), count, waves)


def is_parity_usual(observations: Sequence[Observation], changes: Sequence[Array]) -> bool:
    """Whether errors of usual size explain the parity.

    changes: (M, 4, N) of the increments of each run by an error each. The noise of the parity is
    that of delta_x if both radial probes have equal noise.
    """
    zeros = np.diag([one.zero_error[0] for one in observations])
    errors = [np.vstack([moved[:, 3], np.outer(zero, np.ones(one.time.size))])
              for one, moved, zero in zip(observations, changes, zeros, strict=True)]
    white = np.vstack([
        one.whitening[0].whiten(np.nan_to_num(np.vstack([one.parity, moved])).T)
        for one, moved in zip(observations, errors, strict=True)])
    residual, shared = white[:, 0], SharedErrors.of(white[:, 1:])
    left = shared.apply(residual)
    count = sum(int(np.count_nonzero(one.whitening[0].present)) for one in observations)
    if left @ left > count * MAX_PARITY**2:
        return False
    return bool(np.abs(left @ shared.directions).max(initial=0.0) <= MAX_IN_PARITY)


def errors_beside(objective: WeightedObjective, best: Refinement, waves: Waves,
                  usual: Sequence[SmallError], seed: int, on_work: OnWork) -> RingErrors:
    """Errors of a fit beside others; those of certificates are no part of them."""
    rollers, known = _sound_errors(objective, best.contact)
    stated = certified_errors(objective.rig)
    is_open = np.tile([source not in stated for source in KNOWN], 2)

    def scatter(draws: Sequence[RingExtension]) -> Array:
        return scattered(objective.whiten(_changes(objective, best.contact, draws, on_work)))

    steady = objective.whiten(_steady_changes(objective, best.contact, usual, on_work))
    return RingErrors(
        rollers, known, waves, scatter(waves.drawn(seed)) if waves.rms else steady[:0],
        np.vstack([known[is_open], steady, scatter(loops_drawn(objective.rig, seed))]))


def _steady_changes(objective: WeightedObjective, contact: Array, errors: Sequence[SmallError],
                    on_work: OnWork) -> list[Array]:
    """Changes (M, 4, N) of each run by these errors, then by small ones of a given course."""
    rig = objective.rig
    machines = [with_error(rig, error) for error in errors]
    machines += [(rig, one) for one in steady_errors(rig)]
    return [np.concatenate(both) for both in zip(
        objective.changes(contact, machines, on_work), probe_curves(objective, contact),
        strict=True)]


Small = tuple[RingEffect, Variant, tuple[EffectParameter, ...]]


def _small_errors(rig: Rig) -> list[Small]:
    """Small errors of which no certificate states another size."""
    stated = {name for error in certified_errors(rig).values() for name in error}
    return [(one, variant, one.parameters_of(variant, rig))
            for name, one in catalogue().items() if name in SMALL_ERRORS and name not in stated
            for variant in one.variants if not variant.frees]


def steady_errors(rig: Rig) -> list[RingExtension]:
    """One deviation of each small error of a given course."""
    return [one.extend(NO_EXTENSION, {
        **{item.name: SMALL * item.scale for item in items}, **variant.values})
        for one, variant, items in _small_errors(rig) if all(item.amplitude for item in items)]


def loops_drawn(rig: Rig, seed: int) -> list[RingExtension]:
    """Draws of friction and creep, small errors whose course may be any usual one, too."""
    random, draws = np.random.default_rng([seed, 1]), []
    loops = [small for small in _small_errors(rig) if not all(item.amplitude for item in small[2])]
    for _ in range(DRAWS):
        extension = NO_EXTENSION
        for one, variant, items in loops:
            values = {item.name: _drawn(item, random) for item in items}
            extension = one.extend(extension, {**values, **variant.values})
        draws.append(extension)
    return draws


def _drawn(item: EffectParameter, random: np.random.Generator) -> float:
    """Value of a small error, or of a parameter of its course."""
    if item.amplitude:
        size = SMALL * item.scale * random.standard_normal()
        return abs(size) if item.one_sided else float(size)
    about = random.uniform(-1.0, 1.0)
    value = item.start * 10.0**about if item.logarithmic else item.start + item.scale * about
    return float(np.clip(value, item.low, item.high))


def _changes(objective: WeightedObjective, contact: Array, errors: Sequence[RingExtension],
             on_work: OnWork = idle) -> list[Array]:
    """Changes of the increments of each run by errors of the ring."""
    return objective.changes(contact, [(objective.rig, one) for one in errors], on_work)


def _sound_errors(objective: WeightedObjective, contact: Array) -> tuple[Array, Array]:
    """Those of rollers, and of clearances and weight."""
    usual = objective.increments(contact[None, :])
    known = [
        np.concatenate(known_errors(
            objective.rig, partial(predict, contacts=contact[None, :], observation=one), moved))
        for one, moved in zip(objective.observations, usual, strict=True)]
    phases = _changes(objective, contact, at_other_phases(NO_EXTENSION))
    rollers = [np.concatenate([scatter, phase_errors(changes)]) for scatter, changes in zip(
        roller_effects(objective, contact), phases, strict=True)]
    return objective.whiten(rollers), objective.whiten(known)


def unlike(best: Refinement, errors: Array) -> Array:
    """Whitened residuals (..., R) less what the parameters imitate."""
    slopes, _ = np.linalg.qr(best.jacobian)
    return np.asarray(errors - (errors @ slopes) @ slopes.T)


def degrees_of_freedom(objective: WeightedObjective, best: Refinement) -> int:
    """Those of the residuals of a fit."""
    return max(1, objective.size - best.point.size)


def probe_curves(objective: WeightedObjective, contact: Array) -> list[Array]:
    """Increments (M, 4, N) of each run by one deviation of the linearity of each probe."""
    rig = objective.rig
    probes = [displacement_to_probes(rig.probes, Displacement(x, y, gamma, 0.0 * x))
              for ((x, y, gamma),) in objective.increments(contact[None, :])]
    travel = np.max([np.abs(moved).max(axis=1) for moved in probes], axis=0)[:, None]
    return [_read_as(rig, np.stack([
        np.where(np.arange(4)[:, None] == number - 1, LINEARITY * travel * np.sin(
            waves * np.pi * moved / travel), 0.0)
        for number in rig.probes.present for waves in (1, 2, 3)], axis=1)) for moved in probes]


def _read_as(rig: Rig, moved: Array) -> Array:
    """Increments (M, 4, N) that probes (4, M, N) [m] read."""
    return np.swapaxes(probes_to_displacement(rig.probes, moved).channels, 0, 1)


def roller_effects(objective: WeightedObjective, contact: Array) -> list[Array]:
    """Increments (M, 3, N) of each run by one standard deviation of each roller's scatter.

    Runs share the M rollers, because the same rollers are unequal in each of them.
    """
    usual = objective.increments(contact[None, :])
    rig, effects = objective.rig, []
    for one, increments in zip(objective.observations, usual, strict=True):
        x, y, gamma = np.concatenate([np.zeros((3, 1)), increments[0]], axis=1)
        probes = displacement_to_probes(rig.probes, Displacement(x, y, gamma, 0.0))
        columns = scatter_columns(
            rig, contact, one.elevation, one.zero_load,
            np.append(one.time[0] - BEFORE, one.time), probes, static=not one.dynamic)
        since_zero = np.ascontiguousarray((columns[:, 1:] - columns[:, :1]).transpose(0, 2, 1))
        effects.append(_read_as(rig, since_zero))
    return effects
