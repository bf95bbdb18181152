"""Long bags are read through scratch files: the same numbers, in memory that does not grow."""

import csv
from dataclasses import replace
import os
import tracemalloc

import numpy as np
from pyarrow import parquet
import pytest

from saddlering_ros.bags.reader import bag_info, read_run
from saddlering_ros.bags.samples import displacement_columns, write_samples
from saddlering_ros.bags.write import BagWriter, messages_of
from saddlering_ros.diagnosis.records import build_record
from saddlering_ros.doubts.comparison import refuse_repeats
from saddlering_ros.errors import BagError
from saddlering_ros.identification.prepared import prepare
from saddlering_ros.record import scratch
from saddlering_ros.record.displacement import (
    displacement_of_run,
    measured_rows,
    measured_stretches,
    zero_of_run,
)
from saddlering_ros.record.plateaus import find_holds
from saddlering_ros.record.quality import topic_quality
from saddlering_ros.record.record import condensed, fit_limit
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, TOPICS
from saddlering_ros.rig import default_rig

RIG = default_rig()


@pytest.fixture
def in_small_blocks(monkeypatch):
    """Arrays beyond a few samples lie in scratch files and are looked at in small blocks."""
    def use(long=100, block=64):
        monkeypatch.setattr(scratch, 'LONG', long)
        monkeypatch.setitem(scratch.blocks.__kwdefaults__, 'size', block)
    return use


@pytest.fixture
def struck(recording):
    """A recording with spikes, a gap in a probe, and late messages."""
    load = recording.values[LOAD_TOPIC].copy()
    load[[200, 640]] += 3e5
    gap = np.delete(recording.stamps[PROBE_TOPICS[1]], slice(300, 340))
    values = np.delete(recording.values[PROBE_TOPICS[1]], slice(300, 340))
    return recording.changed(LOAD_TOPIC, values=load).changed(PROBE_TOPICS[1], gap, values)


def test_a_run_through_scratch_files_is_the_same_to_the_last_bit(tmp_path, struck,
                                                                 in_small_blocks):
    bag = struck.write(tmp_path / 'bag')
    short = read_run(bag, rig=RIG)
    expected = displacement_of_run(RIG, short)
    in_small_blocks()
    long = read_run(bag, rig=RIG)
    found = displacement_of_run(RIG, long)
    for name in ('stamps', 'time', 'load', 'gaps', 'spikes'):
        assert np.array_equal(getattr(long, name), getattr(short, name), equal_nan=name == 'gaps')
    assert found.zero == expected.zero
    assert np.array_equal(found.d, expected.d, equal_nan=True)
    assert [note for note in long.notes if 'spikes' in note or 'gap' in note] == [
        note for note in short.notes if 'spikes' in note or 'gap' in note]


def test_what_is_looked_at_in_blocks_is_what_is_seen_in_the_whole(in_small_blocks):
    random = np.random.default_rng(0)
    stamps = np.arange(4000) * 1_000_000
    time = stamps * 1e-9
    values = 1e-3 + 1e-4 * np.repeat(np.arange(8) % 5, 500) + random.normal(0.0, 3e-7, 4000)
    values[[0, 63, 64, 127, 2222, 3999]] += 4e-5
    values[1900:1960] = values[1900]
    load = 1e5 + 1e9 * (values - 1e-3)
    whole, holds = topic_quality(stamps, values), find_holds(time, load)
    in_small_blocks(long=1 << 20)
    found = topic_quality(stamps, values)
    assert len(holds) == 8
    assert find_holds(time, load) == holds
    assert found.spikes.tolist() == whole.spikes.tolist()
    assert {64, 2222} <= set(whole.spikes.tolist())
    assert whole.stall == (1900, 60)
    for name in ('rate', 'mean_rate', 'repeated', 'noise', 'stall', 'limit', 'resolution'):
        assert np.array_equal(getattr(found, name), getattr(whole, name), equal_nan=True), name


@pytest.mark.parametrize('suffix', ['csv', 'parquet'])
def test_a_table_written_in_stretches_is_the_table_written_whole(tmp_path, recording,
                                                                 in_small_blocks, suffix):
    run = read_run(recording.write(tmp_path / 'bag'), rig=RIG)
    whole, parts = tmp_path / f'whole.{suffix}', tmp_path / f'parts.{suffix}'
    zero = zero_of_run(RIG, run)
    write_samples(whole, [displacement_columns(run, measured_rows(RIG, run, zero, slice(None)))])
    in_small_blocks()
    write_samples(parts, (displacement_columns(run, batch)
                          for batch in measured_stretches(RIG, run, [])[0]))
    if suffix == 'csv':
        assert parts.read_bytes() == whole.read_bytes()
        assert len(list(csv.reader(parts.open()))) > 900
    else:
        assert parquet.read_table(parts).equals(parquet.read_table(whole))


