"""An impossible stamp or reading costs itself and no other sample."""

import time

import numpy as np
import pytest
import rclpy

from saddlering_ros.nodes.ring_displacement import RingDisplacementNode
from saddlering_ros.nodes.ring_simulator import RingSimulatorNode
from saddlering_ros.record.batches import BRIDGED, Displacements, DOUBTFUL_LOAD, join, Samples
from saddlering_ros.record.displacement import DisplacementStream
from saddlering_ros.record.guard import load_limits, probe_limits, SampleGuard
from saddlering_ros.record.residual import ResidualStream, SimulationStream
from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE

RIG = default_rig()
MS = 1_000_000
START = 10**18


def through(guard: SampleGuard, stamps, values, pace: int = 7) -> list[tuple[int, float]]:
    found: list[tuple[int, float]] = []
    for start in range(0, len(stamps), pace):
        part = slice(start, start + pace)
        due = guard.push(Samples(np.asarray(stamps[part], np.int64), np.asarray(values[part])))
        found += zip(due.stamps.tolist(), due.values.tolist(), strict=True)
    return found


def steady(count: int = 100) -> tuple[list[int], list[float]]:
    return [START + MS * index for index in range(count)], [1e5] * count


def ramp() -> tuple[np.ndarray, np.ndarray]:
    """Stamps [ns] and loads [N] of half a wave of 3 s."""
    rows = np.arange(3000)
    return START + MS * rows, 0.9 * RIG.full_scale_load * np.sin(np.pi * rows / 3000.0)


def simulated(load: Samples) -> tuple[SimulationStream, Displacements]:
    stream = SimulationStream(RIG, ParameterSet(TRUE_TO_SCALE), np.radians(50.0))
    parts = [stream.push(load.pick(slice(start, start + 40))) for start in range(0, len(load), 40)]
    return stream, join([batch for batch in parts if len(batch)])


@pytest.mark.parametrize('pace', [1, 7, 100])
@pytest.mark.parametrize(('name', 'stamp', 'value'), [
    ('without_stamp', 0, 1e5), ('without_stamp', -5, 1e5), ('not_finite', None, np.nan),
    ('impossible', None, 50 * 9806.65), ('impossible', None, 3e38),
    ('leaps_of_stamp', START + 10**18, 1e5), ('leaps_of_stamp', START - 10**17, 1e5),
    ('leaps_of_stamp', START + 250 * MS, 1e5), ('leaps_of_reading', None, 2.2e5)])
