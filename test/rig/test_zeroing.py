"""Claims about the zero of a test: which stretch is averaged, live and offline alike."""

import tracemalloc

import numpy as np
import pytest

from saddlering_ros.rig import default_rig, geometry, TONNE
from saddlering_ros.rig.geometry import MIN_SAMPLES, zero_of_blocks, zero_of_record, ZeroWindow

RIG = default_rig()


def steady(seconds: float, load: float, rate: float = 100.0,
           start: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    time = start + np.arange(round(seconds * rate)) / rate
    return time, np.full(time.size, load)


def test_the_window_closes_half_a_second_after_it_opened() -> None:
    time, load = steady(2.0, RIG.preload)
    reading = zero_of_record(RIG, time, load)
    assert (reading.start, reading.end) == (0, 51)
    assert reading.load == pytest.approx(RIG.preload)


@pytest.mark.parametrize(('share', 'end'), [(0.011, 20), (0.009, 51)])
def test_the_window_closes_when_the_load_leaves_its_start_by_one_percent_of_full_scale(
        share: float, end: int) -> None:
    time = np.arange(100) * 0.01
    load = RIG.preload + np.where(time < 0.195, 0.0, share * RIG.full_scale_load)
    reading = zero_of_record(RIG, time, load)
    assert (reading.start, reading.end) == (0, end)
    assert reading.load == pytest.approx(load[:end].mean())


def test_readings_are_means_over_the_window_and_nothing_else() -> None:
    time, load = steady(1.0, RIG.preload)
    gaps = np.random.default_rng(1).normal(1e-3, 1e-6, (4, time.size))
    reading = zero_of_blocks(RIG, lambda: [(time, load, gaps)])
    assert reading.gaps == pytest.approx(gaps[:, :51].mean(axis=1), rel=1e-14)


@pytest.mark.parametrize(('first', 'probe_1'), [
    (np.r_[np.zeros(20), 0.45e-3, np.full(179, 1e-3)], 1e-3),  # its device reads after 0.2 s
    (np.zeros(200), np.nan),  # or never
    (np.where(np.arange(200) % 2, 0.0, 2e-3), np.nan)])  # a loose contact
def test_a_probe_that_does_not_read_spoils_no_zero(first: np.ndarray, probe_1: float) -> None:
    """Zeros of a driver whose device had not read yet shifted a whole test by 200 um."""
    time, load = steady(2.0, RIG.preload)
    gaps = np.full((4, time.size), 1e-3)
    gaps[0] = first
    reading = zero_of_blocks(RIG, lambda: [(time, load, gaps)])
    assert reading.gaps == pytest.approx([probe_1, 1e-3, 1e-3, 1e-3], nan_ok=True)


def test_loads_above_preload_are_passed_over_until_one_near_preload_comes() -> None:
    high_time, high_load = steady(1.0, 5.0 * TONNE)
    low_time, low_load = steady(2.0, RIG.preload, start=1.0)
    reading = zero_of_record(RIG, np.append(high_time, low_time), np.append(high_load, low_load))
    assert (100 <= reading.start < 200, reading.near_preload) == (True, True)


def test_a_ring_that_comes_back_from_a_load_settles_before_its_zero() -> None:
    # A node that is started within a test. Its ring creeps by 7 um over 90 ms.
    time = np.arange(300) * 0.01
    load = np.where(time < 1.0, 5.0 * TONNE, RIG.preload)
    settled = np.full((4, 300), 1e-3)
    gaps = settled + 7e-6 * np.exp(-np.maximum(time - 1.0, 0.0) / 0.09)
    window = ZeroWindow(RIG)
    for reading in (zero_of_blocks(RIG, lambda: [(time, load, gaps)]),
                    window.push_batch(time, load, gaps)):
        assert reading is not None
        assert reading.near_preload
        assert reading.gaps == pytest.approx(settled[:, 0], abs=2e-8)


def test_a_record_that_never_sees_preload_is_zeroed_where_it_is_steady_first_and_says_so() -> None:
    time = np.arange(300) * 0.01
    load = 5.0 * TONNE + np.where(time < 1.0, 20.0 * TONNE * (1.0 - time), 0.0)
    reading = zero_of_record(RIG, time, load)
    assert not reading.near_preload
    assert load[reading.start:reading.end] == pytest.approx(reading.load, abs=0.25 * TONNE)


def test_a_stretch_of_too_few_samples_is_none_and_the_next_one_counts() -> None:
    low = RIG.preload - 0.015 * RIG.full_scale_load
    load = np.array([low] * (MIN_SAMPLES - 1) + [RIG.preload] * 80)
    reading = zero_of_record(RIG, np.arange(load.size) * 0.01, load)
    assert reading.start == MIN_SAMPLES - 1
    assert reading.load == pytest.approx(RIG.preload)


def test_a_load_that_passes_through_the_preload_is_no_rest() -> None:
    """A node that starts while the load comes down must wait for the hold below."""
    time = np.arange(2000) * 1e-3
    load = RIG.preload + np.maximum(0.0, 0.7 - time) * RIG.full_scale_load
    reading = zero_of_record(RIG, time, load)
    assert reading.near_preload
    assert time[reading.start] > 0.65
    assert reading.load == pytest.approx(RIG.preload, abs=0.002 * RIG.full_scale_load)


def test_every_window_ends_after_the_shortest_that_counts() -> None:
    """Otherwise no window would count, and a live node would wait for ever."""
    assert geometry.MIN_WINDOW_SECONDS < geometry.WINDOW_SECONDS


def test_a_few_samples_before_a_gap_of_the_stream_are_no_rest() -> None:
    time = np.append(np.arange(30) * 1e-3, 5.0 + np.arange(1000) * 1e-3)
    load = np.append(RIG.preload + np.arange(30) * 200.0, np.full(1000, RIG.preload))
    assert zero_of_record(RIG, time, load).start == 30


def test_a_record_without_any_steady_stretch_is_zeroed_at_its_first_sample() -> None:
    time = np.arange(20) * 0.01
    reading = zero_of_record(RIG, time, RIG.preload + 3.0 * TONNE * np.arange(20))
    assert (reading.start, reading.end, reading.load) == (0, 1, RIG.preload)
    assert not reading.near_preload


def test_a_record_that_ends_inside_its_first_window_is_zeroed_at_its_first_sample() -> None:
    time, load = steady(0.3, RIG.preload)
    assert zero_of_record(RIG, time, load).end == 1


def test_pushing_samples_one_by_one_gives_the_records_zero_to_the_last_bit() -> None:
    random = np.random.default_rng(2)
    time, load = steady(1.0, RIG.preload)
    load = load + random.normal(0.0, 50.0, load.size)
    gaps = random.normal(1e-3, 1e-6, (4, time.size))
    window = ZeroWindow(RIG)
    live = [window.push(t, p, tuple(g)) for t, p, g in zip(time, load, gaps.T, strict=True)]
    reading = next(item for item in live if item is not None)
    assert reading == zero_of_blocks(RIG, lambda: [(time, load, gaps)])
    assert live.index(reading) == reading.end


def test_a_window_asked_to_open_anywhere_opens_at_a_high_load() -> None:
    window = ZeroWindow(RIG, anywhere=True)
    time, load = steady(1.0, 20.0 * TONNE)
    readings = [window.push(t, p) for t, p in zip(time, load, strict=True)]
    reading = next(item for item in readings if item is not None)
    assert (reading.start, reading.near_preload) == (0, False)


def test_the_zero_of_a_long_record_takes_no_memory_of_its_length() -> None:
    time = np.arange(1_000_000) / 10e3
    load = np.full(time.size, RIG.preload)
    gaps = np.ones((4, time.size))
    tracemalloc.start()
    zero = zero_of_blocks(RIG, lambda: [(time, load, gaps)])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert zero.near_preload
    assert peak < 10_000_000
