"""A topic of the rig is one entry of the registry; nothing else has to know of it."""

from pathlib import Path

import numpy as np
import pytest

from saddlering_ros.bags.reader import bag_info, read_raw, read_run
from saddlering_ros.bags.wire import decode_samples, encode_samples
from saddlering_ros.errors import BagError
from saddlering_ros.record.aligner import Aligner
from saddlering_ros.record.batches import Samples
from saddlering_ros.record.topics import ELEVATION, RIG_TOPICS, RigTopic, TOPICS, WRENCH_TYPE

CELL = RigTopic('/rig/second_load_cell', WRENCH_TYPE, 'wrench.force.z', 'N', 'second_load_cell',
                'a second load cell', 'hydraulic_load', required=False)


@pytest.fixture
def stamps(recording) -> np.ndarray:
    return recording.stamps[RIG_TOPICS[0]]


@pytest.fixture
def bag(tmp_path: Path, recording, stamps, monkeypatch) -> Path:
    """A bag that holds the second load cell at every other stamp, half a period late."""
    monkeypatch.setitem(TOPICS, CELL.name, CELL)
    return recording.write(tmp_path / 'bag', others={
        CELL.name: (stamps[::2] + 1_000_000, np.arange(len(stamps[::2])) * 10.0)})


def test_bag_and_reader_know_it(bag: Path, stamps) -> None:
    found = read_raw(bag)[CELL.name]
    assert (found.type, found.frame_id) == (CELL.type, CELL.frame_id)
    assert found.stamps.tolist() == (stamps[::2] + 1_000_000).tolist()
    assert found.values.tolist() == (np.arange(len(stamps[::2])) * 10.0).tolist()


def test_a_run_has_it_on_the_stamps_of_the_load(bag: Path) -> None:
    run = read_run(bag)
    aligned = run.others[CELL.name]
    assert aligned.shape == run.load.shape
    assert np.allclose(aligned[2:8], [7.5, 12.5, 17.5, 22.5, 27.5, 32.5])


def test_live_messages_of_it_are_decoded(monkeypatch) -> None:
    samples = Samples(np.array([1, 2]), np.array([3.0, 4.0]))
    again = decode_samples(encode_samples(samples, CELL), CELL)
    assert (again.stamps.tolist(), again.values.tolist()) == ([1, 2], [3.0, 4.0])


def test_the_aligner_takes_it_as_one_more_channel() -> None:
    stamps = np.arange(0, 10_000_000, 1_000_000)
    rows, = Aligner(channels=5).push(Samples(stamps, np.ones(10)), [
        Samples(stamps, np.full(10, float(channel))) for channel in range(5)])
    assert rows.gaps[:, 3].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_replay_and_recorder_know_it(bag: Path) -> None:
    pytest.importorskip('rclpy')
    from saddlering_ros.live.recorder import streams
    from saddlering_ros.ros.bag_replay import topics_of

    assert streams()[CELL.name].__name__ == 'WrenchStamped'
    assert list(read_raw(bag, topics_of('hydraulic_load'))) == ['/rig/hydraulic_load', CELL.name]


def test_a_bag_without_an_optional_topic_is_whole(tmp_path: Path, recording, stamps) -> None:
    none = {ELEVATION.name: (stamps[:0], np.zeros(0))}  # as `saddlering record` keeps its channel
    for others in ({}, none):
        run = read_run(recording.write(tmp_path / f'bag{len(others)}', others=others))
        assert run.others == {}
        assert run.notes == []


def test_an_inclinometer_that_contradicts_the_stated_elevation_is_an_error(
        tmp_path: Path, recording, stamps) -> None:
    for degrees, name in ((50.2, 'near'), (70.0, 'far')):
        recording.write(tmp_path / name, others={
            ELEVATION.name: (stamps[:3], np.radians([degrees] * 3))})
    assert np.allclose(read_run(tmp_path / 'near').elevation, np.radians(50.0))
    with pytest.raises(BagError, match=r'70\.00 deg: give elevation_deg=DEG'):
        read_run(tmp_path / 'far')
    assert np.allclose(read_run(tmp_path / 'far', elevation=np.radians(70.0)).elevation,
                       np.radians(70.0))
    # info said `usable` of it
    assert '70.00 deg: give elevation_deg=DEG' in bag_info(tmp_path / 'far').problems[0]
    assert bag_info(tmp_path / 'far', elevation=np.radians(70.0)).usable


def test_a_barrel_that_moves_during_a_test_is_noted(tmp_path: Path, recording, stamps) -> None:
    degrees = np.where(np.arange(len(stamps)) < 0.6 * len(stamps), 50.0, 70.0)
    recording.write(tmp_path / 'bag', others={ELEVATION.name: (stamps, np.radians(degrees))})
    for notes in (read_run(tmp_path / 'bag').notes, bag_info(tmp_path / 'bag').notes):
        assert any('the barrel moved from 50.00 to 70.00 deg' in note for note in notes)
