"""A crash, a full disk or a kill in the middle of writing leaves the old file or the new one."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys

import numpy as np
import pytest

from saddlering_ros.bags import BagError, read_run, TestFacts, write_bag
from saddlering_ros.errors import SaddleringError
from saddlering_ros.rig import default_rig
from saddlering_ros.writing import exchange, whole_file, write_text

OLD = 'the old file\n'

WRITERS = {
    'text': 'write_text(path, text)',
    'csv': 'write_samples(path, samples)',
    'parquet': 'write_samples(path, samples)',
    'yaml': 'write_parameters(path, ParameterSet(TRUE_TO_SCALE, source=ParameterSource('
            'note=text)))',
}

PRELUDE = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from saddlering_ros.bags.samples import DisplacementSamples, write_samples
from saddlering_ros.rig import (Displacement, ParameterSet, ParameterSource, TRUE_TO_SCALE,
                                write_parameters)
from saddlering_ros.writing import write_text
text = 'new ' * 250_000
numbers = np.random.default_rng(0).normal(size=50_000)
samples = DisplacementSamples(np.arange(50_000), numbers, numbers,
                              Displacement(numbers, numbers, numbers, numbers))
path = Path(sys.argv[1])
"""


def run_limited(code: str, path: Path, after: str) -> subprocess.CompletedProcess[str]:
    """Run `code` with files limited to 64 kB: killed there (`after` SIG_DFL) or refused."""
    limit = (f'signal.signal(signal.SIGXFSZ, signal.{after})\n'
             'resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))\n')
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
    stamps = np.arange(1000) * 2_000_000
    return write_bag(path, TestFacts('dynamic', 50.0), stamps,
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
