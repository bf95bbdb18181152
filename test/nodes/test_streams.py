"""The cores of the streaming nodes on disturbed streams: late, lost, out of order, jumping."""

import numpy as np
import pytest

from saddlering_ros.bags.reader import read_run
from saddlering_ros.bags.write import write_bag
from saddlering_ros.record.batches import Displacements, join, Samples
from saddlering_ros.record.displacement import displacement_of_run, DisplacementStream
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.residual import ResidualStream, SimulationStream
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import simulate

RIG = default_rig()
NONE = Samples(np.empty(0, np.int64), np.empty(0))


def samples(stamps: np.ndarray, values: np.ndarray) -> Samples:
    return Samples(np.asarray(stamps, np.int64), np.asarray(values, float))


def measure(record, rows=slice(None), stream=None, pace=40, keep=None):
    """Push rows of a record by portions; `keep` picks rows per channel (load, 4 probes)."""
    stream = stream or DisplacementStream(RIG)
    masks = keep if keep is not None else np.ones((5, len(record.stamps)), bool)
    index = np.arange(len(record.stamps))[rows]
    batches = []
    for start in range(0, len(index), pace):
        part = index[start:start + pace]
        load = part[masks[0][part]]
        gaps = [part[masks[1 + probe][part]] for probe in range(4)]
        batches.append(stream.push(
            samples(record.stamps[load], record.load[load]),
            [samples(record.probe_stamps[probe][rows_], record.gaps[probe][rows_])
             for probe, rows_ in enumerate(gaps)]))
    return stream, join([batch for batch in batches if len(batch)])


def simulation(**options) -> SimulationStream:
    return SimulationStream(RIG, ParameterSet(TRUE_TO_SCALE), np.radians(50.0), **options)


def test_the_size_of_batches_changes_nothing(record) -> None:
    _, whole = measure(record, pace=100_000)
    for pace in (1, 7, 333):
        _, parts = measure(record, pace=pace)
        assert np.array_equal(parts.stamps, whole.stamps)
        assert np.array_equal(parts.channels, whole.channels)
        assert np.array_equal(parts.zero_loads, whole.zero_loads)


def test_joining_under_load_gives_nothing_until_preload_comes(record) -> None:
    middle = len(record.stamps) // 2
    stream, found = measure(record, slice(middle, None))
    last_zero = record.stamps[-1] - 0.5e9
    assert stream.zero is None or found.stamps[0] > last_zero
    later = record.later(60.0)
    _, found = measure(later, stream=DisplacementStream(RIG))
    assert len(found)


def test_zero_on_request_is_taken_at_any_load_and_nothing_is_lost(record) -> None:
    middle = len(record.stamps) // 2
    stream, _ = measure(record, slice(0, middle))
    held = np.full(600, record.load[middle - 1])
    stamps = record.stamps[middle - 1] + 2_000_000 * np.arange(1, 601)
    stream.zero_after(stream.newest_stamp)
    after = stream.push(samples(stamps, held), [
        samples(stamps + 1000, np.full(600, record.gaps[probe][middle - 1]))
        for probe in range(4)])
    assert abs(after.zero_loads[-1] - held[0]) < 1.0
    assert np.abs(after.channels[:3, -1]).max() < 1e-6
    assert set(stamps[:-1].tolist()) <= set(after.stamps.tolist())


def test_lost_samples_change_other_rows_by_no_more_than_interpolation(record) -> None:
    keep = np.random.default_rng(3).random((5, len(record.stamps))) > 0.02
    keep[:, :450] = True  # the zero window is the same
    _, whole = measure(record)
    stream, lossy = measure(record, keep=keep)
    assert set(lossy.stamps.tolist()) <= set(record.stamps[keep[0]].tolist())
    assert stream.aligner.counters.dropped < 20
    _, ours, theirs = np.intersect1d(lossy.stamps, whole.stamps, return_indices=True)
    assert np.abs(lossy.channels[:, ours] - whole.channels[:, theirs]).max() < 5e-6


def test_probes_out_of_order_change_nothing_if_they_are_there_before_the_load(record) -> None:
    order = np.arange(len(record.stamps)).reshape(-1, 2)[:, ::-1].ravel()
    _, whole = measure(record)
    stream = DisplacementStream(RIG)
    stream.push(NONE, [samples(record.probe_stamps[probe][order], record.gaps[probe][order])
                       for probe in range(4)])
    found = stream.push(samples(record.stamps, record.load), [NONE] * 4)
    assert stream.aligner.counters.reordered == 4 * len(order) // 2
    assert np.array_equal(found.stamps, whole.stamps)
    assert np.array_equal(found.channels, whole.channels)


