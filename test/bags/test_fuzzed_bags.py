"""Whatever the bytes or the readings: a run, or one line; never a crash, a hang or much memory."""

from dataclasses import replace
import io
from pathlib import Path
import struct
import tracemalloc
from types import SimpleNamespace

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer
import numpy as np
import pytest
from raw_messages import cdr
import yaml
import zstandard

from saddlering_ros.bags.folder import INFORMATION
from saddlering_ros.bags.reader import bag_info, read_run
from saddlering_ros.doubts import Finding
from saddlering_ros.errors import BagError
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, TOPICS
from saddlering_ros.rig import default_rig, TONNE

QUICK = settings(
    max_examples=40, deadline=None, derandomize=True, database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
MEGABYTE = 1 << 20


def outcome(path: Path) -> str:
    """'' if the bag is read, else the line; nothing else may happen."""
    try:
        run = read_run(path, test='static', elevation=0.9, rig=default_rig())
        assert np.isfinite(run.load).all()
        assert (np.diff(run.stamps) > 0).all()
        assert run.gaps.shape == (4, len(run.load))
        plateaus(run)
    except BagError as problem:
        line = str(problem)
        assert '\n' not in line
        assert len(line) < 1000
        return line
    return ''


# --- bytes ---

EDITS = st.lists(st.tuples(
    st.sampled_from(['flip', 'set', 'huge', 'delete', 'repeat', 'zero']),
    st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=6)


def edited(data: bytes, edits: list[tuple[str, float, int]]) -> bytes:
    changed = bytearray(data)
    for kind, share, number in edits:
        place = int(share * len(changed))
        if kind == 'flip':
            changed[place:place + 1] = bytes([changed[place] ^ (1 << number % 8)])
        elif kind == 'set':
            changed[place] = number
        elif kind == 'huge':
            changed[place:place + 8] = (number << 55).to_bytes(8, 'little')
        elif kind == 'delete':
            del changed[place:place + number]
        elif kind == 'repeat':
            changed[place:place] = changed[place:place + number]
        else:
            changed[place:place + number] = bytes(number)
        changed = changed or bytearray(b'\0')
    return bytes(changed)


@pytest.fixture(params=['loose', 'chunks', 'indexed'])
def open_bytes(request, tmp_path, short, raw) -> bytes:
    """A bag without any checksum or compression, so that changes reach the innermost parts."""
    options = {'loose': {'chunked': False}, 'chunks': {'index_types': IndexType.NONE},
               'indexed': {}}[request.param]
    return raw(tmp_path / 'whole.mcap', short, compression=CompressionType.NONE, crcs=False,
               chunk_size=4096, **options).read_bytes()


@QUICK
@given(edits=EDITS)
def test_changed_bytes_end_in_a_run_or_a_line(tmp_path, open_bytes, edits):
    bag = tmp_path / 'bag.mcap'
    bag.write_bytes(edited(open_bytes, edits))
    line = outcome(bag)
    info = bag_info(bag, test='static', elevation=0.9)
    assert info.usable == (not line)


@QUICK
@given(text=st.text(alphabet='{}[]&*!:-,"\'#|>\n abc019~<.', max_size=60))
def test_metadata_of_any_text_end_in_a_run_or_a_line(tmp_path, short, text):
    bag = tmp_path / 'bag'
    if not bag.exists():
        short.write(bag)
    (bag / 'metadata.yaml').write_text(f'{INFORMATION}:\n  custom_data: {text}\n')
    outcome(bag)


# --- readings ---

CHANNELS = st.sampled_from([LOAD_TOPIC, *PROBE_TOPICS])
FAULTS = st.tuples(
    st.sampled_from(['nan', 'inf', 'scale', 'negate', 'stuck', 'clip', 'zeros', 'gap', 'repeat',
                     'reverse', 'back', 'jitter', 'few']),
    CHANNELS, st.floats(0.0, 1.0), st.sampled_from([1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e30, 0.0]))


def faulty(recording, fault):
    kind, topic, share, factor = fault
    stamps, values = recording.stamps[topic].copy(), recording.values[topic].copy()
    place = int(share * (len(values) - 1))
    if kind in ('nan', 'inf'):
        values[place:place + 5] = np.nan if kind == 'nan' else np.inf
    elif kind == 'scale':
        values = np.clip(values * factor, -1e37, 1e37)
    elif kind == 'negate':
        values = -values
    elif kind == 'stuck':
        values[place:] = values[place]
    elif kind == 'clip':
        values = np.minimum(values, values[place])
    elif kind == 'zeros':
        stamps[place:] = 0
    elif kind == 'gap':
        stamps[place:] += int(1e9 * factor) if factor < 1e7 else 1
    elif kind == 'repeat':
        stamps, values = np.repeat(stamps, 2), np.repeat(values, 2)
    elif kind == 'reverse':
        stamps = stamps[::-1].copy()
    elif kind == 'back':
        stamps[place:] -= 400_000_000
    elif kind == 'jitter':
        stamps += np.random.default_rng(place).integers(-10 ** 7, 10 ** 7, len(stamps))
    else:
        stamps, values = stamps[:place], values[:place]
    # A message before 1970 cannot be written.
    return recording.changed(topic, np.maximum(stamps, 0), values)


@QUICK
@given(faults=st.lists(FAULTS, min_size=1, max_size=3))
def test_any_fault_of_stamps_and_readings_ends_in_a_run_or_a_line(tmp_path, short, raw, faults):
    recording = short
    for fault in faults:
        recording = faulty(recording, fault)
    outcome(raw(tmp_path / 'bag.mcap', recording, compression=CompressionType.NONE,
                order=lambda sample: sample[2]))


# --- sizes ---

def bomb_of_chunks(path: Path, chunks: int) -> Path:
    """Ever the same chunk of ever the same message: 4 MB each, in a few hundred bytes."""
    file = io.BytesIO()
    writer = Writer(file, chunk_size=8 * MEGABYTE, compression=CompressionType.ZSTD,
                    index_types=IndexType.NONE, use_statistics=False, repeat_channels=False,
                    repeat_schemas=False)
    writer.start()
    schema = writer.register_schema(TOPICS[LOAD_TOPIC].type, 'ros2msg', b'')
    channel = writer.register_channel(LOAD_TOPIC, 'cdr', schema)
    start = file.tell()
    data = cdr(LOAD_TOPIC, 10 ** 18, 1e5)
    for _ in range(4 * MEGABYTE // (len(data) + 31)):
        writer.add_message(channel, 0, data, 0)
    writer.finish()
    whole = file.getvalue()
    opcode, length = struct.unpack_from('<BQ', whole, start)
    assert opcode == 6
    stop = start + 9 + length
    path.write_bytes(whole[:start] + chunks * whole[start:stop] + whole[stop:])
    return path


def bomb_of_a_chunk(path: Path, record: bytes, size: int) -> Path:
    """One chunk of nothing but one record."""
    packed = zstandard.ZstdCompressor().compress(record * (size // len(record)))
    size -= size % len(record)
    head = (b'\x89MCAP0\r\n' + b'\x01' + (8).to_bytes(8, 'little') + bytes(8))
    body = (bytes(16) + size.to_bytes(8, 'little') + bytes(4) + (4).to_bytes(4, 'little') + b'zstd'
            + len(packed).to_bytes(8, 'little') + packed)
    path.write_bytes(head + b'\x06' + len(body).to_bytes(8, 'little') + body)
    return path


def bomb_of_a_file(path: Path, size: int) -> Path:
    buffer = io.BytesIO()
    with zstandard.ZstdCompressor().stream_writer(buffer, closefd=False) as writer:
        for _ in range(size // MEGABYTE):
            writer.write(bytes(MEGABYTE))
    path.write_bytes(buffer.getvalue())
    return path


def bomb_of_metadata(path: Path) -> Path:
    """Nine lines that stand for three thousand million values."""
    path.mkdir()
    (path / 'bag_0.mcap').touch()
    lines = ['a: &a0 [x, x, x, x, x, x, x, x, x, x]']
    lines += [f'b{n}: &a{n} [{", ".join([f"*a{n - 1}"] * 10)}]' for n in range(1, 9)]
    lines += [f'{INFORMATION}:', '  custom_data: {rig: *a8}']
    (path / 'metadata.yaml').write_text('\n'.join(lines))
    return path


@pytest.mark.parametrize(('make', 'words', 'most'), [
    (lambda folder: bomb_of_chunks(folder / 'b.mcap', 12), 'no recorder writes such a file', 40),
    (lambda folder: bomb_of_a_chunk(folder / 'b.mcap', bytes(9), 200 * MEGABYTE), 'damaged', 450),
    (lambda folder: bomb_of_a_chunk(folder / 'b.mcap', b'\x7f' + bytes(8), 90 * MEGABYTE),
     'damaged', 200),
    (lambda folder: bomb_of_a_chunk(folder / 'b.mcap', bytes(9), 300 * MEGABYTE), 'damaged', 5),
    (lambda folder: bomb_of_a_file(folder / 'b.mcap.zstd', 300 * MEGABYTE), 'no recorder', 40),
    (lambda folder: bomb_of_metadata(folder / 'b'), 'holds an alias', 5)])
def test_what_unpacks_without_end_is_refused_in_bounded_memory(tmp_path, make, words, most):
    path = make(tmp_path)
    tracemalloc.start()
    try:
        line = outcome(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert words in line
    assert peak < most * MEGABYTE


def test_metadata_cannot_name_files_outside_the_bag(tmp_path, recording):
    secret = recording.write(tmp_path / 'secret')
    bag = recording.write(tmp_path / 'bag')
    document = yaml.safe_load((bag / 'metadata.yaml').read_text())
    for name in ('../secret/secret_0.mcap', str(secret / 'secret_0.mcap')):
        document[INFORMATION]['relative_file_paths'] = [name]
        (bag / 'metadata.yaml').write_text(yaml.safe_dump(document))
        with pytest.raises(BagError, match='is missing'):
            read_run(bag)


# --- what looks wrong ---

def test_a_definition_with_other_fields_is_refused(tmp_path, recording, raw, monkeypatch):
    other = b'std_msgs/Header header\nuint8 X=1\nuint8 radiation_type\nfloat64 range\n'
    register = Writer.register_schema
    monkeypatch.setattr(Writer, 'register_schema', lambda self, name, encoding, data: register(
        self, name, encoding, other if name.endswith('Range') else data))
    line = outcome(raw(tmp_path / 'bag.mcap', recording))
    assert "has 'float64 range' where 'float32 field_of_view' should be" in line


@pytest.fixture
def sound():
    """Readings of a ring as it should be at 50 degrees: load [N] (N,), gaps [m] (4, N)."""
    random = np.random.default_rng(0)
    load = TONNE * (0.5 + 24.5 * np.clip(1.3 - np.abs(np.linspace(-1.5, 1.5, 2000)), 0.0, 1.0))
    motion = np.array([[3.8], [7.0], [-3.8], [-9.2]]) * 1e-6 * (load / TONNE) ** 0.9
    return load, 1e-3 - motion * -1.0 + random.normal(0.0, 3e-7, (4, 2000))


def said(load, gaps, rig=None) -> str:
    from saddlering_ros.doubts.wiring import wiring_findings
    return ' '.join(map(str, wiring_findings(rig or default_rig(), np.radians(50.0), load, gaps)))


def test_a_sound_ring_and_faults_of_a_few_percent_are_not_suspected(sound):
    load, gaps = sound
    polarity = np.asarray(default_rig().probes.polarity)[:, None]
    gaps = 1e-3 + polarity * (gaps - 1e-3)
    assert said(load, gaps) == ''
    gaps[0] += 0.08 * (gaps[0] - gaps[0, 0])
    assert said(load, gaps) == ''
    assert said(load[:5], gaps[:, :5]) == ''


@pytest.mark.parametrize('probe', range(4))
def test_a_wrong_polarity_is_named_with_the_slope(sound, probe):
    load, gaps = sound
    gaps[probe] = 2e-3 - gaps[probe]
    assert f'wrong polarity of probe {probe + 1} ' in said(load, gaps)
    assert 'µm per kN' in said(load, gaps, replace(default_rig(), force_unit='kN'))


@pytest.mark.parametrize(('one', 'other'), [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
def test_swapped_channels_are_named(sound, one, other):
    load, gaps = sound
    gaps[[one, other]] = gaps[[other, one]]
    assert 'swapped' in said(load, gaps)


def test_what_looks_swapped_comes_before_any_test(sound):
    from saddlering_ros.doubts.wiring import wiring_first
    load, gaps = sound
    swapped = SimpleNamespace(
        name='static_50', elevation=np.radians(50.0), load=load, gaps=gaps[[0, 3, 2, 1]],
        notes=[])
    assert wiring_first(default_rig(), [swapped]) == (
        'See to the wiring first: in static_50 probes 2 and 4 look swapped, or both of the wrong '
        'polarity.')
    swapped.gaps = gaps
    assert not wiring_first(default_rig(), [swapped])
    swapped.notes = [Finding('the load begins at 1101 N', units='lbf'),
                     'the load is held, which looks like a static test: give --test static']
    assert wiring_first(default_rig(), [swapped]) == (
        'See to the units first: in static_50 readings look like lbf.')


def test_a_stuck_a_clipped_and_a_dead_probe_are_named(sound):
    load, gaps = sound
    for change, words in [
            (lambda g: np.where(np.arange(2000) > 600, g[600], g), 'stays at'),
            (lambda g: np.minimum(g, np.quantile(g, 0.7)), 'at an end of its range'),
            (lambda g: 1e-3 + 1e-7 * np.random.default_rng(1).normal(size=2000),
             'does not follow the load')]:
        changed = gaps.copy()
        changed[1] = change(gaps[1])
        (line,) = said(load, changed).splitlines()
        assert line.startswith('probe 2 ')
        assert words in line


def test_info_and_the_commands_that_compute_say_it(tmp_path, recording, sound, capsys):
    from saddlering_ros.cli.main import main
    load, gaps = sound
    stamps = recording.stamps[LOAD_TOPIC][0] + 2_000_000 * np.arange(len(load))
    gaps[[1, 3]] = gaps[[3, 1]]
    swapped = recording.changed(LOAD_TOPIC, stamps, load)
    for topic, values in zip(PROBE_TOPICS, gaps, strict=True):
        swapped = swapped.changed(topic, stamps, values)
    bag = str(swapped.write(tmp_path / 'bag'))
    words = 'probes 2 and 4 look swapped'
    assert main(['info', bag]) == 0
    assert words in ' '.join(capsys.readouterr().out.split())
    assert main(['displacement', bag, '--json', '-']) == 0
    assert words in capsys.readouterr().out
