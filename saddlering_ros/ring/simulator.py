"""The ring simulator, streaming and in batches: loads in, displacements and probe readings out."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
import os
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.effects import extension_of, laws_of, NO_EXTENSION, RingExtension
from saddlering_ros.effects.law import Law, LawHistory, LOAD_TARGET
from saddlering_ros.errors import SaddleringError
from saddlering_ros.rig import Displacement, ParameterSet, probes_to_displacement, Rig
from saddlering_ros.rig.geometry import zero_of_record, ZeroReading, ZeroWindow
from saddlering_ros.ring import model
from saddlering_ros.ring.kernels import courses, equilibrium, integration
from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.model import Floats, Model, Rows

Part = TypeVar('Part')
Result = TypeVar('Result')


class SimulationError(SaddleringError):
    """A record cannot be simulated. The message is one line: fault, place, remedy."""


@dataclass(frozen=True)
class SimulatedRun:
    """A simulated record from its zero window on: M samples, mostly the last M of N.

    All samples are NaN without an equilibrium at the zero.
    """

    time: Floats  # (M,) [s]
    displacement: Displacement  # of (M,) arrays
    probes: Floats  # (4, M) [m]
    first: int  # index in the record of the first simulated sample
    zero: ZeroReading  # its reading
    failed_steps: int  # that did not converge: their samples are NaN


class RingSimulator:
    """The state of the ring at each load sample, from batches of any size; a record is one batch.

    rig, parameters with their effects, elevation [rad]; max_step [s] is the longest time step.
    Samples wait until the zero window (rig.geometry) closes, and are then returned together. Later
    samples are returned by their push, unless a negative clock offset needs later loads.
    """

    def __init__(self, rig: Rig, parameters: ParameterSet, elevation: float,
                 max_step: float = 1e-3) -> None:
        _check_step(max_step)
        self._rig = rig
        extension = extension_of(parameters.effects, rig)
        self._laws = laws_of(parameters.effects)
        self._additions: Additions | None = None
        rows = model.rows_of(rig, extension)
        self._m = model.model_of(rig, elevation, parameters.contact.to_array(), extension)
        self._rows, self._uniform = rows.flat, rows.uniform
        self._max_step = max_step
        self._offset, self._skew = extension.clock_offset, extension.clock_skew
        self.reset()

    def reset(self, *, zero_anywhere: bool = False) -> None:
        """Begin anew; the next samples open a new zero window (`zero_anywhere`: at any load)."""
        self._lost = False
        self.zero: ZeroReading | None = None
        self._window = ZeroWindow(self._rig, anywhere=zero_anywhere)
        self._waiting = np.empty((2, 0))
        self._offered = 0
        self._state = np.zeros(at.STATE_SIZE)
        self._past = np.empty((5, 0))
        self._asked = np.empty(0)

    def turn(self, elevation: float) -> None:
        """Go on from the present state at another elevation [rad]; the zero stays."""
        self._m = model.at_elevation(self._m, elevation)

    @property
    def failed_steps(self) -> int:
        """Number of steps in which Newton did not converge."""
        return int(self._state[at.FAILED_STEPS])

    @property
    def iterations(self) -> int:
        """Number of Newton iterations since the zero."""
        return int(self._state[at.ITERATIONS])

    @property
    def pending(self) -> int:
        """How many of the last samples wait for later ones."""
        return len(self._asked) if self.zero is not None else self._waiting.shape[1]

    def begin(self, zero: ZeroReading, time: float) -> None:
        """Start at rest under the load of a zero that begins at `time` [s]."""
        self.zero = zero
        if self._laws:
            self._additions = Additions(self._rig, self._laws, time, zero.load)
        if not integration.start(self._m, self._rows, self._uniform, self._state, time, zero.load):
            self._state[at.FAILED_STEPS] += 1.0
            self._lost = True

    def push(self, time: Floats, load: Floats) -> tuple[Floats, Floats]:
        """Take load samples (N,) [s], [N]; times (M,) and probe increments (4, M) [m] now known.

        Increments are NaN where the time step did not converge, even in many small steps.
        """
        if self.zero is None:
            time, load = self._from_zero(time, load)
        if not time.size:
            return time, np.empty((4, 0))
        increments = self._moved(time, load)
        if self._offset == self._skew == 0.0:
            return time, increments
        # The probes' clock differs from that of the load.
        self._past = np.hstack([self._past, np.vstack([time, increments])])
        self._asked = np.append(self._asked, time)
        elapsed = self._asked - self._state[at.START_TIME]
        wanted = self._asked - self._offset - self._skew * elapsed
        late = wanted > self._past[0, -1]
        count = int(late.argmax()) if late.any() else late.size
        due, self._asked, wanted = self._asked[:count], self._asked[count:], wanted[:count]
        if not count:
            return due, np.empty((4, 0))
        seconds, *past = self._past
        readings = np.stack([np.interp(wanted, seconds, row) for row in past])
        self._past = self._past[:, max(seconds.searchsorted(wanted[-1], 'right') - 1, 0):]
        return due, readings

    def _from_zero(self, time: Floats, load: Floats) -> tuple[Floats, Floats]:
        """Time and load of all samples from the start of the zero on; none before it is known."""
        reading = self._window.push_batch(time, load, np.empty((0, time.size)))
        waiting = np.hstack([self._waiting, [time, load]])
        if reading is None:
            self._offered += time.size
            self._waiting = waiting[:, waiting.shape[1] - self._window.samples:]
            return np.empty(0), np.empty(0)
        # The window counts every sample that it was offered.
        rows = np.ascontiguousarray(
            waiting[:, reading.start - self._offered + self._waiting.shape[1]:])
        self._waiting = np.empty((2, 0))
        self.begin(reading, float(rows[0, 0]))
        return rows[0], rows[1]

    def _moved(self, time: Floats, load: Floats) -> Floats:
        """Increments (4, N) of the probes by the kernels, with the user's own laws."""
        added = None
        if self._additions is not None:
            load, added = self._additions.push(time, load)
        motion, increments = np.empty((time.size, 3)), np.empty((time.size, 4))
        integration.advance(self._m, self._rows, self._uniform, self._state, time, load,
                            self._max_step, motion, increments)
        if self._lost:
            increments[:] = np.nan
        return np.ascontiguousarray((increments if added is None else increments + added).T)