@pytest.mark.parametrize('lead', [-1, 0, 1])
@pytest.mark.parametrize('pace', [1, 7, 50])
def test_loads_that_overtake_are_measured_whichever_topic_arrives_first(record, pace, lead):
    """The load comes `lead` portions before the probes; pairs of its samples change places."""
    order = np.arange(len(record.stamps)).reshape(-1, 2)[:, ::-1].ravel()
    stream, found = DisplacementStream(RIG), []
    for start in range(-pace, len(order) + pace, pace):
        load = order[max(start + lead * pace, 0):max(start + (lead + 1) * pace, 0)]
        gaps = slice(max(start, 0), max(start + pace, 0))
        found.append(stream.push(
            samples(record.stamps[load], record.load[load]),
            [samples(record.probe_stamps[probe][gaps], record.gaps[probe][gaps])
             for probe in range(4)]))
    found.append(stream.flush())
    measured = join([batch for batch in found if len(batch)])
    assert stream.aligner.counters.late_loads <= 1  # the first late one
    assert len(measured) + stream.aligner.counters.dropped == len(order)
    assert (np.diff(measured.stamps) > 0).all()
    assert not stream.held


def test_a_pause_inside_a_replayed_bag_keeps_zero_and_simulation_as_in_the_commands(
        record, tmp_path) -> None:
    paused = record.paused(900, 30.0)  # under load
    run = read_run(write_bag(tmp_path / 'paused', TestMetadata('dynamic', 50.0), paused.stamps,
                             paused.load, paused.probe_stamps, paused.gaps, RIG.probes))
    measured = displacement_of_run(RIG, run)
    computed = simulate(RIG, ParameterSet(TRUE_TO_SCALE), run.elevation, run.time, run.load)
    stream = DisplacementStream(RIG)
    stream.recording = int(paused.stamps[0]), int(paused.probe_stamps[3][-1])
    _, live = measure(paused, stream=stream)
    rows = measured.complete
    assert np.array_equal(live.stamps, run.stamps[rows])
    assert np.array_equal(live.channels, measured.displacement.channels[:, rows])
    simulator = simulation()
    simulator.recording = stream.recording
    live = simulator.push(samples(paused.stamps, paused.load))
    assert np.array_equal(live.stamps, run.stamps[computed.first:])
    assert np.array_equal(live.channels, computed.displacement.channels)


def test_loads_that_overtake_are_simulated_in_order_after_the_first_late_one(record) -> None:
    fresh = simulation().push(samples(record.stamps, record.load))
    order = np.arange(len(record.stamps)).reshape(-1, 2)[:, ::-1].ravel()
    stream = simulation()
    batches = [stream.push(samples(record.stamps[[row]], record.load[[row]])) for row in order]
    batches.append(stream.flush())
    found = join([batch for batch in batches if len(batch)])
    assert stream.counters.late == 1
    assert len(found) == len(fresh) - 1
    assert (np.diff(found.stamps) > 0).all()


def test_a_zero_asked_for_restarts_the_simulation_at_that_load(record) -> None:
    stream = simulation()
    stream.push(samples(record.stamps[:1000], record.load[:1000]))
    stream.zero_after(int(record.stamps[999]))
    stamps = record.stamps[999] + 2_000_000 * np.arange(1, 400)
    states = stream.push(samples(stamps, np.full(399, 150e3)))
    assert abs(states.zero_loads[0] - 150e3) < 1.0
    assert np.abs(states.channels).max() < 1e-9
    assert np.array_equal(states.stamps, stamps)


def test_an_elevation_that_gives_within_a_test_is_followed_and_keeps_the_zero(record) -> None:
    def simulated(degrees: float, then: float | None = None) -> Displacements:
        stream = SimulationStream(RIG, ParameterSet(TRUE_TO_SCALE), np.radians(degrees))
        middle = len(record.stamps) // 3
        parts = [stream.push(samples(record.stamps[:middle], record.load[:middle]))]
        if then is not None:
            stream.turn(np.radians(then))
        parts.append(stream.push(samples(record.stamps[middle:], record.load[middle:])))
        return join(parts)

    turned, before, after = simulated(50.0, 50.3), simulated(50.0), simulated(50.3)
    assert np.array_equal(turned.stamps, before.stamps)
    assert set(turned.zero_stamps.tolist()) == set(before.zero_stamps.tolist())
    assert set(turned.elevations.tolist()) == {np.radians(50.0), np.radians(50.3)}
    peak = int(record.load[:len(turned)].argmax())
    moved = np.abs(after.channels - before.channels)[:3, peak]
    left = np.abs(turned.channels - after.channels)[:3, peak]
    assert (left < 0.2 * moved).all()


