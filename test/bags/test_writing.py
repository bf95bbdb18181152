"""Bags we write are complete, small, sound, and readable by everybody."""

from contextlib import ExitStack
from pathlib import Path
import shutil

from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
import yaml

from saddlering_ros.bags.write import BagWriter, McapWriter, messages_of, write_bag
from saddlering_ros.errors import BagError
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, RIG_TOPICS, TOPICS
from saddlering_ros.rig.description import Probes

FACTS = {'test': 'dynamic', 'elevation_deg': '50', 'rig': 'a rig', 'run': 'a run'}


@pytest.fixture
def bag(tmp_path, recording) -> Path:
    return recording.write(tmp_path / 'bag')


def information(bag: Path) -> dict:
    document = yaml.safe_load((bag / 'metadata.yaml').read_text())
    return document['rosbag2_bagfile_information']


def test_the_mcap_package_reads_it_with_all_checksums(bag, recording):
    with (bag / 'bag_0.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        count = sum(1 for _ in reader.iter_messages())
    assert count == summary.statistics.message_count == 5000
    assert {channel.topic for channel in summary.channels.values()} == set(RIG_TOPICS)
    assert summary.chunk_indexes[0].compression == 'zstd'
    assert all('offered_qos_profiles' in channel.metadata
               for channel in summary.channels.values())


def test_rosbags_reads_the_messages_we_meant(bag, recording):
    found = {topic: ([], []) for topic in RIG_TOPICS}
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            stamps, values = found[connection.topic]
            stamps.append(message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec)
            if connection.topic == LOAD_TOPIC:
                values.append(message.wrench.force.x)
                assert message.header.frame_id == 'hydraulic_cylinder'
                assert message.wrench.torque.z == message.wrench.force.y == 0.0
            else:
                values.append(message.range)
                assert message.max_range == pytest.approx(2e-3)
                assert message.header.frame_id == connection.topic.rpartition('/')[2]
    for topic, (stamps, values) in found.items():
        np.testing.assert_array_equal(stamps, recording.stamps[topic])
        np.testing.assert_array_equal(values, recording.values[topic])


def test_metadata_yaml_describes_the_bag_and_the_facts_stand_in_both_places(bag):
    found = information(bag)
    assert found['message_count'] == 5000
    assert found['relative_file_paths'] == ['bag_0.mcap']
    topics = {entry['topic_metadata']['name']: entry['topic_metadata']
              for entry in found['topics_with_message_count']}
    assert set(topics) == set(RIG_TOPICS)
    assert all(topic['offered_qos_profiles'] for topic in topics.values())
    assert all(topic['type_description_hash'].startswith('RIHS01_') for topic in topics.values())
    assert found['custom_data'] == FACTS
    with (bag / 'bag_0.mcap').open('rb') as file:
        records = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    assert records['saddlering.test'] == FACTS


def test_ten_seconds_at_one_kilohertz_fit_in_two_megabytes(tmp_path):
    random = np.random.default_rng(0)
    count = 10_000
    stamps = 1_700_000_000_000_000_000 + np.arange(count) * 1_000_000
    jittered = [stamps + random.integers(0, 50_000, count) for _ in range(5)]
    load = 1e5 + 100.0 * random.normal(size=count)
    quantum = 2e-3 / 2 ** 16
    gaps = [np.round((1e-3 + 3e-7 * random.normal(size=count)) / quantum) * quantum
            for _ in range(4)]
    probes = Probes(1.3, 0.0, (1.0, 1.0, 1.0, 1.0), 0.0, 2e-3)
    bag = write_bag(
        tmp_path / 'bag', TestMetadata('dynamic', 50.0), jittered[0], load, jittered[1:], gaps,
        probes)
    assert sum(file.stat().st_size for file in bag.iterdir()) <= 2_000_000


def test_equal_input_gives_equal_bytes(tmp_path, recording):
    first, second = (recording.write(tmp_path / place / 'bag') for place in 'ab')
    for file in first.iterdir():
        assert file.read_bytes() == (second / file.name).read_bytes()


def test_an_existing_bag_is_replaced_only_when_asked_and_anything_else_never(
        tmp_path, recording, bag):
    with pytest.raises(BagError, match='exists already'):
        recording.write(bag)
    recording.write(bag, overwrite=True)
    assert {file.name for file in tmp_path.iterdir()} == {'bag'}
    (tmp_path / 'work').mkdir()
    (tmp_path / 'work' / 'thesis.txt').write_text('ten years')
    with pytest.raises(BagError, match='is not a bag'):
        recording.write(tmp_path / 'work', overwrite=True)
    assert (tmp_path / 'work' / 'thesis.txt').read_text() == 'ten years'


@pytest.mark.parametrize('interruption', [KeyboardInterrupt, OSError])
def test_an_interruption_leaves_nothing_half_written(
        tmp_path, recording, monkeypatch, interruption):
    written, write_chunk = 0, McapWriter._write_chunk

    def fail(*arguments):
        nonlocal written
        written += 1
        if written > 3:
            raise interruption(28, 'No space left on device')
        write_chunk(*arguments)

    monkeypatch.setattr(McapWriter, '_write_chunk', fail)
    with pytest.raises((BagError, KeyboardInterrupt)):
        recording.write(tmp_path / 'bag', chunk_size=10_000)
    assert written == 4
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('recorded', [False, True])
@pytest.mark.parametrize('overwrite', [False, True])
def test_what_appears_at_the_place_of_a_bag_meanwhile_is_not_replaced(
        tmp_path, recorded, overwrite):
    topic, bag = TOPICS[LOAD_TOPIC], tmp_path / 'bag'
    (tmp_path / 'bag.2').mkdir()
    writing = ExitStack()
    writer = writing.enter_context(BagWriter(
        bag, {topic.name: topic.type}, FACTS, recorded=recorded, overwrite=overwrite))
    writer.write([messages_of(topic, [1], [2.0])])
    bag.mkdir()
    (bag / 'notes.txt').write_text('precious')
    with pytest.raises(BagError, match=r'not replaced: this bag is at .*bag\.3$'):
        writing.close()
    assert {file.name for file in tmp_path.iterdir()} == {'bag', 'bag.2', 'bag.3'}
    assert (bag / 'notes.txt').read_text() == 'precious'
    assert information(tmp_path / 'bag.3')['message_count'] == 1


def test_a_folder_removed_under_a_recording_ends_it_at_once_and_nothing_is_called_readable(
        tmp_path):
    topic, folder, message = TOPICS[LOAD_TOPIC], tmp_path / 'out', bytes(200)
    with ExitStack() as writing:
        writer = writing.enter_context(BagWriter(
            folder / 'bag', {topic.name: topic.type}, FACTS, recorded=True, chunk_size=200))
        writer.write_message(topic.name, 1, message)
        shutil.rmtree(folder)
        with pytest.raises(BagError) as refused:
            writer.write_message(topic.name, 2, message)
    assert str(refused.value) == (f'{folder}/bag: cannot be written (it was removed meanwhile): '
                                  'choose another place')


@pytest.mark.parametrize('second', [-1, 2 ** 31])
def test_a_time_that_no_header_holds_is_refused(second):
    with pytest.raises(BagError, match='from 1970 to 2038'):
        messages_of(TOPICS[LOAD_TOPIC], [0, second * 10 ** 9], [1.0, 2.0])


def test_arrays_that_do_not_fit_are_refused(tmp_path, recording):
    with pytest.raises(BagError, match=PROBE_TOPICS[0]):
        recording.changed(PROBE_TOPICS[0], recording.stamps[PROBE_TOPICS[0]][1:]).write(
            tmp_path / 'bag')


@pytest.mark.parametrize('facts', [('creep', 50.0), ('static', 120.0), ('static', float('nan'))])
def test_facts_no_test_has_are_refused(facts):
    with pytest.raises(BagError):
        TestMetadata(*facts)