def check_simulation(time: ArrayLike, load: ArrayLike, elevation: float,
                     max_step: float) -> tuple[Floats, Floats]:
    """Rising, finite time and load (N,) as arrays of the kernels; SimulationError for others."""
    if not np.isfinite(elevation):
        raise SimulationError(f'elevation is {elevation}: give a finite angle [rad]')
    seconds = np.ascontiguousarray(time, dtype=np.float64)
    force = np.ascontiguousarray(load, dtype=np.float64)
    if seconds.ndim != 1 or seconds.shape != force.shape or seconds.size == 0:
        raise SimulationError(f'time {seconds.shape} and load {force.shape} do not fit: give two '
                              'arrays of equal length')
    if not (np.all(np.isfinite(seconds)) and np.all(np.isfinite(force))):
        raise SimulationError('time or load is not finite (NaN or inf): clean the record first')
    stands = seconds[1:] <= seconds[:-1]
    if np.any(stands):
        index = int(np.argmax(stands)) + 1
        raise SimulationError(f'time does not rise at sample {index}: sort or cut the record')
    _check_step(max_step)
    return seconds, force


def _check_step(max_step: float) -> None:
    if not 0.0 < max_step < np.inf:
        raise SimulationError(f'longest step is {max_step}: give a finite time above zero [s]')


def simulate(rig: Rig, parameters: ParameterSet, elevation: float, time: ArrayLike,
             load: ArrayLike, max_step: float = 1e-3) -> SimulatedRun:
    """Simulate a whole record: time (N,) [s], load (N,) [N], elevation [rad]."""
    size = np.size(time)
    return next(simulate_in_blocks(rig, parameters, elevation, time, load, size, max_step))


def simulate_in_blocks(rig: Rig, parameters: ParameterSet, elevation: float, time: ArrayLike,
                       load: ArrayLike, size: int,
                       max_step: float = 1e-3) -> Iterator[SimulatedRun]:
    """`simulate` in stretches of `size` samples: the same numbers in little memory.

    first: index in the record of a stretch's first sample; failed_steps: since the record began.
    """
    seconds, force = check_simulation(time, load, elevation, max_step)
    simulator = RingSimulator(rig, parameters, elevation, max_step)
    zero = zero_of_record(rig, seconds, force)
    simulator.begin(zero, float(seconds[zero.start]))
    first = zero.start
    for start in range(zero.start, seconds.size, size):
        times, probes = simulator.push(seconds[start:start + size], force[start:start + size])
        yield SimulatedRun(times, probes_to_displacement(rig.probes, probes), probes, first, zero,
                           simulator.failed_steps)
        first += len(times)


def threads() -> int:
    """Number of kernels that run in parallel: SADDLERING_THREADS, or the processors available."""
    asked = os.environ.get('SADDLERING_THREADS', '')
    return max(1, int(asked)) if asked.isdecimal() else len(os.sched_getaffinity(0))