def pair(stamps, value: float, zero: int = 5, zero_load: float = 100.0) -> Displacements:
    stamps = np.asarray(stamps, np.int64)
    channels = np.full((4, len(stamps)), value) + stamps * 1e-12
    return Displacements.from_zero(stamps, channels, (zero, zero), zero_load)


def test_only_equal_stamps_are_subtracted_whatever_the_order_of_arrival() -> None:
    rng = np.random.default_rng(1)
    stream = ResidualStream(FULL_SCALE_LOAD)
    stamps = np.arange(1, 2001) * 1_000_000
    ours, theirs = stamps[rng.random(2000) > 0.1], stamps[rng.random(2000) > 0.1]
    found = []
    for start in range(0, 2000, 100):
        found.append(stream.push(pair(ours[start:start + 100], 3.0),
                                 pair(rng.permutation(theirs[start:start + 100]), 1.0)))
    together = join([batch for batch in found if len(batch)])
    assert sorted(together.stamps.tolist()) == np.intersect1d(ours, theirs).tolist()
    assert np.allclose(together.channels, 2.0, rtol=0.0, atol=1e-12)


def test_a_replay_that_begins_anew_in_one_batch_is_joined_with_itself_alone() -> None:
    stream = ResidualStream(FULL_SCALE_LOAD)
    stamps = np.arange(1, 2001) * 1_000_000
    stream.push(pair(stamps[:1000], 3.0), pair([], 1.0))
    found = stream.push(pair(stamps, 5.0), pair(stamps, 1.0))
    assert stream.counters.jumps == 1
    assert np.allclose(found.channels, 4.0, rtol=0.0, atol=1e-12)


def test_a_side_whose_partner_is_gone_waits_in_bounded_memory() -> None:
    stream = ResidualStream(FULL_SCALE_LOAD)
    for start in range(0, 60_000, 1000):
        stamps = np.arange(start, start + 1000) * 1_000_000 + 1
        stream.push(pair(stamps, 3.0), pair([], 1.0))
    assert stream.waiting == (20_000, 0)
    assert len(stream.push(pair([], 3.0), pair(stamps, 1.0))) == 1000
    assert stream.counters.measured_alone >= 40_000


@pytest.mark.parametrize('restarted', ['measured', 'simulated'])
def test_a_side_that_zeroed_anew_is_joined_by_what_the_other_did_meanwhile(restarted) -> None:
    """Measured and simulated differ by 2 + drift; one of them then counts from a later zero."""
    stamps = np.arange(1, 4001) * 1_000_000
    motion = 40.0 * np.sin(stamps / 2e9)
    zero, window = int(stamps[2000]), slice(2000, 2500)
    values = {'measured': motion + 2.0 + stamps * 1e-9, 'simulated': motion.copy()}
    sides = {}
    for name, series in values.items():
        new = name == restarted
        rows = slice(2000, None) if new else slice(None)
        sides[name] = Displacements.from_zero(
            stamps[rows], np.tile(series[rows] - (series[window].mean() if new else 0.0), (4, 1)),
            (zero, zero) if new else (5, 5), 100.0)
    stream = ResidualStream(FULL_SCALE_LOAD)
    found = []
    for start in range(0, 4000, 130):
        part = {name: side.pick(np.flatnonzero(
            (side.stamps > start * 1_000_000) & (side.stamps <= (start + 130) * 1_000_000)))
                for name, side in sides.items()}
        found.append(stream.push(part['measured'], part['simulated']))
    together = join([batch for batch in found if len(batch)])
    assert together.stamps[0] <= stamps[2502]
    assert together.stamps[-1] == stamps[-1]
    assert set(together.zero_stamps.tolist()) == {zero}
    drift = together.stamps * 1e-9 - (stamps[window] * 1e-9).mean()
    assert np.allclose(together.channels, drift, rtol=0.0, atol=1e-9)
    assert stream.zeros_agree


