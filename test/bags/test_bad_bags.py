"""Every bag that cannot be used is refused in one line that says what, where and what to do."""

from types import SimpleNamespace
import zlib

from mcap.writer import CompressionType
import numpy as np
import pytest
import yaml

from saddlering_ros.bags.mcap_read import MAGIC, MESSAGE, RECORD_HEAD
from saddlering_ros.bags.reader import bag_info, raw_topic, read_run
from saddlering_ros.cli.main import main
from saddlering_ros.errors import BagError
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, TOPICS
from saddlering_ros.rig import TONNE

PROBE = PROBE_TOPICS[2]
TYPES = {name: topic.type for name, topic in TOPICS.items()}


def refusal(path, **options) -> str:
    """The line with which the bag is refused; `info` must say the same without stopping."""
    with pytest.raises(BagError) as caught:
        read_run(path, **options)
    line = str(caught.value)
    assert '\n' not in line
    assert str(path) in line
    try:
        problems = bag_info(path, **options).problems
    except BagError as problem:
        problems = [str(problem)]
    assert line in problems
    return line


@pytest.mark.parametrize(('name', 'content', 'words'), [
    ('nowhere', None, 'no such bag'), ('notes.txt', 'not a bag', 'is not a bag'),
    ('fake.mcap', 'not a bag, but called one', 'not an MCAP file'), ('', None, 'no .mcap file'),
    ('empty.mcap', '', 'empty')])
def test_what_is_no_bag(tmp_path, name, content, words):
    if content is not None:
        (tmp_path / name).write_text(content)
    assert words in refusal(tmp_path / name)


def test_files_that_were_joined_are_not_read_as_the_first_of_them(tmp_path, recording):
    """`cat part_0.mcap part_1.mcap` gave the first part alone, without a word."""
    file, = recording.write(tmp_path / 'bag').glob('*.mcap')
    end = file.stat().st_size
    (tmp_path / 'joined.mcap').write_bytes(2 * file.read_bytes())
    words = refusal(tmp_path / 'joined.mcap')
    assert f'is two files joined, and the second begins at byte {end}' in words


@pytest.mark.parametrize('has_topics', [True, False])
def test_a_bag_without_messages(tmp_path, recording, raw, has_topics):
    for topic in list(recording.stamps):
        recording = (recording.changed(topic, np.empty(0, np.int64), np.empty(0)) if has_topics
                     else recording.without(topic))
    assert 'holds no messages' in refusal(raw(tmp_path / 'bag.mcap', recording))


def same(series):
    return series