def test_a_record_that_never_comes_near_the_preload_takes_its_zero_at_the_start(
    tmp_path, recording, in_small_blocks,
):
    load = recording.values[LOAD_TOPIC] + 50_000.0
    run = read_run(recording.changed(LOAD_TOPIC, values=load).write(tmp_path / 'bag'), rig=RIG)
    expected = zero_of_run(RIG, run)
    in_small_blocks()
    assert zero_of_run(RIG, run) == expected
    assert not expected.reading.near_preload


def write(path, count, number=0):
    """A bag of `count` samples a topic at 10 kHz, the `number`-th minute of them."""
    random = np.random.default_rng(number)
    span = (RIG.probes.min_range, RIG.probes.max_range)
    topics = {name: TOPICS[name].type for name in (LOAD_TOPIC, *PROBE_TOPICS)}
    stamps = 1_700_000_000_000_000_000 + 60_000_000_000 * number + 100_000 * np.arange(count)
    load = RIG.preload + 2e5 * np.clip(1.5 - np.abs(np.linspace(-2.0, 2.0, count)), 0, 1)
    with BagWriter(path, topics, {'test': 'dynamic', 'elevation_deg': '50'}) as writer:
        writer.write([messages_of(TOPICS[LOAD_TOPIC], stamps, load), *(
            messages_of(TOPICS[name], stamps + 1000,
                        1e-3 + 4e-10 * load + random.normal(0.0, 3e-7, count), span)
            for name in PROBE_TOPICS)])
    return path


def peak_of(work):
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.fixture(scope='module')
def long_bags(tmp_path_factory):
    """A bag, one of four times its length, and four that are as long together."""
    folder = tmp_path_factory.mktemp('long')
    return [[write(folder / 'short', 10_000)], [write(folder / 'long', 40_000)],
            [write(folder / f'part_{number}', 10_000, number) for number in range(4)]]


def displacement(bags):
    for bag in bags:
        run = read_run(bag, rig=RIG)
        for _ in measured_stretches(RIG, run, [])[0]:
            pass


def info(bags):
    for bag in bags:
        bag_info(bag)


def fit(bags):
    """What identification and diagnosis hold of their bags."""
    runs = [read_run(bag, rig=RIG) for bag in bags]
    refuse_repeats(runs)
    limit = fit_limit(runs, 2_500)
    runs = [condensed(run, RIG, limit) for run in runs]
    return [prepare(run, RIG, 50.0) for run in runs], [
        build_record(RIG, run, held_out=False) for run in runs]


@pytest.mark.parametrize('work', [displacement, info, fit])
def test_memory_grows_neither_with_the_length_nor_with_the_number_of_bags(long_bags,
                                                                          in_small_blocks, work):
    in_small_blocks(long=2_500, block=2_500)
    work(long_bags[0])  # what is loaded once
    short, *others = (peak_of(lambda bags=bags: work(bags)) for bags in long_bags)
    rows = 30_000
    assert max(others) - short < 16 * rows, 'a sample has eleven numbers, 88 bytes'


def test_the_samples_of_a_fit_are_bounded_and_short_records_are_kept_whole(tmp_path, recording):
    run = read_run(recording.write(tmp_path / 'bag'), rig=RIG)
    count = len(run.stamps)
    half = replace(run, stamps=run.stamps[::2])
    assert fit_limit([run, half], 2 * count) >= count
    limit = fit_limit([run, run, half], 2 * count)
    assert limit == (2 * count - len(half.stamps)) // 2
    assert fit_limit([run] * 10 * count, count) == 1


def test_scratch_files_leave_nothing_and_a_full_disk_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    monkeypatch.setattr(scratch, 'LONG', 10)
    array = scratch.scratch_array((4, 100), np.float64)
    array[2] = 1.0
    scratch.forget(array)
    assert array.sum() == 100.0
    assert os.listdir(tmp_path) == []
    monkeypatch.setenv('TMPDIR', str(tmp_path / 'none'))
    with pytest.raises(BagError, match='let TMPDIR name a folder with more room'):
        scratch.scratch_array((100,), np.float64)


def test_a_long_run_is_fitted_as_averages_of_its_sound_readings(tmp_path, struck):
    run = read_run(struck.write(tmp_path / 'bag'), rig=RIG)
    assert condensed(run, RIG) is run
    limit = len(run.stamps) // 4
    short = condensed(run, RIG, limit)
    size = len(run.stamps) // len(short.stamps)
    sound = run.without_spikes()
    middle = slice(10 * size, 11 * size)
    assert len(short.stamps) <= limit
    assert short.load[10] == pytest.approx(sound.load[middle].mean())
    assert short.gaps[:, 10] == pytest.approx(sound.gaps[:, middle].mean(axis=1))
    assert short.time[10] == pytest.approx(run.time[middle].mean() - run.time[:size].mean())
    assert 'averaged over' in short.notes[-1]
