"""The simulated displacement, and measured minus simulated by stamp; of streams and records."""

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import counted
from saddlering_ros.record import batches
from saddlering_ros.record.batches import Displacements, Floats, JITTER_NS, Samples, SECOND, Stamps
from saddlering_ros.record.displacement import measured_rows, zero_of_run
from saddlering_ros.record.guard import load_limits, SampleGuard
from saddlering_ros.record.record import Record
from saddlering_ros.record.scratch import BLOCK, forget
from saddlering_ros.rig import beyond_bounds, ParameterSet, probes_to_displacement, Rig
from saddlering_ros.rig.geometry import MIN_SAMPLES, STEADY_SHARE, WINDOW_SECONDS, ZeroReading
from saddlering_ros.ring.simulator import RingSimulator, simulate_in_blocks, SimulationError

KEEP_NS = 2 * SECOND
"""A sample this far behind the newest match will find no partner any more."""

MAX_WAITING = 20_000
"""Samples of one side kept while its partner is silent: 20 s at 1 kHz."""

ELEVATION_TOLERANCE = np.radians(0.5)
"""Elevations that differ by more [rad] are of two tests."""


@dataclass
class JoinCounters:
    """Counts of samples that were not subtracted, by reason."""

    measured_alone: int = 0  # without a partner of their stamp
    simulated_alone: int = 0  # the same
    zero_differs: int = 0  # pairs that count from different zeros
    elevation_differs: int = 0  # pairs at different elevations
    jumps: int = 0  # stamps that jumped back


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
        together = batches.join([self.waiting, batch])
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

    Samples are subtracted if their stamps are equal and both count from the same zero (stamps
    within the length of the zero window, loads within its steadiness). If one side alone has a new
    zero, the other side is brought to that zero.
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
        if not len(measured):
            return batches.no_displacements()
        apart = np.abs(measured.zero_stamps - simulated.zero_stamps)
        same = apart <= round(WINDOW_SECONDS * SECOND)
        same &= np.abs(measured.zero_loads - simulated.zero_loads) <= self._load_tolerance
        if np.count_nonzero(same) == len(same):
            self._bridges.clear()
            self.zeros_agree = True
            return _difference(measured, simulated)
        # Residuals of the rows whose two zeros can be brought together.
        parts, rows = [], np.flatnonzero(~same)
        zeros = np.stack([measured.zero_stamps[rows], simulated.zero_stamps[rows]])
        for of_both in np.unique(zeros, axis=1).T.tolist():
            pair = tuple(of_both)
            mine = rows[(pair == zeros.T).all(axis=1)]
            newer = measured if pair[0] > pair[1] else simulated
            self._bridges = {pair: self._bridges.get(pair) or _Bridge(
                max(pair), float(newer.zero_durations[mine[0]]))}
            parts.append(self._bridges[pair].across(measured.pick(mine), simulated.pick(mine)))
        bridged = batches.join(parts)
        direct = _difference(measured.pick(same), simulated.pick(same))
        self.counters.zero_differs += len(same) - len(direct) - len(bridged)
        self.zeros_agree = bool(same[-1]) or bool(
            len(bridged) and bridged.stamps[-1] == measured.stamps[-1])
        both = batches.join([direct, bridged])
        return both.pick(np.argsort(both.stamps, kind='stable'))


