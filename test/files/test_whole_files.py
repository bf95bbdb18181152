"""A crash, a full disk or a kill in the middle of writing leaves the old file or the new one."""

import os
from pathlib import Path
import signal
import subprocess
import sys

import numpy as np
import pytest

from saddlering_ros.bags.reader import read_run
from saddlering_ros.bags.write import write_bag
from saddlering_ros.errors import BagError, SaddleringError
from saddlering_ros.files import (
    exchange,
    rename_without_replacing,
    temporary_folder,
    whole_file,
    write_text,
)
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import default_rig

OLD = 'the old file\n'

WRITERS = {
    'text': 'write_text(path, text)',
    'csv': 'write_samples(path, [samples])',
    'parquet': 'write_samples(path, [samples])',
    'yaml': 'write_parameters(path, ParameterSet(TRUE_TO_SCALE, source=ParameterSource('
            'note=text)))'}

PRELUDE = """
import signal, sys
from pathlib import Path
import numpy as np
from saddlering_ros.rig import (Displacement, ParameterSet, ParameterSource, TRUE_TO_SCALE,
                                write_parameters)
from saddlering_ros.files import write_text
from saddlering_ros.bags.samples import COLUMNS, write_samples
text = 'new ' * 250_000
numbers = np.random.default_rng(0).normal(size=50_000)
samples = {**dict.fromkeys(COLUMNS, numbers), 'stamp_ns': np.arange(50_000),
           'validity': np.zeros(50_000, np.uint8)}
path = Path(sys.argv[1])
"""


def limited_to(size: int) -> str:
    """Code that limits files to `size` bytes, until the process exits: coverage writes then."""
    return ('import atexit, resource; whole = resource.getrlimit(resource.RLIMIT_FSIZE); '
            'atexit.register(resource.setrlimit, resource.RLIMIT_FSIZE, whole); '
            f'resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, whole[1]))')