def in_blocks(stamps):
    """Ten readings are stamped when the last one arrives, a microsecond after each other."""
    number = np.arange(stamps.size)
    return stamps[np.minimum(number // 10 * 10 + 9, stamps.size - 1)] + 1000 * (number % 10)


@pytest.mark.parametrize(('topic', 'stamps', 'values', 'words'), [
    (PROBE, lambda stamps: stamps[:4], lambda values: values[:4], 'holds 4 messages'),
    (PROBE, lambda stamps: np.append(0, stamps[1:]), same, 'leap ahead'),
    (PROBE, np.zeros_like, same, 'all stamps are zero'),
    (PROBE, lambda stamps: stamps // 50_000_000 * 50_000_000, same, 'stops at times'),
    (PROBE, lambda stamps: stamps + 60_000_000_000, same, 'overlap'),
    (PROBE, lambda stamps: in_blocks(stamps), same, 'come in blocks, '),
    (LOAD_TOPIC, lambda stamps: in_blocks(stamps), same, 'come in blocks, '),
    (PROBE, same, lambda values: values * 1e3, 'millimetres'),
    (PROBE, same, lambda values: values * 1e6, 'micrometres'),
    (LOAD_TOPIC, same, lambda values: 2.5 * values, 'of the rig file (from -24.5 kN to 368 kN'),
    (LOAD_TOPIC, same, lambda values: values / TONNE, 'tonnes'),
    (LOAD_TOPIC, same, lambda values: values / 1e3, 'kilonewtons'),
    (LOAD_TOPIC, same, np.negative, 'negative')])
def test_stamps_and_readings_that_cannot_be_used(
        tmp_path, recording, raw, topic, stamps, values, words):
    line = refusal(raw(tmp_path / 'bag.mcap', recording.changed(
        topic, stamps(recording.stamps[topic]), values(recording.values[topic]))))
    assert topic in line
    assert words in line


@pytest.mark.parametrize('topic', [LOAD_TOPIC, PROBE])
def test_a_missing_topic(tmp_path, recording, raw, topic):
    line = refusal(raw(tmp_path / 'bag.mcap', recording.without(topic)))
    assert f'no topic {topic}' in line
    assert PROBE_TOPICS[0] in line


def test_a_topic_in_a_namespace_is_told_with_it():
    """A bag of `ros2 bag record` in /rig1 was told to record this topic too."""
    scanned = SimpleNamespace(path='bag', topics={f'/rig1{LOAD_TOPIC}': None}, fault=None,
                              message_count=5)
    with pytest.raises(BagError, match=r'in the namespace /rig1, .* --namespace rig1, or rename'):
        raw_topic(scanned, LOAD_TOPIC)


@pytest.mark.parametrize('topic', [LOAD_TOPIC, PROBE])
def test_a_wrong_message_type(tmp_path, recording, raw, topic):
    types = {**TYPES, topic: 'std_msgs/msg/Float64'}
    line = refusal(raw(tmp_path / 'bag.mcap', recording, types=types))
    assert topic in line
    assert 'std_msgs/msg/Float64' in line
    assert TYPES[topic] in line


def test_another_encoding(tmp_path, recording, raw):
    assert 'json' in refusal(raw(tmp_path / 'bag.mcap', recording, message_encoding='json'))


def test_bytes_that_are_no_message(tmp_path, recording, raw):
    line = refusal(raw(tmp_path / 'bag.mcap', recording, message=lambda *_: b'\0\1\0\0junk'))
    assert 'shorter' in line


def test_info_tells_plain_chunks_from_compressed_ones(tmp_path, recording, raw, capsys):
    for compression, words in ((CompressionType.NONE, 'none'), (CompressionType.ZSTD, 'zstd')):
        bag = raw(tmp_path / f'{words}.mcap', recording, compression=compression)
        main(['info', str(bag)])
        assert f'compression {words}' in ' '.join(capsys.readouterr().out.split())


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('topic', [LOAD_TOPIC, PROBE])
def test_readings_that_are_no_numbers(tmp_path, recording, raw, topic, value):
    values = recording.values[topic].copy()
    values[[100, 101, 500]] = value
    line = refusal(raw(tmp_path / 'bag.mcap', recording.changed(topic, values=values)))
    assert topic in line
    assert '3 of 1000' in line
    assert str(recording.stamps[topic][100]) in line


@pytest.mark.parametrize('topic', [LOAD_TOPIC, PROBE])
@pytest.mark.parametrize('log', ['header', 'received'])
@pytest.mark.parametrize('by', [5_000_000, 20_000_000, 100_000_000, 500_000_000, 30_000_000_000])
def test_stamps_that_go_back(tmp_path, recording, raw, topic, log, by):
    """The clock is set back in mid-run; log times follow it, or go on as the recorder's do."""
    stamps = recording.stamps[topic].copy()
    stamps[600:] -= by
    received = recording.stamps[topic]
    bag = raw(
        tmp_path / 'bag.mcap', recording.changed(topic, stamps),
        order=lambda s: received[s[2]] if s[0] == topic else s[1],
        log_time=lambda t, s, i: s if log == 'header' or t != topic else int(received[i]))
    line = refusal(bag)
    assert topic in line
    assert 'stamps go back' in line


def test_one_stamp_that_goes_back(tmp_path, recording, raw):
    stamps = recording.stamps[PROBE].copy()
    stamps[500] -= 20_000_000
    received = recording.stamps[PROBE]
    bag = raw(tmp_path / 'bag.mcap', recording.changed(PROBE, stamps),
              order=lambda s: received[s[2]] if s[0] == PROBE else s[1])
    assert 'stamps go back by 0.018 s, first at message 500' in refusal(bag)


def test_neighbours_that_swapped_places_are_no_clock_set_back(tmp_path, recording, raw):
    stamps = recording.stamps[PROBE]
    bag = raw(tmp_path / 'bag.mcap', recording,
              order=lambda s: stamps[s[2] ^ 1] if s[0] == PROBE and 100 < s[2] < 200 else s[1])
    np.testing.assert_array_equal(read_run(bag).stamps, recording.stamps[LOAD_TOPIC])


@pytest.mark.parametrize('change', [
    lambda recording, topic: recording.changed(
        topic, np.tile(recording.stamps[topic], 2), np.tile(recording.values[topic], 2)),
    lambda recording, topic: recording.changed(topic, recording.stamps[topic][::-1])],
    ids=['played twice', 'backwards'])
def test_a_recording_out_of_order(tmp_path, recording, raw, change):
    for topic in recording.stamps:
        recording = change(recording, topic)
    bag = raw(tmp_path / 'bag.mcap', recording, order=lambda s: s[2],
              log_time=lambda topic, stamp, index: index)
    assert 'stamps go back' in refusal(bag)


def test_gaps_and_span_in_another_unit(tmp_path, recording, raw, message):
    def in_millimetres(topic, stamp, value):
        if topic == LOAD_TOPIC:
            return message(topic, stamp, value)
        return message(topic, stamp, value * 1e3, span=(0.0, 2.0))

    line = refusal(raw(tmp_path / 'bag.mcap', recording, message=in_millimetres))
    assert 'millimetres' in line


@pytest.mark.parametrize(('key', 'option'), [
    ('elevation_deg', 'give elevation_deg=DEG'), ('test', "give test='static'")])
def test_a_fact_that_is_absent(tmp_path, recording, raw, key, option):
    del recording.facts[key]
    bag = raw(tmp_path / 'bag.mcap', recording)
    assert option in refusal(bag)
    given = {'elevation': 0.5} if key == 'elevation_deg' else {'test': 'dynamic'}
    assert read_run(bag, **given).test == 'dynamic'


@pytest.mark.parametrize('value', ['steep', 'nan', '500', '-45'])
def test_an_elevation_that_is_none(tmp_path, recording, raw, value):
    recording.facts['elevation_deg'] = value
    bag = raw(tmp_path / 'bag.mcap', recording)
    assert value in refusal(bag)
    assert read_run(bag, elevation=0.5).elevation == 0.5


def test_an_unknown_kind_of_test(tmp_path, recording, raw):
    recording.facts['test'] = 'creep'
    assert "'creep'" in refusal(raw(tmp_path / 'bag.mcap', recording))


@pytest.mark.parametrize(('key', 'other', 'given'), [
    ('test', 'static', {'test': 'static'}), ('elevation_deg', '70', {'elevation': 0.9}),
    ('rig', 'another', {}), ('run', 'another', {})])
def test_facts_that_disagree_are_settled_by_the_command_line_alone(
        tmp_path, recording, key, other, given):
    bag = recording.write(tmp_path / 'bag')
    document = yaml.safe_load((bag / 'metadata.yaml').read_text())
    document['rosbag2_bagfile_information']['custom_data'][key] = other
    (bag / 'metadata.yaml').write_text(yaml.safe_dump(document))
    line = refusal(bag)
    assert other in line
    assert 'metadata.yaml' in line
    if given:
        run = read_run(bag, **given)
        assert given.items() <= vars(run).items()


def test_the_same_elevation_in_other_digits_is_no_disagreement(tmp_path, recording):
    bag = recording.write(tmp_path / 'bag')
    text = (bag / 'metadata.yaml').read_text()
    assert "elevation_deg: '50'" in text
    (bag / 'metadata.yaml').write_text(text.replace("'50'", "'50.0'"))
    assert read_run(bag).test == 'dynamic'


@pytest.mark.parametrize(('text', 'words'), [
    ('a: &x 1\nb: *x\n', 'holds an alias'), ('{]', 'is not YAML'),
    ('#' * (1 << 20) + '\n', 'is larger than 1 MB, the limit')], ids=['alias', '{]', 'long'])
def test_metadata_that_cannot_be_read_are_refused_for_that(tmp_path, recording, text, words):
    bag = recording.write(tmp_path / 'bag')
    (bag / 'metadata.yaml').write_text(text)
    line = refusal(bag)
    assert words in line
    assert ('not YAML' in line) == (text == '{]')


def test_a_file_of_the_bag_that_is_not_there(tmp_path, recording):
    bag = recording.write(tmp_path / 'bag')
    (bag / 'bag_0.mcap').rename(tmp_path / 'elsewhere.mcap')
    assert 'bag_0.mcap' in refusal(bag)


def test_a_bag_in_another_storage(tmp_path, recording):
    bag = recording.write(tmp_path / 'bag')
    text = (bag / 'metadata.yaml').read_text()
    (bag / 'metadata.yaml').write_text(
        text.replace('storage_identifier: mcap', 'storage_identifier: sqlite3'))
    assert 'ros2 bag convert' in refusal(bag)
    (tmp_path / 'bag_0.db3').write_bytes(b'SQLite format 3')
    assert 'is recorded with storage sqlite3' in refusal(tmp_path / 'bag_0.db3')


PLACES = 25
"""Damaged places of each kind of file."""


@pytest.mark.parametrize(('compression', 'chunked'), [
    *((compression, True) for compression in CompressionType), (CompressionType.NONE, False)])
@pytest.mark.parametrize('kind', ['flip', 'zero', 'insert'])
def test_damage_anywhere_is_refused_or_harmless(tmp_path, brief, raw, compression, chunked, kind):
    """With checksums, whatever is wrong with the bytes: a line, or the data as they were."""
    whole = raw(tmp_path / 'whole.mcap', brief, compression=compression, chunked=chunked,
                data_crcs=not chunked)
    sound, data = read_run(whole), whole.read_bytes()
    random = np.random.default_rng(zlib.crc32(f'{compression}{chunked}{kind}'.encode()))
    refused = 0
    for place in random.integers(0, len(data), PLACES).tolist():
        damaged = bytearray(data)
        if kind == 'flip':
            damaged[place] ^= 1 << int(random.integers(8))
        elif kind == 'zero':
            damaged[place:place + 64] = bytes(len(damaged[place:place + 64]))
        else:
            damaged[place:place] = bytes(random.integers(0, 256, 5, dtype=np.uint8))
        bag = tmp_path / 'damaged.mcap'
        bag.write_bytes(damaged)
        try:
            run = read_run(bag)
        except BagError as problem:
            line = str(problem)
            assert '\n' not in line
            assert not bag_info(bag).usable
            refused += 1
            continue
        np.testing.assert_array_equal(run.load, sound.load)
        np.testing.assert_array_equal(run.gaps, sound.gaps)
    assert refused > 5


def test_a_message_that_is_no_longer_one_is_missed(tmp_path, brief, raw):
    bag = raw(tmp_path / 'bag.mcap', brief, chunked=False)
    data, place = bytearray(bag.read_bytes()), len(MAGIC)
    while data[place] != MESSAGE:
        place += RECORD_HEAD + int.from_bytes(data[place + 1:place + RECORD_HEAD], 'little')
    data[place] = 0x80  # a record of a kind that a reader skips
    bag.write_bytes(data)
    assert 'messages are readable, a record between them is damaged' in refusal(bag)


def test_info_goes_on_behind_the_first_fault(tmp_path, recording, raw):
    values = recording.values[PROBE].copy()
    values[3] = np.nan
    del recording.facts['test']
    bag = raw(tmp_path / 'bag.mcap',
              recording.changed(PROBE, values=values).without(LOAD_TOPIC), extra=5)
    info = bag_info(bag)
    said = ' '.join(info.problems)
    assert all(word in said for word in (LOAD_TOPIC, 'NaN', "test='static'"))
    assert not info.usable
    assert {topic.topic for topic in info.topics} == {*PROBE_TOPICS, '/chatter'}