class _Bridge:
    """From the older of two zeros to the newer one, by what the older side did meanwhile.

    A node that was started again has a new zero; its partner keeps the old one. The mean of the
    partner's displacement over the samples of the new zero is the offset between the two zeros.
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
    """Residuals of a run as the node gives them, and its zero; the last note comes at the end."""
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


@dataclass
class SimulationCounters:
    """Counts of samples that were not simulated, by reason; all zero on a healthy stream."""

    late: int = 0  # stamped before one already simulated
    duplicates: int = 0  # stamps seen twice
    reordered: int = 0  # put in order in time
    jumps: int = 0  # restarts after stamps that jumped
    not_converged: int = 0  # states that the solver did not find, which are not given out


class SimulationStream:
    """One simulated state per load sample, with the sample's stamp.

    Samples of a batch are put in order. After one came too late, samples are held back for twice
    its delay (at most MAX_HOLD_NS). Stamps that jump back, or ahead by more than `max_gap` [s],
    restart the simulation. A jump ahead inside `recording` (first and last stamp [ns]) is a pause
    of the same test.

    held: samples held back in case an earlier one still comes; newest_stamp: of the last sample
    simulated [ns], 0 before the first.
    """

    def __init__(self, rig: Rig, parameters: ParameterSet, elevation: float, *,
                 max_step: float = 1e-3, max_gap: float = 10.0) -> None:
        self._rig = rig
        self._max_gap = round(max_gap * SECOND)
        self.simulator = RingSimulator(rig, parameters, elevation, max_step)
        self.elevation = self.zero_elevation = elevation
        self.recording = batches.ANY_TIME
        self.guard = SampleGuard(load_limits(rig))
        self.counters = SimulationCounters()
        self.hold = 0
        self.load = float('nan')
        self._asked_after: int | None = None
        self._forget()

    def _forget(self) -> None:
        self._epoch: int | None = None
        self.held: list[tuple[int, float]] = []
        self.newest_stamp = self._newest = 0
        self._pushed: NDArray[np.int64] = np.empty(0, np.int64)
        self.zero_stamp = 0
        self.zero_elevation = self.elevation
        self._zero_end = 0

    def restart(self, *, zero_anywhere: bool = False) -> None:
        """Start anew; the next samples near preload (or at any load) make the zero."""
        self.simulator.reset(zero_anywhere=zero_anywhere)
        self._asked_after = None
        self._forget()

    def turn(self, elevation: float) -> None:
        """Go on at another elevation [rad]: the gun has moved a little within the test."""
        self.simulator.turn(elevation)
        self.elevation = elevation
        if not self.zero_stamp:
            self.zero_elevation = elevation

    def zero_after(self, stamp: int) -> None:
        """Restart with the first steady stretch after `stamp` [ns], at any load."""
        self._asked_after = stamp

    def push(self, load: Samples) -> Displacements:
        """Take a batch of load samples; return the states that are due."""
        self._insert(self.guard.push(load))
        return self._release(self._newest - self.hold)

    def flush(self) -> Displacements:
        """Simulate the held samples after a time without data."""
        return self._release(self._newest)

    def flush_guard(self) -> Displacements:
        """Simulate the sample whose successor will show whether it is an outlier."""
        self._insert(self.guard.flush())
        return self.flush()

    def _insert(self, load: Samples) -> None:
        """Put samples among those held, by stamp."""
        for stamp, value in zip(load.stamps.tolist(), load.values.tolist(), strict=True):
            newest = self._newest
            is_ahead = stamp - newest > self._max_gap and not batches.is_pause(
                self.recording, newest, stamp)
            if newest and (is_ahead or newest - stamp > batches.JITTER_NS):
                self.counters.jumps += 1
                self.restart()
            if stamp < self.newest_stamp:
                self.counters.late += 1
                self.hold = batches.longer_hold(self.hold, self._newest - stamp)
                continue
            self._newest = max(self._newest, stamp)
            held = self.held
            place = bisect_left(held, (stamp,))
            if stamp == self.newest_stamp or (place < len(held) and held[place][0] == stamp):
                self.counters.duplicates += 1
                continue
            self.counters.reordered += place < len(held)
            held.insert(place, (stamp, value))

    def _release(self, until: int) -> Displacements:
        """The states at the samples up to a stamp [ns]."""
        count = bisect_left(self.held, (until + 1,))
        if not count:
            return batches.no_displacements()
        due, self.held = self.held[:count], self.held[count:]
        stamps = np.array([stamp for stamp, _ in due], np.int64)
        loads = np.array([load for _, load in due])
        if self._asked_after is None or stamps[-1] <= self._asked_after:
            return self._simulated(stamps, loads)
        asked = int(stamps.searchsorted(self._asked_after, 'right'))
        before = self._simulated(stamps[:asked], loads[:asked])
        held, newest = self.held, self._newest
        self.restart(zero_anywhere=True)
        self.held, self._newest = held, newest
        after = self._simulated(stamps[asked:], loads[asked:])
        return batches.join([before, after])

    def _simulated(self, stamps: Stamps, loads: Floats) -> Displacements:
        """The states that are known with samples (N,) in order: stamps [ns], loads [N]."""
        if not len(stamps):
            return batches.no_displacements()
        if self._epoch is None:
            self._epoch = int(stamps[0])
        self.newest_stamp, self.load = int(stamps[-1]), float(loads[-1])
        time, probes = self.simulator.push((stamps - self._epoch) / 1e9, loads)
        pushed = np.append(self._pushed, stamps) if len(self._pushed) else stamps
        pending = self.simulator.pending
        first = len(pushed) - pending - len(time)
        zero = self.simulator.zero
        if zero is not None and not self.zero_stamp:
            of_zero = pushed[first:first + zero.end - zero.start]
            self.zero_stamp = int(of_zero[0])
            self._zero_end = int(of_zero[-1])
        self._pushed = pushed[len(pushed) - pending:]
        if zero is None or not len(time):
            return batches.no_displacements()
        channels = probes_to_displacement(self._rig.probes, probes).channels
        times = pushed[first:first + len(time)]
        converged = np.isfinite(channels).all(axis=0)
        if not converged.all():
            self.counters.not_converged += int(np.count_nonzero(~converged))
            times, channels = times[converged], channels[:, converged]
        return Displacements.from_zero(
            times, channels, (self.zero_stamp, self._zero_end), zero.load, self.elevation,
            self.guard.marks(times, to_next=True))


def simulated_stretches(
    rig: Rig, run: Record, parameters: ParameterSet, notes: list[str],
    on_progress: Callable[[float], None],
) -> tuple[Iterator[Displacements], ZeroReading]:
    """The output of the live simulator for a run in stretches, and its zero.

    Notes on the simulation are appended to `notes`, the last of them after the last sample.
    SimulationError if no sample could be simulated; no output is written then.
    """
    def stretches() -> Iterator[tuple[ZeroReading, Displacements]]:
        failed, has_sample, zero = 0, False, None
        for simulated in simulate_in_blocks(
                rig, parameters, run.elevation, run.time, run.load, BLOCK):
            rows = slice(simulated.first, simulated.first + len(simulated.time))
            channels = simulated.displacement.channels
            failed, zero = simulated.failed_steps, simulated.zero
            first, last = run.stamps[[zero.start, zero.end - 1]].tolist()
            batch = Displacements.from_zero(
                run.stamps[rows], channels, (first, last), zero.load, run.elevation,
                None if run.load_marks is None else run.load_marks[rows],
            ).pick(np.flatnonzero(np.isfinite(channels).all(axis=0)))
            has_sample = has_sample or bool(len(batch))
            if has_sample:
                yield zero, batch
            forget(run.stamps, run.time, run.load, run.gaps)
            on_progress(rows.stop / len(run.time))
        if not has_sample:
            raise SimulationError(f'{run.path}: no sample could be simulated: the solver finds no '
                                  'equilibrium of this ring: check contact.K1 and contact.K2 of '
                                  'the parameter file, and the rig file')
        if failed:
            notes.append(f'the solver did not converge in {counted(failed, "step")}, left out')
        if zero is not None and not zero.near_preload:
            notes.append(batches.ZERO_ELSEWHERE)

    if open_names := ', '.join(parameters.source.undetermined):
        notes.append(f'the data of the parameters do not determine {open_names}: where this '
                     'motion depends on them, it may be wrong')
    if doubtful := beyond_bounds(parameters.contact, rig.bounds):
        notes.append(doubtful)
    of_run = stretches()
    zero, first = next(of_run)
    return chain([first], (batch for _, batch in of_run)), zero
