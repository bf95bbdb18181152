"""Measured minus simulated displacement, joined by exact stamp; of streams and of records."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.record import batches
from saddlering_ros.record.batches import Displacements, JITTER_NS, SECOND
from saddlering_ros.record.displacement import measured_rows, zero_of_run
from saddlering_ros.record.record import Record
from saddlering_ros.record.simulation import simulated_stretches
from saddlering_ros.rig import ParameterSet, Rig, ZeroReading
from saddlering_ros.rig.zeroing import MIN_SAMPLES, STEADY_SHARE, WINDOW_SECONDS

KEEP_NS = 2 * SECOND
"""A sample this far behind the newest match will find no partner any more."""

MAX_WAITING = 20_000
"""Samples of one side kept while its partner is silent: 20 s at 1 kHz."""


ELEVATION_TOLERANCE = np.radians(0.5)
"""Elevations that differ by more [rad] are of two tests."""


@dataclass
class JoinCounters:
    """Counts of samples that were not subtracted, by reason.

    measured_alone, simulated_alone: samples without a partner of their stamp; zero_differs:
    pairs that count from different zeros; elevation_differs: pairs at different elevations;
    jumps: stamps that jumped back.
    """

    measured_alone: int = 0
    simulated_alone: int = 0
    zero_differs: int = 0
    elevation_differs: int = 0
    jumps: int = 0


class _Side:
    """Samples of one stream that wait for their partners, each stamp once."""

    def __init__(self) -> None:
        self.waiting = batches.no_displacements()
        self.newest = 0
        self.given_up = 0

    def push(self, batch: Displacements) -> bool:
        """Take a batch; whether its stamps jumped back."""
        if not len(batch):
            return False
        newest = int(batch.stamps.max())
        jumped = self.newest - int(batch.stamps[0]) > JITTER_NS
        if jumped:
            self.waiting = batches.no_displacements()
        self.newest = newest if jumped else max(self.newest, newest)
        together = batches.join([self.waiting, batch]) if len(self.waiting) else batch
        if len(together) > 1 and (np.diff(together.stamps) <= 0).any():
            _, first = np.unique(together.stamps, return_index=True)
            together = together.pick(first)
        self.waiting = together
        return jumped

    def forget(self, used: np.ndarray, before: int) -> int:
        """Drop rows `used` and rows stamped before `before`; how many found no partner."""
        if len(used) == len(self.waiting) and not self.given_up:
            self.waiting = batches.no_displacements()
            return 0
        keep = self.waiting.stamps >= before
        keep[used] = False
        alone = len(keep) - int(keep.sum()) - len(used) + self.given_up
        self.waiting, self.given_up = self.waiting.pick(np.flatnonzero(keep)), 0
        return alone


class ResidualStream:
    """Residuals from batches of measured and simulated displacements.

    Only samples of equal stamp are subtracted, and only when both count from the same zero: the
    zeros' stamps within the zero window's length, their loads within its steadiness. Where one
    side has zeroed anew alone, the other is brought to that zero if it was heard meanwhile.
    """

    def __init__(self, full_scale_load: float) -> None:
        self._load_tolerance = STEADY_SHARE * full_scale_load
        self._measured, self._simulated = _Side(), _Side()
        self.counters = JoinCounters()
        self.zeros_agree = True
        self.elevations_agree = True
        self._bridges: dict[tuple[int, ...], _Bridge] = {}

    @property
    def waiting(self) -> tuple[int, int]:
        """Measured and simulated samples that wait for a partner."""
        return len(self._measured.waiting), len(self._simulated.waiting)

    def push(self, measured: Displacements, simulated: Displacements) -> Displacements:
        """Take a batch of either stream; return measured minus simulated where both are there."""
        self.counters.jumps += self._measured.push(measured) + self._simulated.push(simulated)
        residual = self._joined()
        for side in (self._measured, self._simulated):
            surplus = len(side.waiting) - MAX_WAITING
            if surplus > 0:
                side.waiting = side.waiting.pick(slice(surplus, None))
                side.given_up += surplus
        return residual

    def _joined(self) -> Displacements:
        """The residuals at the stamps that wait on both sides."""
        measured, simulated = self._measured.waiting, self._simulated.waiting
        if not len(measured) or not len(simulated):
            return batches.no_displacements()
        if np.array_equal(measured.stamps, simulated.stamps):  # the usual case
            stamps = measured.stamps
            mine = other = np.arange(len(stamps))
        else:
            stamps, mine, other = np.intersect1d(measured.stamps, simulated.stamps,
                                                 assume_unique=True, return_indices=True)
            if not len(stamps):
                return batches.no_displacements()
            measured, simulated = measured.pick(mine), simulated.pick(other)
        before = int(stamps[-1]) - KEEP_NS
        self.counters.measured_alone += self._measured.forget(mine, before)
        self.counters.simulated_alone += self._simulated.forget(other, before)
        differs = np.abs(measured.elevations - simulated.elevations) > ELEVATION_TOLERANCE
        self.elevations_agree = not differs[-1]
        if np.count_nonzero(differs):
            self.counters.elevation_differs += int(differs.sum())
            measured, simulated = measured.pick(~differs), simulated.pick(~differs)
        return self._subtract(measured, simulated)

    def _subtract(self, measured: Displacements, simulated: Displacements) -> Displacements:
        if not len(measured):
            return batches.no_displacements()
        apart = np.abs(measured.zero_stamps - simulated.zero_stamps)
        same = apart <= round(WINDOW_SECONDS * SECOND)
        same &= np.abs(measured.zero_loads - simulated.zero_loads) <= self._load_tolerance
        if np.count_nonzero(same) == len(same):
            self._bridges.clear()
            self.zeros_agree = True
            return _difference(measured, simulated)
        bridged = self._bridged(measured, simulated, np.flatnonzero(~same))
        direct = _difference(measured.pick(same), simulated.pick(same))
        self.counters.zero_differs += len(same) - len(direct) - len(bridged)
        self.zeros_agree = bool(same[-1]) or bool(
            len(bridged) and bridged.stamps[-1] == measured.stamps[-1])
        both = batches.join([batch for batch in (direct, bridged) if len(batch)])
        return both.pick(np.argsort(both.stamps, kind='stable'))

    def _bridged(self, measured: Displacements, simulated: Displacements, rows: np.ndarray,
                 ) -> Displacements:
        """Residuals of those `rows` whose two zeros could be brought together."""
        zeros = np.stack([measured.zero_stamps[rows], simulated.zero_stamps[rows]])
        found = []
        for of_both in np.unique(zeros, axis=1).T.tolist():
            pair = tuple(of_both)
            mine = rows[(pair == zeros.T).all(axis=1)]
            newer = measured if pair[0] > pair[1] else simulated
            self._bridges = {pair: self._bridges.get(pair) or _Bridge(
                max(pair), float(newer.zero_durations[mine[0]]))}
            found.append(self._bridges[pair].across(measured.pick(mine), simulated.pick(mine)))
        return batches.join([batch for batch in found if len(batch)])


class _Bridge:
    """From the older of two zeros to the newer one, by what the older side did meanwhile.

    A node that was started again has zeroed anew; its partner has not, but has gone on. The mean
    of the partner's displacement over the samples of the new zero is what it would have zeroed by;
    displacements add up, so subtracting it puts both on the new zero.
    """

    def __init__(self, newer: int, duration: float) -> None:
        self._newer = newer
        self._until = newer + (round(duration * SECOND) or round(WINDOW_SECONDS * SECOND) - 1)
        self._total = np.zeros(4)
        self._count = 0

    def across(self, measured: Displacements, simulated: Displacements) -> Displacements:
        """Measured minus simulated, both from the newer zero; empty until its window is over."""
        measured_is_older = int(measured.zero_stamps[0]) < self._newer
        older, newer = (measured, simulated) if measured_is_older else (simulated, measured)
        inside = (older.stamps >= self._newer) & (older.stamps <= self._until)
        self._total += older.channels[:, inside].sum(axis=1)
        self._count += int(inside.sum())
        after = older.stamps > self._until
        if self._count < MIN_SAMPLES or not after.any():
            return batches.no_displacements()
        result, zero = _difference(measured.pick(after), simulated.pick(after)), newer.pick(after)
        offset = (self._total / self._count)[:, None]
        return replace(
            result, zero_stamps=zero.zero_stamps, zero_loads=zero.zero_loads,
            zero_durations=zero.zero_durations,
            channels=result.channels - offset if measured_is_older else result.channels + offset)


def _difference(measured: Displacements, simulated: Displacements) -> Displacements:
    return replace(measured, channels=measured.channels - simulated.channels,
                   elevations=simulated.elevations,
                   validity=measured.validity | simulated.validity)


def residual_stretches(
    rig: Rig, run: Record, parameters: ParameterSet, notes: list[str],
    on_progress: Callable[[float], None],
) -> tuple[Iterator[Displacements], ZeroReading]:
    """The residuals of a run in stretches, as the node gives them, and the zero of the probes.

    Notes on the simulation are appended to `notes`, the last of them after the last sample.
    """
    zero = zero_of_run(rig, run)
    stretches, _ = simulated_stretches(rig, run, parameters, notes, on_progress)
    stream = ResidualStream(rig.full_scale_load)

    def residuals() -> Iterator[Displacements]:
        row = 0
        for simulated in stretches:
            if not len(simulated):
                continue
            end = int(np.searchsorted(run.stamps, simulated.stamps[-1], 'right'))
            yield stream.push(measured_rows(rig, run, zero, slice(row, end)), simulated)
            row = end

    return residuals(), zero.reading
