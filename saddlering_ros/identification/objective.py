"""Distance of simulated from measured runs: weighted least squares, and the published J."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from saddlering_ros.effects import NO_EXTENSION
from saddlering_ros.errors import Cancelled
from saddlering_ros.estimation import least_squares
from saddlering_ros.estimation.least_squares import LazyAnswer, SearchSpace
from saddlering_ros.estimation.process import Array, block_means, span_means
from saddlering_ros.estimation.whitening import independent, SharedErrors
from saddlering_ros.identification.observation import Observation, SETTLING_STEP
from saddlering_ros.identification.settings import IdentificationError
from saddlering_ros.progress import IsCancelled, SearchStep
from saddlering_ros.rig import ContactParameters, PARAMETER_NAMES, Rig
from saddlering_ros.rig.description import DEFAULT_BOUNDS
from saddlering_ros.rig.geometry import probes_to_displacement, with_absent
from saddlering_ros.ring.sensitivity import FollowedMotion, static_sensitivities
from saddlering_ros.ring.simulator import dynamic_batch, in_parallel, probe_batch, static_batch
from saddlering_ros.ring.small_errors import Machine

LONGEST_STEP = 2e-3
"""Longest step [s] of the simulator inside a fit."""

COARSE_STEP = 5e-3
"""The same for a run that is simulated on its fit grid."""

MAX_STEPS = 1 << 18
"""Number of steps of one run above which they become longer (after 8.7 min), because motion and
its derivatives at every step are in memory."""

SETTLED = 0.3
"""Whitened length of the settling of all plateaus of a run below which its plateaus may count as
equilibria beside a constant correction, whose change with the parameters is then negligible."""

SEARCH_STEP = 2e-2
"""The same during the swarm and the first descents."""

SEARCH_READINGS = 64
"""Smallest number of readings of a dynamic run during the swarm."""


def predict(rig: Rig, contacts: Array, observation: Observation) -> Array:
    """Simulated increments since zero (B, 3, N) [m, m, rad] of a run at contacts (B, 6)."""
    loads = np.append(observation.zero_load, observation.load)
    if not observation.dynamic and observation.spans is None:
        still = static_batch(rig, contacts, observation.elevation, loads)
        return np.asarray(still[:, :, 1:] - still[:, :, :1])
    zero = static_batch(rig, contacts, observation.elevation, loads[:1])
    moving = dynamic_batch(
        rig, contacts, observation.elevation, observation.fine_time, observation.fine_load,
        _longest_step(observation))
    return np.asarray(_means(observation, moving) - zero)


OnWork = Callable[[], None]
"""Is called while simulations go on; what it raises ends them."""


def idle() -> None:
    """Report nothing."""


AT_ONCE = 8
"""Number of machines on which a run is simulated at a time, between reports."""

BEFORE = 1.0
"""Length [s] of the rest before the first reading that is the zero, if it is not in the record."""


def changes_on(rig: Rig, contact: Array, observation: Observation, machines: Sequence[Machine],
               on_work: OnWork = idle) -> Array:
    """Changes (M, 4, N) [m, m, rad, m] of the increments of a run on each of M machines.

    rig: whose probes the readings are taken for.
    """
    time = np.append(observation.fine_time[0] - BEFORE, observation.fine_time)
    load = np.append(observation.zero_load, observation.fine_load)

    def seen_on(machine: Machine) -> Array:
        other, extension = machine
        probes = probe_batch(other, [(contact, extension)], observation.elevation, time, load,
                             max_step=_longest_step(observation))[0]
        present = probes[[number - 1 for number in rig.probes.present], 1:]
        seen = probes_to_displacement(rig.probes, with_absent(rig.probes, present))
        return _means(observation, seen.channels)

    usual, changed = seen_on((rig, NO_EXTENSION)), []
    for first in range(0, len(machines), AT_ONCE):
        changed += in_parallel(seen_on, machines[first:first + AT_ONCE])
        on_work()
    return np.reshape(changed, (-1, *usual.shape)) - usual


def scattered(white: Array) -> Array:
    """Changes (M, R) of residuals with the covariance of M draws of them (M, R)."""
    return np.asarray((white - white.mean(axis=0)) / np.sqrt(len(white) - 1))


Followed = tuple[Array, Callable[[], Array]]
"""Increments (3, N) of one run by one law, and their derivatives (6, 3, N) on request."""


def _follow(rig: Rig, contact: Array, observation: Observation) -> Followed:
    """`predict` for one law (6,), stored for its derivatives."""
    elevation = observation.elevation
    loads = np.append(observation.zero_load, observation.load)
    if not observation.dynamic and observation.spans is None:
        still = static_batch(rig, contact, elevation, loads)[0]

        def static_slopes() -> Array:
            slopes = static_sensitivities(rig, contact, elevation, still)
            return np.asarray(slopes[:, :, 1:] - slopes[:, :, :1])

        return np.asarray(still[:, 1:] - still[:, :1]), static_slopes
    zero = static_batch(rig, contact, elevation, loads[:1])[0]
    followed = FollowedMotion(
        rig, contact, elevation, observation.fine_time, observation.fine_load,
        _longest_step(observation))

    def slopes() -> Array:
        at_zero = static_sensitivities(rig, contact, elevation, zero)
        return np.asarray(_means(observation, followed.sensitivities()) - at_zero)

    return np.asarray(_means(observation, followed.motion) - zero), slopes


def _means(observation: Observation, moving: Array) -> Array:
    """Readings (..., N) of a motion (..., M) on the fine grid."""
    if observation.spans is not None:
        return span_means(moving, *observation.spans.T)
    return np.asarray(moving.reshape(*moving.shape[:-1], -1, observation.per_block).mean(axis=-1))


def _longest_step(observation: Observation) -> float:
    if observation.longest_step is not None:
        return observation.longest_step
    if not observation.dynamic:
        return 2.0 * SETTLING_STEP
    usual = LONGEST_STEP if observation.per_block > 1 else COARSE_STEP
    return max(usual, float(observation.fine_time[-1] - observation.fine_time[0]) / MAX_STEPS)


@dataclass
class WeightedObjective:
    """Chi square: residuals of the chosen channels, whitened by the noise of each run."""

    rig: Rig
    observations: Sequence[Observation]
    channels: tuple[int, ...]
    evaluations: int = 0
    shared: list[SharedErrors] = field(default_factory=list, repr=False)
    common: SharedErrors | None = field(default=None, repr=False)  # errors of all runs together
    _lowest: 'LinearisedFit | None' = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        # From another objective of the same runs with another load.
        self.shared = self.shared or [
            one.shared_errors(self.channels) for one in self.observations]

    def residuals(self, contacts: Array) -> Array:
        """Whitened residuals (B, R), simulated - measured, of contact parameters (B, 6)."""
        self.evaluations += len(contacts)
        return _numbers(self.whiten(self._left(contacts)), contacts)

    def linearised(self, contact: Array) -> 'LinearisedFit':
        """Whitened residuals (R,) at contact parameters (6,), and their derivatives."""
        self.evaluations += 1
        motions = in_parallel(partial(_follow, self.rig, contact), self.observations)
        white = self.whiten([
            (increments - seen.displacement)[None]
            for (increments, _), seen in zip(motions, self.observations, strict=True)])
        residual = _numbers(white, contact[None, :])[0]
        fit = LinearisedFit(self, contact, residual, motions)
        if self._lowest is None or residual @ residual < self._lowest.chi_square:
            self._lowest = fit
        return fit

    def mean_squares(self, contact: Array) -> list[float]:
        """Mean square of the whitened residuals of each run at a contact law (6,)."""
        white = self._of_runs(self.whiten(self._left(contact[None, :])))
        return [float(np.mean(residual**2)) for residual in white]

    def _left(self, contacts: Array) -> list[Array]:
        """Simulated minus measured increments (B, 3, N) of each run."""
        return [increments - one.displacement for increments, one in zip(
            self.increments(contacts), self.observations, strict=True)]

    def increments(self, contacts: Array) -> list[Array]:
        """Simulated increments (B, 3, N) of each run; those of the lowest fit so far are known."""
        lowest = self._lowest
        if lowest is not None and len(contacts) == 1 and np.array_equal(
                contacts[0], lowest.contact):
            return [increments[None] for increments, _ in lowest.followed]
        return [predict(self.rig, contacts, one) for one in self.observations]

    def with_likely_loads(self, contact: Array) -> 'WeightedObjective':
        """The same with the load of dynamic runs corrected by their displacements.

        With little damping the model responds to the load cell's noise by ringing, and the ring
        did not. Without the correction this noise would count as sensitivity to the parameters.
        """
        white = self._plainly_white(self._left(contact[None, :]))
        corrected = [
            one.with_load_less(shared.likely(residual[0]))
            for one, shared, residual in zip(self.observations, self.shared, white, strict=True)]
        return replace(self, observations=corrected)

    def with_settled_plateaus(self, contact: Array) -> 'WeightedObjective':
        """The same with equilibria in place of static runs that come to rest at each load.

        The small difference between the moving ring and equilibria is that at the law `contact`
        (6,). A run in which this difference matters stays a moving one.
        """
        moving = self.increments(contact[None, :])
        settling = [
            increments if one.dynamic
            else increments - predict(self.rig, contact[None, :], one.coarse())
            for one, increments in zip(self.observations, moving, strict=True)]
        lengths = [float(np.linalg.norm(white)) for white in self._of_runs(self.whiten(settling))]
        return replace(self, observations=[
            one if one.dynamic or not length < SETTLED
            else replace(one.coarse(), displacement=one.displacement - increments[0])
            for one, increments, length in zip(self.observations, settling, lengths, strict=True)])

    def changes(
        self, contact: Array, machines: Sequence[Machine], on_work: OnWork = idle) -> list[Array]:
        """Changes (M, 4, N) of the increments of each run on each of M machines."""
        return [changes_on(self.rig, contact, one, machines, on_work)
                for one in self.observations]

    def beside(self, drawn: Sequence[Sequence[Array]], further: Array) -> 'WeightedObjective':
        """The same beside errors that all runs share, which are no parameters of the fit.

        drawn: of each kind of error the changes (M, 4, N) of the increments of each run by M
        draws, of any mean; further: whitened residuals (k, R) by one deviation of other ones.
        """
        means = [[moved.mean(axis=0) for moved in kind] for kind in drawn]
        about = [scattered(self.whiten(kind)) for kind in drawn]
        return replace(
            self, evaluations=0, common=SharedErrors.of(np.vstack([further, *about]).T),
            observations=[replace(one, displacement=one.displacement - sum(of_run)[:3])
                          for one, *of_run in zip(self.observations, *means, strict=True)])

    def likely(self, contact: Array) -> Array:
        """Errors of `beside`, further ones first, that a law (6,) makes most likely."""
        residual = self.residuals(contact[None, :])[0]
        return np.zeros(0) if self.common is None else self.common.likely(residual)

    def whiten(self, raw: Sequence[Array]) -> Array:
        """Residuals (B, R) of unit covariance of all runs, from raw ones (B, 3, N) of each."""
        white = np.concatenate([
            shared.apply(residuals.T).T
            for residuals, shared in zip(self._plainly_white(raw), self.shared, strict=True)
        ], axis=1)
        return white if self.common is None else self.common.apply(white.T).T

    def _of_runs(self, white: Array) -> list[Array]:
        """The part of each run in whitened residuals (B, R)."""
        sizes = [len(self.channels) * one.time.size for one in self.observations]
        return np.split(white, np.cumsum(sizes)[:-1], axis=1)

    def _plainly_white(self, raw: Sequence[Array]) -> list[Array]:
        """The same without errors of load and zero."""
        channels = list(self.channels)
        return [
            one.whiten(residuals[:, channels], self.channels)
            for one, residuals in zip(self.observations, raw, strict=True)]

    def __call__(self, contacts: Array) -> Array:
        """Chi square (B,)."""
        return np.asarray(np.sum(self.residuals(contacts) ** 2, axis=1))

    @property
    def size(self) -> int:
        """Number of residuals that count; the others are 0."""
        return sum(int(np.count_nonzero(one.whitening[channel].present))
                   for one in self.observations for channel in self.channels)


@dataclass(frozen=True)
class LinearisedFit:
    """Whitened residuals (R,) of a contact law (6,), with its motions for the derivatives."""

    objective: WeightedObjective
    contact: Array
    residual: Array
    followed: Sequence[Followed]

    @property
    def chi_square(self) -> float:
        return float(self.residual @ self.residual)

    def slopes(self) -> Array:
        """Derivatives (6, R) of the whitened residuals by the contact parameters."""
        raw = in_parallel(lambda slopes: slopes(), [slopes for _, slopes in self.followed])
        return self.objective.whiten(raw)


@dataclass
class PaperObjective:
    """J = J_dx / m_dx + J_gamma / m_gamma, averaged over runs, with equal weight of every sample.

    J_c = (1/N) sum (simulated - measured)^2. The paper's m_c are not published. Here m_c is
    the mean square of the measured channel, which brings the channels to one level.
    """

    rig: Rig
    observations: Sequence[Observation]
    channels: tuple[int, ...]
    evaluations: int = 0

    def __call__(self, contacts: Array) -> Array:
        """J (B,) of contact parameters (B, 6)."""
        self.evaluations += len(contacts)
        total = np.zeros(len(contacts))
        for one in self.observations:
            simulated = predict(self.rig, contacts, one)
            for channel in self.channels:
                measured = one.displacement[channel]
                error = np.mean((simulated[:, channel] - measured) ** 2, axis=1)
                total += error / np.mean(measured**2)
        return _numbers(total, contacts) / len(self.observations)


def _numbers(values: Array, contacts: Array) -> Array:
    """Values (B, ...) of contacts (B, 6); IdentificationError if one of them is not a number."""
    missing = np.isnan(values).reshape(len(values), -1).any(axis=1)
    if not missing.any():
        return values
    at = dict(zip(PARAMETER_NAMES, contacts[int(np.argmax(missing))].tolist(), strict=True))
    words = ', '.join(f'{name}={value:.4g}' for name, value in at.items())
    for name, (low, high) in DEFAULT_BOUNDS.items():
        if not low <= at[name] <= high:
            raise IdentificationError(
                f'the bounds of {name} reach too far: the objective is not a number at {words}: '
                'give narrower ones (--bounds, or bounds in the rig file), '
                f'from {low:.3g} to {high:.3g}')
    raise IdentificationError(f'the objective is not a number at {words}: check the bags for '
                              'missing values')


def average_branches(observation: Observation, level_step: float) -> Observation:
    """The paper's static readings: mean of the loading and unloading reading of each load step.

    Steps are separated by rounding to `level_step` [N]; a step read on one branch only is kept
    as it is. The result's readings count as independent.
    """
    steps = np.round(observation.load / level_step).astype(int)
    levels = np.unique(steps)
    weights = np.zeros((len(levels), len(steps)))  # readings averaged into each step
    for row, level in enumerate(levels):
        loading = observation.branch >= 0
        sides = [np.flatnonzero((steps == level) & side) for side in (loading, ~loading)]
        sides = [members for members in sides if len(members)]
        for members in sides:
            weights[row, members] = 1.0 / (len(sides) * len(members))
    variance = observation.standard_error**2 @ (weights.T**2)
    time, load = weights @ observation.time, weights @ observation.load
    return _with_means(observation, time, load, observation.displacement @ weights.T, variance)


def thinned(observation: Observation) -> Observation:
    """Means of successive readings, about `SEARCH_READINGS`, which count as independent."""
    size = max(1, len(observation.time) // SEARCH_READINGS)
    time, load = block_means(observation.time, size), block_means(observation.load, size)
    variance = block_means(observation.standard_error**2, size) / size
    means = _with_means(
        observation, time, load, block_means(observation.displacement, size), variance)
    return replace(
        means, per_block=1, spans=None, longest_step=max(SEARCH_STEP, size * SEARCH_STEP))


def _with_means(observation: Observation, time: Array, load: Array, displacement: Array,
                variance: Array) -> Observation:
    """The same run with means (3, N) of readings, independent with a variance (3, N) each."""
    return replace(
        observation, time=time, load=load, displacement=displacement, branch=np.zeros(len(time)),
        whitening=tuple(independent(row) for row in variance),
        zero_error=np.zeros(len(variance)), standard_error=np.sqrt(variance), load_errors=None,
        fine_time=time, fine_load=load)


@dataclass(frozen=True)
class Refinement(least_squares.Minimum):
    """The optimum, with its contact parameters (6,)."""

    contact: Array

    @property
    def law(self) -> ContactParameters:
        return ContactParameters.from_array(self.contact)

    def as_step(self, number: int) -> SearchStep:
        """The report of one of three stages of least squares."""
        return SearchStep(number, 3, self.chi_square, tuple(self.contact.tolist()), 0.0)


def refine(objective: WeightedObjective, space: SearchSpace, start: Array,
           is_cancelled: IsCancelled | None = None, negligible: float = least_squares.NEGLIGIBLE,
           damping: float = least_squares.USUAL_DAMPING) -> Refinement:
    """`least_squares.minimise` from coordinates `start` (F,); Cancelled on request."""

    def at(point: Array) -> LazyAnswer:
        if is_cancelled is not None and is_cancelled():
            raise Cancelled
        return _at(objective, space, point)

    lowest = least_squares.minimise(at, start, space.low, space.high, negligible, damping)
    return Refinement(**vars(lowest), contact=space.contacts(lowest.point)[0])


def stay_at(objective: WeightedObjective, space: SearchSpace,
            contact: ContactParameters) -> Refinement:
    """A `Refinement` at given contact parameters, without a step."""
    point = space.coordinates(contact.to_array())
    here = _at(objective, space, point)
    return Refinement(
        point, float(here.residual @ here.residual), here.columns,
        least_squares.on_bound(point, space.low, space.high), contact.to_array())


def _at(objective: WeightedObjective, space: SearchSpace, point: Array) -> LazyAnswer:
    """Residual (R,) at a point (F,) of the search space, and its Jacobian (R, F) on demand."""
    contact = space.contacts(point)[0]
    fit = objective.linearised(contact)
    return LazyAnswer(
        fit.residual,
        lambda: np.asarray(fit.slopes()[space.free].T * space.scale(contact)))
