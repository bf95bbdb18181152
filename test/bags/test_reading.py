"""Bags of other recorders read the same as our own."""

from itertools import pairwise
import shutil
import tracemalloc

from mcap.writer import CompressionType, IndexType
import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
import yaml
import zstandard

from saddlering_ros.bags.folder import find_metadata
from saddlering_ros.bags.reader import read_raw, read_run
from saddlering_ros.record.record import Record
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS

PROBE = PROBE_TOPICS[1]


def assert_same(run: Record, expected: Record) -> None:
    """The same arrays to the last bit, and the same facts."""
    np.testing.assert_array_equal(run.stamps, expected.stamps)
    np.testing.assert_array_equal(run.time, expected.time)
    np.testing.assert_array_equal(run.load, expected.load)
    np.testing.assert_array_equal(run.gaps, expected.gaps)
    facts = ('test', 'elevation', 'rig', 'run')
    assert [getattr(run, name) for name in facts] == [getattr(expected, name) for name in facts]


@pytest.fixture
def recording(short):
    """Six tenths of a second: how a bag is stored shows in that."""
    return short


@pytest.fixture
def expected(tmp_path, recording) -> Record:
    return read_run(recording.write(tmp_path / 'expected'))


def test_what_was_written_is_read(expected, recording):
    np.testing.assert_array_equal(expected.stamps, recording.stamps[LOAD_TOPIC])
    np.testing.assert_array_equal(expected.load, recording.values[LOAD_TOPIC])
    assert expected.time[0] == 0.0
    assert expected.test == 'dynamic'
    assert expected.elevation == pytest.approx(np.radians(50.0))
    assert expected.name == 'expected'
    assert expected.notes == []


def test_raw_topics_are_what_was_recorded(tmp_path, recording):
    record = read_raw(recording.write(tmp_path / 'bag'))
    for topic in (LOAD_TOPIC, *PROBE_TOPICS):
        np.testing.assert_array_equal(record[topic].stamps, recording.stamps[topic])
        np.testing.assert_array_equal(record[topic].values, recording.values[topic])
    assert record[PROBE].frame_id == 'eddy_current_2'
    assert record[PROBE].max_range == pytest.approx(2e-3)
    assert set(read_raw(tmp_path / 'bag', [PROBE])) == {PROBE}


@pytest.mark.parametrize('options', [
    {'compression': CompressionType.NONE},
    {'compression': CompressionType.LZ4},
    {'compression': CompressionType.ZSTD},
    {'chunked': False},
    {'index_types': IndexType.NONE},
    {'index_types': IndexType.CHUNK, 'compression': CompressionType.LZ4},
    {'crcs': False},
    {'data_crcs': True},
    {'chunked': False, 'data_crcs': True},
    {'chunk_size': 10_000_000},
    {'chunk_size': 200},
    {'encoding': 'ros2idl'},
    {'extra': 3},
    {'extra': 1, 'chunked': False},
], ids=str)
def test_storage_makes_no_difference(tmp_path, recording, raw, expected, options):
    assert_same(read_run(raw(tmp_path / 'bare.mcap', recording, **options)), expected)


@pytest.mark.parametrize('options', [
    {'big': True}, {'version': 2}, {'big': True, 'version': 2}, {'frame': ''},
    {'frame': 'a_frame_id_of_another_length_altogether'},
], ids=str)
def test_serialisation_makes_no_difference(tmp_path, recording, raw, message, expected, options):
    bag = raw(tmp_path / 'bare.mcap', recording, message=lambda *m: message(*m, **options))
    assert_same(read_run(bag), expected)


