"""Claims about tools/set_up.sh where it must stop: one line that names what to install."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def project(tmp_path):
    """A copy of what set-up reads, without an environment."""
    for name in ('tools', 'requirements', 'saddlering_interfaces'):
        shutil.copytree(ROOT / name, tmp_path / name)
    return tmp_path


def programs(folder, **fakes):
    """A bin/ folder with the plain tools of this machine, and `fakes`: name to script."""
    folder.mkdir()
    tools = {'bash', 'basename', 'cat', 'cut', 'dirname', 'env', 'sha256sum', 'uname'}
    for name in tools - set(fakes):
        where = shutil.which(name)
        assert where is not None
        (folder / name).symlink_to(where)
    for name, script in fakes.items():
        (folder / name).write_text(f'#!/bin/sh\n{script}\n')
        (folder / name).chmod(0o755)
    return str(folder)


def set_up(project, path, **environment):
    return subprocess.run(
        [shutil.which('bash') or 'bash', 'tools/set_up.sh'], cwd=project, text=True,
        capture_output=True, env={'PATH': path, 'HOME': str(project), **environment}, timeout=60,
        check=False)


VERSION = 'case "$*" in *version_info*) echo 3.12;; '


@pytest.mark.parametrize(('words', 'fakes', 'given'), [
    ('apt install python3', {}, {}),
    ('is Python 3.9; 3.10 to 3.13 is needed', {'python3': 'echo 3.9'}, {'PYTHON': 'python3'}),
    ('apt install python3-venv', {'python3': f'{VERSION}*ensurepip*) exit 1;; esac'}, {}),
    ('no C compiler: sudo apt install', {'python3': f'{VERSION}esac'}, {}),
    ('no C++ compiler: sudo apt install', {'python3': f'{VERSION}esac', 'gcc': 'exit 0'}, {}),
    ('apt install python3-dev', {'python3': f'{VERSION}*sysconfig*) echo /nowhere;; esac',
                                 'gcc': 'exit 0', 'g++': 'exit 0'}, {}),
    ('source a ROS 2 Jazzy first', {'python3': 'echo 3.12', 'uname': 'echo aarch64'}, {}),
], ids=['no python', 'old python', 'no venv', 'no C', 'no C++', 'no headers', 'no wheels'])
def test_what_is_missing_is_named_in_one_line(project, words, fakes, given):
    done = set_up(project, programs(project / 'bin', **fakes), **given)
    assert done.returncode == 1
    assert words in done.stderr
    assert done.stderr.count('\n') == 1


def test_an_old_python3_beside_a_usable_one_is_passed_over(project):
    path = programs(project / 'bin', python3='echo 3.9',
                    **{'python3.11': 'case "$*" in *version_info*) echo 3.11;; *) exit 1;; esac'})
    assert 'python3.11 cannot make environments' in set_up(project, path).stderr


@pytest.mark.parametrize(('cache', 'is_kept'), [('/proc/none', False), ('cache', True)])
def test_a_cache_of_pip_that_cannot_be_written_is_not_used(project, cache, is_kept):
    """As root pip does not look, and built no wheel in a container with a read-only home."""
    python = (f'case "$*" in *version_info*) echo 3.12;; *"-m venv"*) mkdir -p .venv/bin; '
              f'cp "$0" .venv/bin/python;; *"cache dir"*) echo {cache};; '
              '*"pip install"*) echo "$*"; exit 1;; *sysconfig*) echo .;; esac')
    (project / 'Python.h').touch()
    path = programs(project / 'bin', python3=python, gcc='exit 0', **{'g++': 'exit 0'})
    for name in ('cp', 'grep', 'mkdir', 'rm', 'tail'):
        (project / 'bin' / name).symlink_to(shutil.which(name))
    said = set_up(project, path).stderr
    assert 'pip install' in said
    assert ('--no-cache-dir' in said) != is_kept


@pytest.mark.skipif(not (ROOT / '.venv' / 'stamps' / 'python').is_file(),
                    reason='this is not an environment that set-up made')
def test_a_second_set_up_finds_nothing_to_do():
    # Of an environment that is out of date nothing is removed under the feet of other tests.
    environment = {**os.environ, 'PIP_NO_INDEX': '1', 'SADDLERING_SET_UP_CHECK': '1'}
    recorded = (ROOT / '.venv' / 'stamps' / 'python').read_text().strip()
    done = subprocess.run(['tools/set_up.sh'], cwd=ROOT, env={**environment, 'PYTHON': recorded},
                          text=True, capture_output=True, timeout=60, check=False)
    if done.returncode == 3:
        pytest.skip(f'{done.stderr.strip()}: make setup')
    assert (done.returncode, done.stdout, done.stderr) == (0, '', '')


def test_a_node_without_ros_says_so_in_one_line():
    """As in an environment that holds the wheel alone; it was a traceback."""
    start = ("import sys; sys.modules['rclpy'] = None; sys.argv[0] = 'hydraulic_load'; "
             'import saddlering_ros.nodes.hydraulic_load')
    done = subprocess.run([sys.executable, '-c', start], text=True, capture_output=True,
                          timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith('hydraulic_load: Python package rclpy is not installed here')
    assert done.stderr.count('\n') == 1
