"""Waves of the raceways of a ring, as far as the tests of one session show them.

Raceways of a real ring wave by tens of micrometres. Its rollers touch one after the other, so that
a cause moves the ring otherwise than it moves one of equal gaps. No nuisance parameter of first
order describes this. The amplitudes of the waves are therefore fitted together with the contact
law. One session determines a few combinations of them, which are those that move this ring under
these loads; a prior keeps the others small. A diagnosis that waves would complete is repeated with
these combinations beside the contact law: the waves do what a load offset or a gain does, and no
friction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from saddlering_ros.diagnosis.ring_system import along_tangents, Candidate, RingSystem, WAVE_SPREAD
from saddlering_ros.diagnosis.ring_wording import wave_words
from saddlering_ros.discrepancy import Diagnosis, RunBlocks
from saddlering_ros.effects.extension import NO_EXTENSION, RingExtension, RowGeometry
from saddlering_ros.effects.raceway_waves import Raceways, rms_of, waved, WAVES
from saddlering_ros.estimation.least_squares import LazyAnswer, minimise
from saddlering_ros.estimation.process import Array
from saddlering_ros.progress import Watch
from saddlering_ros.quantities import percent

REACH = 5.0
"""Largest amplitude in `WAVE_SPREAD`."""

TOLERANCES = (0.03, 0.01)
"""Errors of the model as shares of range, in turn: the fit by the first one is near the waves that
the second one determines. By the second one at once, a ring of two kept a wrong contact law."""

FIRST = 0.05
"""First amplitudes in `WAVE_SPREAD`, of both signs: at 0 the sine of a wave has no slope."""

STEP = 1e-3
"""Step of a sensitivity, in the range of a contact parameter or in `WAVE_SPREAD`."""

NO_WAVES = 0.02
"""Misfit as a share of range up to which no waves are fitted. Other errors of dirty rings leave
1.6 % of delta_y. Waves of 2 um leave 2 to 3 %, and moved sizes by up to four deviations."""

EXPLAINED = 0.5
"""Share of this misfit that is left at most, if waves are its cause."""

NEARLY_ALL = 0.2
"""Share of it that is left at most, if waves are told of without an earlier session. On nine rings
with waves of 20 um 0.02 to 0.26 were left, of an elevation error that was not listed 0.45."""

LEFT_BY_GAPS = 0.005
"""Misfit as a share of range up to which causes at the gaps of rollers, as clearances or worn
arcs, stay without waves. Alone on a ring they left 0.25 % at most; in place of waves, 1 to 5 %."""

SEEN = 2e-4
"""Least rms, as a share of range, that a size of `WAVE_SPREAD` of a fitted combination moves."""


def with_raceways(system: RingSystem, runs: Sequence[RunBlocks], law: Array,
                  watch: Watch) -> tuple[RingSystem, Array]:
    """The ring with the waves that its runs show, and the contact law (6,) beside them.

    law: that of the ring without waves. Ring and law stay as they are where this law fits, or
    where waves do not explain why it does not.
    """
    session = _Session(system, runs)
    point = session.explained(law, watch)
    if point is None:
        return system, law
    return replace(system, raceways=session.raceways_at(point)), session.candidate(point)[0]


def waves_beside(system: RingSystem, runs: Sequence[RunBlocks], even: Diagnosis,
                 watch: Watch) -> tuple[RingSystem, Array] | None:
    """The ring with waves that are fitted beside causes, and the contact law (6,) of the start.

    even: the diagnosis of even raceways. None if it needs no waves, or if waves, alone or beside
    those of its causes that are no gaps, do not explain most of what it leaves.
    """
    (law, nothing), (law_beside, causes) = (
        system.candidate(fit.point) for fit in (even.fits.before, even.fits.after))
    # Without what the causes change at the gaps of rollers, as waves do.
    upper, lower, radial = (RowGeometry(stiffness=row.stiffness) for row in (
        causes.upper_row, causes.lower_row, causes.radial_row))
    others = replace(causes, upper_row=upper, lower_row=lower, radial_row=radial)
    left = _Session(system, runs).largest_misfit((law_beside, causes))
    if even.verdict != 'unknown' and left <= (NO_WAVES if others == causes else LEFT_BY_GAPS):
        return None
    for start, beside in ((law, nothing), (law_beside, others)):
        session = _Session(system, runs, beside)
        point = session.explained(start, watch, EXPLAINED * left)
        if point is not None:
            return (replace(system, raceways=session.raceways_at(point),
                            directions=session.directions(point)), session.candidate(point)[0])
    return None


def explained_by_waves(
    wavy: RingSystem, runs: Sequence[RunBlocks], law: Array, without: Array) -> list[str]:
    """A note if waves explain nearly all of the misfit, of held-out runs as well.

    law: contact law (6,) beside the waves; without: that of even raceways.
    """
    session = _Session(wavy, runs)
    before, after = (session.largest_misfit(candidate) for candidate in (
        (without, NO_EXTENSION), (law, waved(NO_EXTENSION, wavy.raceways))))
    return [f'{wave_words(rms_of(wavy.raceways))} explain most of the misfit, which is '
            f'at most {percent(after)} of the range of a coordinate with these waves and '
            f'{percent(before)} without them: one session does not part waves from causes; '
            'compare the session with an earlier one (saddlering compare)'
            ] if after <= NEARLY_ALL * before else []


@dataclass(frozen=True)
class _Session:
    """Runs of a ring. A point of the fit: contact law, then amplitudes in `WAVE_SPREAD`.

    causes: beside which the waves are.
    """

    system: RingSystem
    runs: Sequence[RunBlocks]
    causes: RingExtension = NO_EXTENSION

    def explained(self, law: Array, watch: Watch, most: float = math.inf) -> Array | None:
        """The fitted point, if this law does not fit, waves explain why and leave `most`."""
        misfit = self.largest_misfit((law, self.causes))
        if misfit <= NO_WAVES:
            return None
        watch.progress('waves of the raceways', watch.share)
        point = self.fitted(watch)
        left = self.largest_misfit(self.candidate(point))
        return point if left <= min(EXPLAINED * misfit, most) else None

    def fitted(self, watch: Watch) -> Array:
        """The point that fits the increments of the probes best."""
        # The law that was fitted without waves is far from that of this ring, and no start.
        law = [parameter.first_guess for parameter in self.system.base_parameters]
        signs = (-1.0) ** np.arange(3 * WAVES)
        point = np.concatenate([law, FIRST * signs])
        low = np.concatenate([np.zeros(len(law)), np.full(signs.size, -REACH)])
        prior = np.eye(point.size)[len(law):]
        scale = self.ranges()
        measured = np.concatenate([_about_mean(run.channels).ravel() for run in self.runs])
        for tolerance in TOLERANCES:
            spread = tolerance * scale

            def linearised(at: Array, spread: Array = spread) -> LazyAnswer:
                watch.check()
                watch.advance(watch.share)
                rest = (self.predicted(self.candidate(at)) - measured) / spread
                return LazyAnswer(
                    np.concatenate([rest, prior @ at]),
                    lambda: np.vstack([self.slopes(at) / spread[:, None], prior]))

            point = minimise(linearised, point, low, np.where(low < 0.0, REACH, 1.0), 1.0).point
        return point

    def ranges(self) -> Array:
        """The range (n,) of the probe of each increment in all runs."""
        spans = np.ptp(np.hstack([run.channels for run in self.runs]), axis=1)
        return np.concatenate([np.repeat(spans, run.time.size) for run in self.runs])

    def directions(self, point: Array) -> Raceways:
        """Combinations (k, 3 * WAVES) of amplitudes that these runs determine, unit vectors."""
        ranges, count = self.ranges(), len(self.system.base_parameters)
        slopes = self.slopes(point) / (ranges * math.sqrt(ranges.size))[:, None]
        law = np.linalg.qr(slopes[:, :count])[0]
        waves = slopes[:, count:] - law @ (law.T @ slopes[:, count:])
        _, sizes, rows = np.linalg.svd(waves, full_matrices=False)
        combinations: Raceways = rows[sizes > SEEN].tolist()
        return combinations

    def raceways_at(self, point: Array) -> Raceways:
        """Waves [m] of the three rows."""
        amplitudes = WAVE_SPREAD * point[len(self.system.base_parameters):]
        waves: Raceways = amplitudes.reshape(3, WAVES).tolist()
        return waves

    def candidate(self, point: Array) -> Candidate:
        """Contact law and raceways at a point."""
        law = [parameter.from_unit(float(unit)) for parameter, unit in zip(
            self.system.base_parameters, point, strict=False)]
        return np.array(law), waved(self.causes, self.raceways_at(point))

    def predicted(self, candidate: Candidate) -> Array:
        """Increments (n,) in all runs, each about its mean."""
        return np.concatenate([
            _about_mean(self.system.simulated(run, [candidate])[0]).ravel() for run in self.runs])

    def slopes(self, point: Array) -> Array:
        """Sensitivities (n, k) of these increments."""
        steps = np.where(point > 0.5, -STEP, STEP)
        near = along_tangents(self.system, [[
            self.candidate(one) for one in (point, *(point + np.diag(steps)))]])
        changes = [_about_mean(every[1:] - every[0]).reshape(steps.size, -1)
                   for run in self.runs for every in near(run)]
        return np.asarray((np.hstack(changes) / steps[:, None]).T)

    def largest_misfit(self, candidate: Candidate) -> float:
        """Largest rms of a coordinate of the ring, as a share of its range in a run."""
        views = np.array([self.system.views[name] for name in ('delta_x', 'delta_y', 'gamma')])
        shares = [
            np.std(views @ (self.system.simulated(run, [candidate])[0] - run.channels), axis=1)
            / np.maximum(np.ptp(views @ run.channels, axis=1), 1e-12) for run in self.runs]
        return float(np.max(shares))


def _about_mean(values: Array) -> Array:
    """Values (..., N) about their mean: the zero of a probe is free."""
    return values - values.mean(axis=-1, keepdims=True)