@lru_cache(maxsize=4)
def _pool(process: int, workers: int) -> ThreadPoolExecutor:
    # The process id is part of the key, because the threads of a parent do not exist in a fork.
    return ThreadPoolExecutor(workers, thread_name_prefix=f'ring-{process}')


def in_parallel(task: Callable[[Part], Result], parts: Sequence[Part]) -> list[Result]:
    """Results of task(part) for every part, on the threads that `threads` allows."""
    if len(parts) == 1 or threads() == 1:
        return [task(part) for part in parts]
    return list(_pool(os.getpid(), threads()).map(task, parts))


def shares(count: int) -> list[slice]:
    """`count` items in slices, one for each thread."""
    workers = min(threads(), count)
    return [slice(count * number // workers, count * (number + 1) // workers)
            for number in range(workers)]


def static_batch(rig: Rig, contacts: ArrayLike, elevation: float, loads: ArrayLike,
                 extensions: Sequence[RingExtension] | None = None) -> Floats:
    """Absolute equilibrium (B, 3, N) of each contact law (B, 6) at each load (N,) [N], in order.

    Elastic contact only: no friction, creep or measurement part of an extension acts here.
    Rows: delta_x, delta_y [m], gamma [rad]. NaN where no equilibrium was found. Raises
    SimulationError if elevation or a load is not finite.
    """
    m, every = _models(rig, contacts, elevation, extensions)
    rows, uniform = model.stack_rows(every)
    force = np.ascontiguousarray(loads, dtype=np.float64)
    if not np.all(np.isfinite(force)):
        first = int(np.argmin(np.isfinite(force)))
        raise SimulationError(f'load {first} is {force[first]}: give finite loads [N]')
    q = np.empty((m.shape[0], force.size, 3))

    def solve(batch: slice) -> None:
        of_rows = batch if rows.shape[0] > 1 else slice(None)
        equilibrium.static_batch(m[batch], rows[of_rows], uniform[of_rows], force, q[batch])

    in_parallel(solve, shares(m.shape[0]))
    return np.ascontiguousarray(q.transpose(0, 2, 1))


def static_response(rig: Rig, contact: ArrayLike, elevation: float, loads: ArrayLike) -> Floats:
    """Absolute equilibrium (3, N) [m, m, rad] of one contact law (6,) at loads (N,) [N]."""
    return np.asarray(static_batch(rig, np.atleast_2d(np.asarray(contact)), elevation, loads)[0])


def dynamic_batch(rig: Rig, contacts: ArrayLike, elevation: float, time: ArrayLike,
                  load: ArrayLike, max_step: float = 1e-3) -> Floats:
    """Absolute motion (B, 3, N) [m, m, rad] of laws (B, 6) over a record, at rest at load[0].

    NaN where a time step did not converge, and everywhere for a law that is not finite. Raises
    SimulationError if time, a load, the elevation or the step is not finite.
    """
    m, rows = _models(rig, contacts, elevation, None)
    seconds, force = check_simulation(time, load, elevation, max_step)
    motion, _ = _run_batch(m, rows, seconds, force, float(force[0]), max_step)
    return np.ascontiguousarray(motion.transpose(0, 2, 1))


def probe_batch(rig: Rig, candidates: Sequence[tuple[ArrayLike, RingExtension]], elevation: float,
                time: ArrayLike, load: ArrayLike, zero_load: float | None = None,
                max_step: float = 1e-3,
                blocks: tuple[NDArray[np.intp], NDArray[np.intp]] | None = None) -> Floats:
    """Probe increments (B, 4, N) [m] of each (contact law (6,), extension) over a record.

    If blocks of samples [start, stop) are given, the increments are means over these (B, 4, M).
    The zero is the equilibrium at `zero_load` [N] (load[0] if None), where the record starts.
    NaN where a time step did not converge, and everywhere for a law that is not finite. Raises
    SimulationError if time, a load, the elevation or the step is not finite.
    Where a clock offset needs samples outside the record, its first or last value is used.
    """
    contacts = np.array([np.asarray(contact, dtype=np.float64) for contact, _ in candidates])
    extensions = [extension for _, extension in candidates]
    m, rows = _models(rig, contacts, elevation, extensions)
    seconds, force = check_simulation(time, load, elevation, max_step)
    zero = float(force[0]) if zero_load is None else zero_load
    first = model.same_motions(m, rows)
    distinct = np.unique(first)
    motion, increments = np.empty((len(m), seconds.size, 3)), np.empty((len(m), seconds.size, 4))
    motion[distinct], increments[distinct] = _run_batch(
        m[distinct], [rows[index] for index in distinct.tolist()], seconds, force, zero, max_step)
    others = np.flatnonzero(first != np.arange(first.size))
    failed = others[~np.isfinite(motion[first[others]]).all(axis=(1, 2))]
    if failed.size:  # the values after a failed step are internal to the simulator
        _, increments[failed] = _run_batch(m[failed], [rows[index] for index in failed.tolist()],
                                           seconds, force, zero, max_step)
    for index in np.setdiff1d(others, failed).tolist():
        courses.read_courses(m[index:index + 1], zero, seconds, force, motion[first[index]],
                             *courses.UNCHANGED, increments[index:index + 1])
    for row, extension in zip(increments, extensions, strict=True):
        row[:] = of_probes_clock(row, extension, seconds)
    if blocks is None:
        return np.ascontiguousarray(increments.transpose(0, 2, 1))
    means = np.empty((len(increments), 4, blocks[0].size))
    courses.block_means(increments, *blocks, means)
    return means


def of_probes_clock(increments: Floats, extension: RingExtension, seconds: Floats) -> Floats:
    """Readings (N, 4) at the times (N,) [s] of the probes' own clock."""
    if extension.clock_offset == extension.clock_skew == 0.0:
        return increments
    wanted = seconds - extension.clock_offset - extension.clock_skew * (seconds - seconds[0])
    return np.array([np.interp(wanted, seconds, row) for row in increments.T]).T.copy()


def _models(rig: Rig, contacts: ArrayLike, elevation: float,
            extensions: Sequence[RingExtension] | None) -> tuple[Model, list[Rows]]:
    """Records (B,) and rows of contact laws (B, 6), without extensions those of the plain ring."""
    laws = np.atleast_2d(np.asarray(contacts, dtype=np.float64))
    if laws.ndim != 2 or laws.shape[1] != 6:
        raise SimulationError(f'contact laws have shape {laws.shape}: give (B, 6)')
    if not np.isfinite(elevation):
        raise SimulationError(f'elevation is {elevation}: give a finite angle [rad]')
    every = [NO_EXTENSION] * len(laws) if extensions is None else extensions
    return model.models_of(rig, elevation, laws, every), [model.rows_of(rig, one) for one in every]


def _run_batch(m: Model, rows: Sequence[Rows], seconds: Floats, force: Floats, zero_load: float,
               max_step: float) -> tuple[Floats, Floats]:
    """Motion (B, N, 3) and probe increments (B, N, 4) of each model over a record."""
    if not np.isfinite(zero_load):
        raise SimulationError(f'zero load is {zero_load}: give a finite load [N]')
    flat, uniform = model.stack_rows(rows)
    motion = np.empty((m.shape[0], seconds.size, 3))
    increments = np.empty((m.shape[0], seconds.size, 4))

    def run(batch: slice) -> None:
        of_rows = batch if flat.shape[0] > 1 else slice(None)
        integration.run_batch(m[batch], flat[of_rows], uniform[of_rows], seconds, force, zero_load,
                              max_step, motion[batch], increments[batch])

    in_parallel(run, shares(m.shape[0]))
    return motion, increments


class Additions:
    """All laws along one record, from its zero on; their sum at the zero is zero."""

    def __init__(self, rig: Rig, laws: Sequence[Law], time: float, load: float) -> None:
        half = 0.5 * rig.probes.axial_span
        # Change of the four probes' increments by one unit of each target.
        patterns = {
            'delta_x': np.array([1.0, 0.0, -1.0, 0.0]), 'delta_y': np.array([0.0, 1.0, 0.0, 1.0]),
            'gamma': np.array([0.0, half, 0.0, -half]), 'parity': np.array([1.0, 0.0, 1.0, 0.0]),
            **{f'eddy_current_{number + 1}': np.eye(4)[number] for number in range(4)}}
        both = [(law.target, LawHistory(law, time, load)) for law in laws]
        self._of_load = [history for target, history in both if target == LOAD_TARGET]
        self._of_probes = [(patterns[target], history) for target, history in both
                           if target != LOAD_TARGET]

    def push(self, time: Floats, load: Floats) -> tuple[Floats, Floats]:
        """The load (N,) at the ring, and the additions to the increments of the probes (N, 4)."""
        at_ring = load.copy()
        for history in self._of_load:
            at_ring += history.push(time, load)
        added = np.zeros((time.size, 4))
        for pattern, history in self._of_probes:
            added += history.push(time, load)[:, None] * pattern
        return at_ring, added
