"""A bag that ends too early gives what is readable of it, and says how much that is."""

import re

from mcap.reader import make_reader
import numpy as np
import pytest

from saddlering_ros.bags.reader import bag_info, read_run
from saddlering_ros.cli.main import main
from saddlering_ros.errors import BagError
from saddlering_ros.record.topics import LOAD_TOPIC

READABLE = re.compile(
    r'cut off at byte \d+; (\d+) messages over ([\d.]+) s before that are readable')


def chunk_ends(data: bytes) -> list[int]:
    """Where each chunk of an MCAP file ends, its message index included or not."""
    from io import BytesIO
    summary = make_reader(BytesIO(data)).get_summary()
    return [end for chunk in summary.chunk_indexes
            for end in (chunk.chunk_start_offset,
                        chunk.chunk_start_offset + chunk.chunk_length,
                        chunk.chunk_start_offset + chunk.chunk_length
                        + chunk.message_index_length)]


def judge(cut, sound) -> int:
    """How many load samples of a cut bag were read; whatever was read must be right, and noted."""
    try:
        run = read_run(cut, test='dynamic', elevation=0.9)
    except BagError as problem:
        line = str(problem)
        assert '\n' not in line
        assert 'cut off' in line or 'empty' in line or 'no MCAP' in line or 'not an MCAP' in line \
            or 'overlap' in line or 'all four probes' in line, line
        return 0
    count = len(run.load)
    np.testing.assert_array_equal(run.load, sound.load[:count])
    kept = np.isfinite(run.gaps)
    np.testing.assert_array_equal(run.gaps[kept], sound.gaps[:, :count][kept])
    told = [READABLE.search(note) for note in run.notes]
    assert any(told), run.notes
    return count


@pytest.mark.parametrize('chunked', [True, False])
def test_cut_anywhere_it_gives_what_came_before_and_says_how_much(tmp_path, short, raw, chunked):
    whole = raw(tmp_path / 'whole.mcap', short, chunked=chunked, chunk_size=8192)
    sound, data = read_run(whole), whole.read_bytes()
    random = np.random.default_rng(4)
    places = [*random.integers(0, len(data) - 1, 60).tolist(), len(data) - 1]
    places += [end + off for end in chunk_ends(data) if chunked for off in (-1, 0, 1)][::7]
    cut = tmp_path / 'cut.mcap'
    counts = []
    for place in sorted(places):
        cut.write_bytes(data[:place])
        counts.append(judge(cut, sound))
    assert counts == sorted(counts)
    assert counts[-1] == len(sound.load)
    assert 0 < counts[len(counts) // 2] < len(sound.load)


def test_the_note_counts_what_was_read(tmp_path, recording, raw):
    whole = raw(tmp_path / 'whole.mcap', recording, chunk_size=8192).read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(whole[:len(whole) // 2])
    info = bag_info(cut, test='dynamic', elevation=0.9)
    assert info.usable
    told = READABLE.search(' '.join(info.notes))
    assert int(told[1]) == sum(topic.count for topic in info.topics)
    assert float(told[2]) == pytest.approx(info.duration, abs=1e-3)


def test_a_cut_bag_of_ours_still_has_its_facts_and_its_share(tmp_path, recording):
    bag = recording.write(tmp_path / 'bag', chunk_size=10_000)
    file = bag / 'bag_0.mcap'
    file.write_bytes(file.read_bytes()[:60_000])
    run = read_run(bag)
    assert run.test == 'dynamic'
    share = re.search(r'\(([\d.]+) % of the count in metadata.yaml\)', ' '.join(run.notes))
    assert float(share[1]) == pytest.approx(100 * len(run.load) / 1000, abs=1.0)
    (bag / 'metadata.yaml').unlink()
    assert read_run(bag).elevation == run.elevation


def test_a_tail_of_zeros_as_after_a_loss_of_power_is_a_cut(tmp_path, recording, raw):
    whole = raw(tmp_path / 'whole.mcap', recording, chunk_size=8192)
    sound, data = read_run(whole), whole.read_bytes()
    cut = tmp_path / 'cut.mcap'
    end = max(end for end in chunk_ends(data) if end <= len(data) // 2)
    cut.write_bytes(data[:end] + bytes(100_000))
    assert judge(cut, sound) > 100


def test_damage_in_the_middle_is_no_cut(tmp_path, recording, raw):
    data = bytearray(raw(tmp_path / 'whole.mcap', recording, chunk_size=8192).read_bytes())
    start = chunk_ends(bytes(data))[3]
    data[start + 1:start + 9] = (1 << 60).to_bytes(8, 'little')  # a record longer than the file
    bag = tmp_path / 'bag.mcap'
    bag.write_bytes(data)
    with pytest.raises(BagError, match=r'is damaged; .* are readable'):
        read_run(bag)


def test_the_second_of_three_files_cut_off_leaves_the_others(tmp_path, recording, raw):
    folder = tmp_path / 'bag'
    folder.mkdir()
    for part in range(3):
        rows = slice(part * 333, part * 333 + 333)
        piece = recording
        for topic in recording.stamps:
            piece = piece.changed(topic, recording.stamps[topic][rows],
                                  recording.values[topic][rows])
        raw(folder / f'bag_{part}.mcap', piece, chunk_size=4096)
    file = folder / 'bag_1.mcap'
    file.write_bytes(file.read_bytes()[:-9000])
    run = read_run(folder)
    assert run.stamps[-1] == recording.stamps[LOAD_TOPIC][998]
    assert 333 * 2 < len(run.load) < 999
    assert any('bag_1.mcap' in note and 'cut off' in note for note in run.notes)


def test_commands_say_it_wherever_their_output_goes(tmp_path, recording, capsys):
    bag = recording.write(tmp_path / 'bag', chunk_size=10_000)
    file = bag / 'bag_0.mcap'
    file.write_bytes(file.read_bytes()[:-3000])
    assert main(['displacement', str(bag), '--out', '-']) == 0
    shown = capsys.readouterr()
    assert 'cut off' in shown.err
    assert 'cut off' not in shown.out
    assert main(['info', str(bag)]) == 0
    assert 'cut off' in ' '.join(capsys.readouterr().out.split())