def test_one_outlier_is_refused_and_every_other_sample_passes(name, stamp, value, pace) -> None:
    stamps, values = steady()
    sound = list(zip(stamps, values, strict=True))
    stamps.insert(50, stamps[49] + MS // 2 if stamp is None else stamp)
    values.insert(50, value)
    guard = SampleGuard(load_limits(RIG))
    assert through(guard, stamps, values, pace) == sound
    assert {key: count for key, count in vars(guard.counters).items() if count} == {name: 1}


@pytest.mark.parametrize('change', ['step', 'stall', 'stopped clock', -100.0, 0.2, 3600.0])
def test_a_step_a_stall_and_a_clock_that_was_set_pass_whole(change: str | float) -> None:
    stamps, values = steady()
    if change == 'step':
        values[50:] = [2.2e5] * 50
    elif change == 'stall':
        stamps, values = ramp()
        values[300:900] = values[300]
    elif change == 'stopped clock':  # The load goes on meanwhile, by 0.8 of full scale.
        stamps, values = ramp()
        stamps[300:1300] = stamps[300]
    else:
        stamps[50:] = [stamp + round(change * 1e9) for stamp in stamps[50:]]
    guard = SampleGuard(load_limits(RIG))
    assert through(guard, stamps, values) == list(zip(stamps, values, strict=True))
    assert not any(vars(guard.counters).values())


def test_the_last_sample_behind_a_gap_passes_when_nothing_more_comes() -> None:
    stamps, values = steady()
    stamps[-1] += 10**9
    guard = SampleGuard(load_limits(RIG))
    assert through(guard, stamps, values)[-1][0] == stamps[-2]
    assert guard.flush().stamps.tolist() == [stamps[-1]]


def test_a_reading_far_beyond_a_probes_range_is_impossible_and_one_at_its_end_is_not() -> None:
    guard = SampleGuard(probe_limits(RIG))
    found = through(guard, [START, START + MS, START + 2 * MS], [1.99e-3, 3e38, 2e-3])
    assert [value for _, value in found] == [1.99e-3, 2e-3]


def load_of(record, **changes: tuple[int, float]) -> Samples:
    stamps, load = record.stamps.copy(), record.load.copy()
    for name, (row, value) in changes.items():
        (stamps if name == 'stamp' else load)[row] = value
    return Samples(stamps, load)


@pytest.mark.parametrize('changes', [
    {'load': (900, 50 * 9806.65)}, {'load': (900, -2e5)}, {'stamp': (900, 0)},
    {'stamp': (900, 4 * 10**18)}])
def test_one_bad_load_leaves_the_simulation_within_a_micrometre(record, changes) -> None:
    (_, whole), (_, other) = simulated(load_of(record)), simulated(load_of(record, **changes))
    assert len(other) == len(whole) - 1
    _, ours, theirs = np.intersect1d(whole.stamps, other.stamps, return_indices=True)
    assert np.abs(whole.channels[:, ours] - other.channels[:, theirs]).max() < 1e-6


@pytest.mark.parametrize('pace', [1, 40, 3000])
@pytest.mark.parametrize(('width', 'name'), [
    (2.2 * RIG.full_scale_load, 'impossible'), (0.5 * RIG.full_scale_load, 'doubtful_load')])
def test_a_load_that_rolls_over_is_refused_or_doubtful_until_it_comes_back(width, name, pace):
    """A counter is `width` [N] too narrow for 600 rows."""
    stamps, load = ramp()
    rows, read = slice(1200, 1800), load.copy()
    read[rows] -= width
    guard = SampleGuard(load_limits(RIG))
    found = dict(through(guard, stamps, read, pace))
    marked = stamps[guard.marks(stamps) == DOUBTFUL_LOAD]
    assert {key: count for key, count in vars(guard.counters).items() if count} == {name: 600}
    outside = np.delete(np.arange(3000), rows)
    assert all(found[int(stamps[row])] == load[row] for row in outside)
    if name == 'impossible':
        assert len(found) == 2400
    else:
        assert np.array_equal(marked, stamps[rows])


def test_a_load_that_stays_away_is_doubtful_up_to_the_next_test() -> None:
    stamps, values = steady(200)
    values[50:] = [1e5 - 0.3 * RIG.full_scale_load] * 150
    values[::2] = [value + 50.0 for value in values[::2]]
    stamps[150:] = [stamp + 60 * 10**9 for stamp in stamps[150:]]
    guard = SampleGuard(load_limits(RIG))
    assert through(guard, stamps, values) == list(zip(stamps, values, strict=True))
    marked = guard.marks(np.asarray(stamps, np.int64)) == DOUBTFUL_LOAD
    assert np.flatnonzero(marked).tolist() == list(range(50, 150))


@pytest.mark.parametrize(('opened', 'noise'), [(900, 0.0), (1800, 100.0)])
def test_a_contact_that_opens_is_doubtful_until_it_closes(opened: int, noise: float) -> None:
    """Meanwhile the load rises, or falls, by an eighth of full scale."""
    stamps, load = ramp()
    load[opened:opened + 300] = noise * np.sin(np.arange(300))
    guard = SampleGuard(load_limits(RIG))
    through(guard, stamps, load)
    marked = np.flatnonzero(guard.marks(stamps) == DOUBTFUL_LOAD)
    assert marked.tolist() == list(range(opened, opened + 300))


def test_a_simulation_by_a_doubtful_load_is_marked(record) -> None:
    load = record.load.copy()
    load[900:1000] -= 0.4 * RIG.full_scale_load
    stream, found = simulated(Samples(record.stamps, load))
    assert np.array_equal(found.stamps[found.validity == DOUBTFUL_LOAD], record.stamps[900:1000])
    assert stream.guard.counters.doubtful_load == 100


@pytest.mark.parametrize('stamp', [0, START + 60 * 10**9, 4 * 10**18])
def test_a_stray_load_inside_the_zero_window_leaves_one_zero_to_both(record, stamp: int) -> None:
    gaps = [Samples(record.probe_stamps[probe], record.gaps[probe]) for probe in range(4)]
    zeros = []
    for load in (load_of(record), load_of(record, stamp=(100, stamp))):
        measured, simulated = DisplacementStream(RIG), SimulationStream(
            RIG, ParameterSet(TRUE_TO_SCALE), np.radians(50.0))
        both = measured.push(load, gaps), simulated.push(load)
        assert len(ResidualStream(RIG.full_scale_load).push(*both)) == len(both[0])
        zeros.append([(one.zero_stamps[-1], one.zero_loads[-1]) for one in both])
        counted = [vars(measured.guards()[0].counters), vars(simulated.guard.counters)]
    assert np.allclose(zeros[0], zeros[1], rtol=0.0, atol=5.0), 'N: a mean has one sample less'
    assert counted[0] == counted[1]
    assert sum(counted[0].values()) == 1


def test_an_impossible_gap_is_bridged_and_marked(record) -> None:
    gaps = [gap.copy() for gap in record.gaps]
    gaps[0][900] = 1.0
    stream = DisplacementStream(RIG)
    found = stream.push(Samples(record.stamps, record.load), [
        Samples(record.probe_stamps[probe], gaps[probe]) for probe in range(4)])
    whole = DisplacementStream(RIG).push(Samples(record.stamps, record.load), [
        Samples(record.probe_stamps[probe], record.gaps[probe]) for probe in range(4)])
    assert np.array_equal(found.stamps, whole.stamps)
    assert np.abs(found.channels - whole.channels).max() < 3e-6
    marked = found.stamps[found.validity == BRIDGED]
    assert 1 <= len(marked) <= 2
    assert np.abs(marked - record.probe_stamps[0][900]).max() <= 2 * MS
    assert stream.events()['impossible'] == 1


@pytest.mark.ros
@pytest.mark.usefixtures('ros_domain')
@pytest.mark.parametrize('kind', [RingSimulatorNode, RingDisplacementNode])
@pytest.mark.parametrize('period', [0.1, 0.7])
def test_an_outlier_is_refused_however_slowly_its_stream_is_played(kind, period, monkeypatch):
    rclpy.init(args=[''])
    node, clock = kind(), [time.monotonic()]
    monkeypatch.setattr(time, 'monotonic', lambda: clock[0])
    try:
        node.configure()
        node._send = lambda batch: None
        loads = np.full(40, RIG.preload)
        loads[30] += 0.3 * RIG.full_scale_load
        for row, load in enumerate(loads):
            stamps = np.array([START + 10 * MS * row])
            node.inputs = [Arrived(stamps, load), *(Arrived(stamps, 1e-3) for _ in range(4))]
            node.process_batch()
            clock[0] += period - 0.01
            node.at_intervals(clock[0])
            clock[0] += 0.01
        guard = node._stream.guard if kind is RingSimulatorNode else node._stream.guards()[0]
        assert (guard.counters.leaps_of_reading, guard.counters.doubtful_load) == (1, 0)
    finally:
        monkeypatch.undo()
        node.destroy_node()
        rclpy.try_shutdown()


class Arrived:
    """An input of a node that takes one sample."""

    def __init__(self, stamps: np.ndarray, value: float) -> None:
        self.take_samples = lambda _: Samples(stamps, np.full(len(stamps), value))