@pytest.mark.parametrize('other', [{'zero': 5 + 600_000_000}, {'zero_load': 5000.0}])
def test_displacements_from_different_zeros_are_not_subtracted(other) -> None:
    stream = ResidualStream(FULL_SCALE_LOAD)
    stamps = np.arange(1, 11) * 1_000_000
    assert len(stream.push(pair(stamps, 3.0), pair(stamps, 1.0, **other))) == 0
    assert stream.counters.zero_differs == 10
    assert not stream.zeros_agree


@pytest.mark.parametrize('window', [100, 500])
def test_the_bridge_averages_over_the_window_of_the_newer_zero(window: int) -> None:
    """The measured side zeroed anew over 0.1 s of a drifting signal; 0.5 s would bias it."""
    stamps = np.arange(1, 2001) * 1_000_000
    motion = stamps * 1e-9  # both sides drift alike: the residual is zero
    older = Displacements.from_zero(stamps, np.tile(motion, (4, 1)), (5, 5), 100.0)
    new = slice(1000, None)
    newer = Displacements.from_zero(
        stamps[new], np.tile(motion[new] - motion[1000:1000 + window].mean(), (4, 1)),
        (stamps[1000], stamps[999 + window]), 100.0)
    found = ResidualStream(FULL_SCALE_LOAD).push(newer, older)
    assert len(found)
    assert np.abs(found.channels).max() < 1e-12


def test_the_simulation_and_the_displacement_state_how_long_their_zero_took(record) -> None:
    _, measured = measure(record)
    simulated = simulation().push(samples(record.stamps, record.load))
    assert 0.1 <= measured.zero_durations[-1] <= 0.5
    assert set(measured.zero_durations.tolist()) == {measured.zero_durations[0]}
    assert abs(simulated.zero_durations[-1] - measured.zero_durations[-1]) < 3e-3


def thinned(record, step: int):
    """Every `step`-th sample of a record."""
    return type(record)(record.stamps[::step], record.load[::step],
                        [stamps[::step] for stamps in record.probe_stamps],
                        [gaps[::step] for gaps in record.gaps])


@pytest.mark.parametrize('shift', [3600.0, 16.0, -100.0])
@pytest.mark.parametrize(('first', 'second'), [(1, 20), (20, 1), (1, 1)])
def test_a_test_behind_a_stamp_jump_is_as_it_is_alone_at_any_rate(record, first, second, shift):
    before, after = thinned(record, first), thinned(record, second).later(shift)
    _, alone = measure(after)
    stream, _ = measure(before)
    _, then = measure(after, stream=stream)
    assert np.array_equal(then.stamps, alone.stamps)
    assert np.array_equal(then.channels, alone.channels)
    assert set(then.zero_stamps.tolist()) == {int(alone.zero_stamps[0])}
    assert stream.aligner.counters.load_jumps + stream.jumps_ahead == 1
    simulator = simulation()
    simulator.push(samples(before.stamps, before.load))
    again = simulator.push(samples(after.stamps, after.load))
    fresh = simulation().push(samples(after.stamps, after.load))
    assert np.array_equal(again.stamps, fresh.stamps)
    assert np.array_equal(again.channels, fresh.channels)
    assert simulator.counters.jumps == 1


def test_the_topic_that_brings_the_next_row_is_awaited(record) -> None:
    stream, _ = measure(record, slice(0, 40))

    def push(load: int, *probes: int) -> int | None:
        """Which topic is awaited after a batch with these rows of the load and of each probe."""
        rows = stream.rows
        stream.push(samples(record.stamps[load - 1:load], record.load[load - 1:load]),
                    [samples(record.probe_stamps[place][row - 1:row],
                             record.gaps[place][row - 1:row])
                     for place, row in enumerate(probes)])
        return stream.awaited(rows)

    nothing = 0
    assert push(41, nothing, nothing, nothing, nothing) == 4  # which comes last of the five
    assert push(nothing, 41, 41, nothing, 41) == 3
    assert push(nothing, nothing, nothing, 41, nothing) is None  # a row has come
    assert push(nothing, 42, 42, 42, 42) == 0  # here the load comes last


def test_a_reading_that_is_no_number_is_counted_once_among_the_events(record) -> None:
    stream, _ = measure(record, slice(0, 40))
    stream.push(NONE, [samples(record.stamps[40:41], np.array([np.nan])), NONE, NONE, NONE])
    assert stream.events()['not_finite'] == 1
    assert stream.events().keys() > vars(stream.aligner.counters).keys()