def test_messages_of_one_topic_may_differ_in_form(tmp_path, recording, raw, message, expected):
    def mixed(topic, stamp, value):
        return message(topic, stamp, value, big=stamp % 3 == 0, version=1 + stamp // 1000 % 2,
                       frame='x' * (stamp // 1000 % 5))

    assert_same(read_run(raw(tmp_path / 'bare.mcap', recording, message=mixed)), expected)


@pytest.mark.parametrize('log_time', [
    lambda topic, stamp, index: stamp + 5_000_000_000_000,
    lambda topic, stamp, index: 0,
    lambda topic, stamp, index: index,
    lambda topic, stamp, index: stamp + stamp * 7919 // 1000 % 100_000_000,
    lambda topic, stamp, index: stamp + (3_000_000_000 if topic == PROBE else 0),
], ids=['later', 'none', 'count', 'jitter', 'one topic late'])
@pytest.mark.parametrize('in_log_order', [False, True])
def test_log_time_does_not_count(tmp_path, recording, raw, expected, log_time, in_log_order):
    order = (lambda sample: (log_time(*sample), sample[1])) if in_log_order else None
    bag = raw(tmp_path / 'bare.mcap', recording, log_time=log_time, order=order)
    assert_same(read_run(bag), expected)


@pytest.mark.parametrize('order', [
    lambda sample: (sample[0], sample[1]),
    lambda sample: (-(sample[2] // 100), sample[1]),
    lambda sample: (sample[2] // 7, -sample[1]),
], ids=['topic after topic', 'blocks backwards', 'short blocks reversed'])
def test_order_in_the_file_does_not_count_and_is_noted(tmp_path, recording, raw, expected, order):
    run = read_run(raw(tmp_path / 'bare.mcap', recording, order=order))
    assert_same(run, expected)
    is_kept = order((LOAD_TOPIC, 1, 0)) == (LOAD_TOPIC, 1)
    assert any('are sorted' in note for note in run.notes) != is_kept


def test_messages_recorded_twice_are_left_out(tmp_path, recording, raw, expected):
    twice = recording
    for topic in (LOAD_TOPIC, PROBE):
        twice = twice.changed(
            topic, np.repeat(recording.stamps[topic], 2), np.repeat(recording.values[topic], 2))
    run = read_run(raw(tmp_path / 'bare.mcap', twice))
    assert_same(run, expected)
    assert sum('repeat the stamp of another' in note for note in run.notes) == 2


def split(recording, parts: int):
    edges = np.linspace(0, len(recording.stamps[LOAD_TOPIC]), parts + 1).astype(int)
    for first, last in pairwise(edges):
        part = recording
        for topic in recording.stamps:
            part = part.changed(topic, recording.stamps[topic][first:last],
                                recording.values[topic][first:last])
        yield part


def metadata(names, count, **more) -> str:
    return yaml.safe_dump({'rosbag2_bagfile_information': {
        'version': 9, 'storage_identifier': 'mcap', 'relative_file_paths': names,
        'message_count': count, **more}})


@pytest.mark.parametrize('name', [
    'bag_{}.mcap', '{}_bag_2026_05_22-10_59_07.mcap'], ids=['jazzy', 'lyrical'])
@pytest.mark.parametrize('with_metadata', [True, False])
def test_a_bag_of_several_files_is_one_test(
        tmp_path, recording, raw, expected, with_metadata, name):
    folder = tmp_path / 'bag'
    folder.mkdir()
    names = [name.format(number) for number in range(11)]
    for name, part in zip(names, split(recording, 11), strict=True):
        raw(folder / name, part, facts=name == names[-1])
    if with_metadata:
        count = sum(len(stamps) for stamps in recording.stamps.values())
        (folder / 'metadata.yaml').write_text(metadata(names, count))
    assert_same(read_run(folder), expected)
    assert read_run(folder).notes == []


def test_the_last_message_of_a_file_may_be_repeated_in_the_next(
        tmp_path, recording, raw, expected):
    """Lyrical does so with latched topics, at the log time of the split."""
    for number, part in enumerate(split(recording, 3)):
        for topic in (LOAD_TOPIC, PROBE) if number else ():
            row = int(recording.stamps[topic].searchsorted(part.stamps[topic][0])) - 1
            part = part.changed(topic, np.append(recording.stamps[topic][row], part.stamps[topic]),
                                np.append(recording.values[topic][row], part.values[topic]))
        raw(tmp_path / f'{number}_bag_2026_05_22-10_59_07.mcap', part)
    run = read_run(tmp_path)
    assert_same(run, expected)
    assert sum('2 messages repeat the stamp of another' in note for note in run.notes) == 2


@pytest.mark.parametrize('name', ['metadata.yaml', 'bag_0.mcap'])
def test_a_file_of_a_bag_reads_as_the_bag(tmp_path, recording, expected, name):
    assert_same(read_run(recording.write(tmp_path / 'bag') / name), expected)


def restate(bag, **statements) -> None:
    """Change statements of metadata.yaml."""
    document = yaml.safe_load((bag / 'metadata.yaml').read_text())
    document['rosbag2_bagfile_information'].update(statements)
    (bag / 'metadata.yaml').write_text(yaml.safe_dump(document))


def test_a_renamed_directory_is_still_found(tmp_path, recording, expected):
    bag = recording.write(tmp_path / 'bag')
    restate(bag, relative_file_paths=['old_name/bag_0.mcap'])
    assert_same(read_run(bag), expected)


def test_files_compressed_as_a_whole_are_read(tmp_path, recording, raw, expected):
    folder = tmp_path / 'bag'
    folder.mkdir()
    plain = raw(tmp_path / 'bag_0.mcap', recording, compression=CompressionType.NONE)
    packed = zstandard.compress(plain.read_bytes())
    (folder / 'bag_0.mcap.zstd').write_bytes(packed)
    (folder / 'metadata.yaml').write_text(metadata(
        ['bag_0.mcap.zstd'], 5000, compression_mode='FILE', compression_format='zstd'))
    assert_same(read_run(folder), expected)
    assert_same(read_run(folder / 'bag_0.mcap.zstd'), expected)


@pytest.mark.parametrize('mode', [
    CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.STORAGE])
def test_bags_by_rosbags_are_read(tmp_path, recording, message, expected, mode):
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    for key, value in recording.facts.items():
        writer.set_custom_data(key, value)
    with writer:
        for topic, stamps in recording.stamps.items():
            kind = 'geometry_msgs/msg/WrenchStamped' if topic == LOAD_TOPIC else \
                'sensor_msgs/msg/Range'
            connection = writer.add_connection(topic, kind, typestore=store)
            for stamp, value in zip(stamps, recording.values[topic], strict=True):
                writer.write(connection, int(stamp), message(topic, int(stamp), float(value)))
    assert_same(read_run(tmp_path / 'bag'), expected)


def test_facts_in_either_place_are_enough(tmp_path, recording, raw, expected):
    only_record = raw(tmp_path / 'bare.mcap', recording)
    assert_same(read_run(only_record), expected)
    folder = tmp_path / 'bag'
    folder.mkdir()
    raw(folder / 'bag_0.mcap', recording, facts=False)
    (folder / 'metadata.yaml').write_text(
        metadata(['bag_0.mcap'], 5000, custom_data=recording.facts))
    assert_same(read_run(folder), expected)
    reindexed = recording.write(tmp_path / 'reindexed')
    (reindexed / 'metadata.yaml').write_text(metadata(['reindexed_0.mcap'], 5000))
    assert read_run(reindexed).test == 'dynamic', 'a tool has dropped custom_data'


def test_what_the_recorder_wrote_itself_gives_only_what_nothing_else_states():
    found = find_metadata({'test': 'static'}, {'elevation_deg': '50'},
                          {'test': 'dynamic', 'elevation_deg': '70', 'run': 'third'})
    assert (found.test, found.elevation_deg, found.run) == ('static', 50.0, 'third')


def test_the_command_line_wins_over_the_bag(tmp_path, recording):
    run = read_run(recording.write(tmp_path / 'bag'), test='static', elevation=1.2)
    assert (run.test, run.elevation) == ('static', 1.2)


def test_a_count_that_metadata_got_wrong_is_noted(tmp_path, recording, expected):
    bag = recording.write(tmp_path / 'bag')
    restate(bag, message_count=4711)
    run = read_run(bag)
    assert_same(run, expected)
    assert ['4711' in note for note in run.notes] == [True]


def test_a_file_that_metadata_does_not_list_is_noted(tmp_path, recording, expected):
    bag = recording.write(tmp_path / 'bag')
    shutil.copy(bag / 'bag_0.mcap', bag / 'bag_1.mcap')
    shutil.copy(bag / 'bag_0.mcap', bag / 'bag_0.mcap.zstd')  # as a player leaves it
    run = read_run(bag)
    assert_same(run, expected)
    assert [note for note in run.notes if 'metadata.yaml' in note] == [
        'not read, because metadata.yaml does not list them: bag_1.mcap; "ros2 bag reindex" lists '
        'every file, if they belong to this test']


def test_memory_follows_the_arrays_asked_for_not_the_bag(tmp_path, recording, raw):
    """Thirty megabytes of somebody else's topic pass by without being kept."""
    bag = raw(tmp_path / 'bag.mcap', recording, extra=50, extra_size=300_000)
    tracemalloc.start()
    read_run(bag)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4_000_000


def test_reading_leaves_the_bag_as_it_was(tmp_path, recording):
    bag = recording.write(tmp_path / 'bag')
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    copy = shutil.copytree(bag, tmp_path / 'copy')
    copy.chmod(0o555)
    read_run(copy)
    copy.chmod(0o755)
    assert {file.name: file.read_bytes() for file in copy.iterdir()} == before


def test_reading_reports_how_much_of_the_bag_it_has_read(tmp_path, recording):
    shares = []
    read_raw(recording.write(tmp_path / 'bag'), on_progress=shares.append)
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < 0.9 < shares[-1] <= 1.0
