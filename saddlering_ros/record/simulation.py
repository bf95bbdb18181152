"""The simulated displacement of the ring from samples of the load; of streams and of records."""

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record import batches
from saddlering_ros.record.batches import Displacements, Samples
from saddlering_ros.record.guard import load_limits, SampleGuard
from saddlering_ros.record.record import Record
from saddlering_ros.record.scratch import BLOCK, forget
from saddlering_ros.rig import ParameterSet, probes_to_displacement, Rig, ZeroReading
from saddlering_ros.ring import RingSimulator, SimulationError
from saddlering_ros.ring.simulator import simulate_in_blocks, SimulatedRun


@dataclass
class SimulationCounters:
    """Counts of samples that were not simulated, by reason; all zero on a healthy stream.

    late: samples stamped before one already simulated; duplicates: stamps seen twice; reordered:
    samples put in order in time; jumps: restarts after stamps that jumped;
    not_converged: states that the solver did not find, which are not given out.
    """

    late: int = 0
    duplicates: int = 0
    reordered: int = 0
    jumps: int = 0
    not_converged: int = 0


class SimulationStream:
    """One simulated state per load sample, with the sample's stamp.

    Samples that overtake each other inside a batch are put in order. Once one has come too late,
    samples are held back for twice its delay (at most MAX_HOLD_NS), so that the next late
    ones are in time. Stamps that jump back, or ahead by more than `max_gap` [s], restart the
    simulation, unless they jump ahead inside `recording` (first and last stamp [ns]), where they
    are a pause of one test.

    held: samples held back in case an earlier one still comes; newest_stamp: of the last sample
    simulated [ns], 0 before the first.
    """

    def __init__(self, rig: Rig, parameters: ParameterSet, elevation: float, *,
                 max_step: float = 1e-3, max_gap: float = 10.0) -> None:
        self._rig = rig
        self._max_gap = round(max_gap * batches.SECOND)
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
        self._zero_duration = 0.0

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
        return batches.join([batch for batch in (before, after) if len(batch)])

    def _simulated(self, stamps: NDArray[np.int64], loads: NDArray[np.float64]) -> Displacements:
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
            self._zero_duration = int(of_zero[-1] - of_zero[0]) / batches.SECOND
        self._pushed = pushed[len(pushed) - pending:]
        if zero is None or not len(time):
            return batches.no_displacements()
        channels = probes_to_displacement(self._rig.probes, probes).channels
        times = pushed[first:first + len(time)]
        converged = np.isfinite(channels).all(axis=0)
        if not converged.all():
            self.counters.not_converged += int(np.count_nonzero(~converged))
            times, channels = times[converged], channels[:, converged]
        return Displacements(times, channels,
                             np.full(len(times), self.zero_stamp),
                             np.full(len(times), zero.load),
                             np.full(len(times), self.elevation),
                             self.guard.marks(times, to_next=True),
                             np.full(len(times), self._zero_duration))


def simulated_stretches(
    rig: Rig, run: Record, parameters: ParameterSet, notes: list[str],
    on_progress: Callable[[float], None],
) -> tuple[Iterator[Displacements], ZeroReading]:
    """The output of the live simulator for a run in stretches, and its zero.

    Notes on the simulation are appended to `notes`, the last of them after the last sample.
    SimulationError if there is no sample at all: nothing comes before a stretch with a sample, so
    that a ring without one writes no output.
    """
    def stretches() -> Iterator[tuple[ZeroReading, Displacements]]:
        failed, found, zero = 0, False, None
        for simulated in simulate_in_blocks(
                rig, parameters, run.elevation, run.time, run.load, BLOCK):
            batch = _converged(run, simulated)
            failed, zero = simulated.failed_steps, simulated.zero
            found = found or bool(len(batch))
            if found:
                yield zero, batch
            forget(run.stamps, run.time, run.load, run.gaps)
            on_progress((simulated.first + len(simulated.time)) / len(run.time))
        if not found:
            raise SimulationError(f'{run.path}: no sample could be simulated: the solver finds no '
                                  'equilibrium of this ring: check contact.K1 and contact.K2 of '
                                  'the parameter file, and the rig file')
        if failed:
            notes.append(
                f'the solver did not converge in {failed} steps: their samples are left out')
        if zero is not None and not zero.near_preload:
            notes.append(batches.ZERO_ELSEWHERE)

    of_run = stretches()
    zero, first = next(of_run)
    return chain([first], (batch for _, batch in of_run)), zero


def _converged(run: Record, simulated: SimulatedRun) -> Displacements:
    """The samples of a stretch without those at which the solver did not converge."""
    rows = slice(simulated.first, simulated.first + len(simulated.time))
    channels = simulated.displacement.channels
    zero, count = simulated.zero, len(simulated.time)
    first, last = run.stamps[[zero.start, zero.end - 1]].tolist()
    return Displacements(
        run.stamps[rows], channels, np.full(count, first), np.full(count, zero.load),
        np.full(count, run.elevation),
        np.zeros(count, np.uint8) if run.load_marks is None else run.load_marks[rows],
        np.full(count, (last - first) / batches.SECOND),
    ).pick(np.flatnonzero(np.isfinite(channels).all(axis=0)))