def run_limited(code: str, path: Path, after: str) -> subprocess.CompletedProcess[str]:
    """Run `code` with files limited to 64 kB: killed there (`after` SIG_DFL) or refused."""
    limit = f'signal.signal(signal.SIGXFSZ, signal.{after})\n{limited_to(65536)}\n'
    return subprocess.run([sys.executable, '-c', PRELUDE + limit + code, str(path)],
                          capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize('kind', ['text', 'csv', 'parquet', 'yaml'])
def test_a_writer_killed_in_the_middle_leaves_the_old_file(tmp_path, kind):
    path = tmp_path / f'out.{kind}'
    path.write_text(OLD)
    ended = run_limited(WRITERS[kind], path, 'SIG_DFL')
    assert ended.returncode == -signal.SIGXFSZ, ended.stderr
    assert path.read_text() == OLD
    left = [name for name in os.listdir(tmp_path) if name != path.name]
    assert all(name.startswith('.') for name in left)


@pytest.mark.parametrize('kind', ['text', 'parquet'])
def test_a_full_disk_is_one_line_and_leaves_the_old_file_alone(tmp_path, kind):
    path = tmp_path / f'out.{kind}'
    path.write_text(OLD)
    ended = run_limited(WRITERS[kind], path, 'SIG_IGN')
    said = ended.stderr.splitlines()[-1]
    assert 'cannot be written' in said
    assert 'File too large' in said
    assert path.read_text() == OLD
    assert os.listdir(tmp_path) == [path.name]


def test_a_command_on_a_full_disk_says_so_and_keeps_the_old_file(tmp_path):
    path = tmp_path / 'displacement.csv'
    path.write_text(OLD)
    command = (f'{limited_to(65536)}; import signal, sys; '
               'signal.signal(signal.SIGXFSZ, signal.SIG_IGN); '
               'from saddlering_ros.cli.main import main; sys.exit(main())')
    bag = Path(__file__).parents[2] / 'bags' / 'dynamic_50_fast'
    ended = subprocess.run(
        [sys.executable, '-c', command, 'displacement', str(bag), '--out', str(path)],
        capture_output=True, text=True, check=False, timeout=60)
    assert (ended.returncode, len(ended.stderr.splitlines())) == (2, 1)
    assert 'cannot be written' in ended.stderr
    assert os.listdir(tmp_path) == [path.name]
    assert path.read_text() == OLD


def test_ctrl_c_leaves_the_old_file_alone(tmp_path):
    path = tmp_path / 'out.txt'
    path.write_text(OLD)

    def interrupted() -> None:
        with whole_file(path) as temporary:
            temporary.write_text('half')
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == OLD
    assert os.listdir(tmp_path) == [path.name]


def test_links_are_followed_and_devices_are_not_replaced(tmp_path):
    real, link, pipe = tmp_path / 'real', tmp_path / 'link', tmp_path / 'pipe'
    real.write_text(OLD)
    link.symlink_to(real)
    write_text(link, 'new')
    assert link.is_symlink()
    assert real.read_text() == 'new'
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_text(pipe, 'said')
    assert os.read(reader, 10) == b'said'
    os.close(reader)
    assert pipe.is_fifo()


def test_a_folder_is_no_place_for_a_file(tmp_path):
    with pytest.raises(SaddleringError, match='is a directory'):
        write_text(tmp_path, 'text')


def small_bag(path: Path, load: float, **options) -> Path:
    stamps = 10**18 + np.arange(1000) * 2_000_000
    return write_bag(path, TestMetadata('dynamic', 50.0), stamps,
                     load * (1 + np.arange(1000) / 500), [stamps] * 4,
                     [1e-3 + 1e-7 * np.random.default_rng(0).normal(size=1000)] * 4,
                     default_rig().probes, **options)


def test_a_bag_is_replaced_at_one_go_or_not_at_all(tmp_path, monkeypatch):
    bag = small_bag(tmp_path / 'bag', 50e3)
    small_bag(bag, 60e3, overwrite=True)
    assert read_run(bag).load[0] == 60e3
    assert os.listdir(tmp_path) == ['bag']

    def full(*_: object) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(BagError, match='No space left'):
        small_bag(bag, 70e3, overwrite=True)
    assert read_run(bag).load[0] == 60e3
    assert os.listdir(tmp_path) == ['bag']


@pytest.mark.parametrize('by_kernel', [True, False])
def test_two_folders_change_places(tmp_path, monkeypatch, by_kernel):
    if not by_kernel:
        monkeypatch.setattr('ctypes.CDLL', lambda *_, **__: object())
    one, other = tmp_path / 'one', tmp_path / 'other'
    for folder in (one, other):
        folder.mkdir()
        (folder / folder.name).touch()
    exchange(one, other)
    assert os.listdir(other) == ['one']
    assert os.listdir(one) == ['other']
    assert sorted(os.listdir(tmp_path)) == ['one', 'other']


def test_a_move_that_fails_leaves_nothing_at_its_place(tmp_path: Path) -> None:
    """An empty folder was made first: a bag whose move was interrupted looked as if it existed."""
    with pytest.raises(FileNotFoundError):
        rename_without_replacing(tmp_path / 'gone', tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()


RECORD = """
import os, signal, sys
from pathlib import Path
import numpy as np
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.bags.write import BagWriter, RECORDED_CHUNK_SIZE
from saddlering_ros.bags.wire import encode_samples
from saddlering_ros.record.batches import Samples
from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.errors import SaddleringError
kinds = {LOAD_TOPIC: 'geometry_msgs/msg/WrenchStamped',
         **dict.fromkeys(PROBE_TOPICS, 'sensor_msgs/msg/Range')}
rest = np.random.default_rng(0)
END
facts = TestMetadata('dynamic', 50.0).as_text()
try:
    with BagWriter(Path(sys.argv[1]), kinds, facts, chunk_size=RECORDED_CHUNK_SIZE,
                   recorded=True) as bag:
        for stamp in range(10 ** 18, 10 ** 18 + 10 ** 11, 10 ** 8):
            at = np.array([stamp])
            print(stamp, flush=True)
            if stamp == killed:
                os.kill(os.getpid(), signal.SIGKILL)
            load = Samples(at, rest.normal(1e5, 1e3, 1))
            bag.write_message(LOAD_TOPIC, stamp, *encode_samples(load, LOAD, ''))
            for topic in PROBES:
                gap = Samples(at, rest.normal(1e-3, 1e-5, 1), 0.0, 2e-3)
                bag.write_message(topic.name, stamp, *encode_samples(gap, topic, ''))
except SaddleringError as problem:
    print(problem)
"""


@pytest.mark.parametrize(('end', 'status', 'words'), [
    (f'{limited_to(60_000)}; killed = 0', 0, 'cannot be written (File too large)'),
    ('killed = 10 ** 18 + 60 * 10 ** 9', -signal.SIGKILL, '')])
def test_a_recording_that_ends_in_the_middle_keeps_all_but_its_last_seconds(
        tmp_path, end, status, words):
    """At 10 Hz, where a chunk takes longest to fill; ended by a full disk, or killed."""
    ended = subprocess.run(
        [sys.executable, '-c', RECORD.replace('END', end), str(tmp_path / 'bag')], timeout=60,
        capture_output=True, text=True, check=False)
    assert ended.returncode == status, ended.stderr
    assert not (tmp_path / 'bag').exists()
    kept, = tmp_path.glob('.bag.recording.*/bag')
    stamps = [int(line) for line in ended.stdout.splitlines() if line.isdigit()]
    said = ended.stdout.splitlines()[-1]
    assert not words or (words in said and said.endswith(f'is readable in {kept}'))
    run = read_run(kept)
    assert 'cut off' in ' '.join(run.notes)
    assert stamps[-1] - run.stamps[-1] < 10e9


def test_what_a_killed_writer_of_a_bag_left_is_swept_at_the_next_one(tmp_path):
    with temporary_folder(tmp_path, '.bag.') as alive:
        dead = tmp_path / '.bag.abcdefgh'
        recording = tmp_path / '.bag.recording.abcdefgh'
        for folder in (dead, recording):
            (folder / 'bag').mkdir(parents=True)
        for folder in (alive, dead, recording):
            os.utime(folder, (0, 0))
        with temporary_folder(tmp_path, '.bag.'):
            left = set(tmp_path.iterdir())
        assert left >= {alive, recording}
        assert dead not in left
    assert sorted(tmp_path.iterdir()) == [recording]


def test_what_a_killed_writer_left_is_swept_and_what_a_living_one_writes_is_not(tmp_path):
    target = tmp_path / 'report.html'
    with whole_file(target) as alive:
        dead = tmp_path / '.report.html.abcdefgh.html'
        other = tmp_path / '.report.html.backup.html'
        for file in (dead, other):
            file.write_text('half')
        for file in (alive, dead, other):
            os.utime(file, (0, 0))
        write_text(target, 'new')
        assert alive.exists()
        assert not dead.exists()
        assert other.exists()
    assert not alive.exists()
