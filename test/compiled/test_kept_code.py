"""Claims about compiled functions whose machine code is kept between processes."""

import contextlib
import importlib
import io
import os
from pathlib import Path
import runpy
import shutil
import subprocess
import sys
import time
from unittest import mock

import pytest

from saddlering_ros import compiled
from saddlering_ros.compiled import digest_of

CALLER = """
from pathlib import Path
from callee import grown
from saddlering_ros.compiled import Compiler

compiler = Compiler(Path(__file__).parent)

@compiler()
def caller(x):
    return grown(x) + 1.0

if __name__ == '__main__':
    print(caller(10.0), sum(caller.stats.cache_hits.values()), compiler.folder)
"""
CALLEE = """
import numba as nb

@nb.njit
def grown(x):
    return {factor} * x
"""


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    folder = tmp_path / 'sources'
    folder.mkdir()
    (folder / 'caller.py').write_text(CALLER)
    (folder / 'callee.py').write_text(CALLEE.format(factor=2.0))
    return folder


ROOT = str(Path(__file__).resolve().parents[2])


def environment(home: str, **more: str) -> dict[str, str]:
    """Bytecode is not kept: two versions of a file in the same second are one to Python."""
    clean = {name: value for name, value in os.environ.items()
             if name not in ('NUMBA_CACHE_DIR', 'XDG_CACHE_HOME')}
    return {**clean, 'PYTHONPATH': ROOT, 'PYTHONDONTWRITEBYTECODE': '1', 'HOME': home, **more}


def read(printed: str) -> tuple[float, int, str]:
    """Value, functions loaded from the folder of kept code, and that folder."""
    value, hits, kept_in = printed.split(maxsplit=2)
    return float(value), int(hits), kept_in.strip()


def called_by_a_process(folder: Path, home: str) -> tuple[float, int, str]:
    return read(subprocess.run(
        [sys.executable, str(folder / 'caller.py')], capture_output=True, text=True, check=True,
        env=environment(home)).stdout)


def called(folder: Path, home: str, **more: str) -> tuple[float, int, str]:
    """The same in this process, in which the modules of `folder` are imported anew."""
    printed = io.StringIO()
    for once_a_process in (compiled._first_writable, compiled._note_damage):
        once_a_process.cache_clear()
    with (mock.patch.dict(os.environ, environment(home, **more), clear=True),
          mock.patch.object(sys, 'dont_write_bytecode', True),
          mock.patch.object(sys, 'path', [str(folder), *sys.path]),
          contextlib.redirect_stdout(printed)):
        importlib.invalidate_caches()
        sys.modules.pop('callee', None)
        runpy.run_path(str(folder / 'caller.py'), run_name='__main__')
    return read(printed.getvalue())


def test_code_is_loaded_again_after_a_new_installation(sources: Path, tmp_path: Path) -> None:
    home = str(tmp_path)
    assert called_by_a_process(sources, home)[:2] == (21.0, 0)
    installed_again = tmp_path / 'another place'
    shutil.copytree(sources, installed_again, ignore=shutil.ignore_patterns('__pycache__'))
    assert called_by_a_process(installed_again, home)[:2] == (21.0, 1)


def test_a_change_of_a_function_called_leaves_no_stale_code(sources, tmp_path) -> None:
    called(sources, str(tmp_path))
    (sources / 'callee.py').write_text(CALLEE.format(factor=3.0))
    assert called(sources, str(tmp_path))[:2] == (31.0, 0)


def test_a_home_that_cannot_be_written_to_leaves_code_beside_the_source(sources: Path) -> None:
    value, _, kept_in = called(sources, '/proc/none')
    assert (value, Path(kept_in).parents[2]) == (21.0, sources)


def test_without_any_folder_to_write_to_functions_are_compiled_anew(sources: Path) -> None:
    (sources / '__pycache__').write_text('not a folder')
    assert called(sources, '/proc/none') == (21.0, 0, 'None')


def test_the_folder_of_numba_comes_first_if_the_user_named_one(sources, tmp_path) -> None:
    named = tmp_path / 'named'
    kept_in = called(sources, str(tmp_path), NUMBA_CACHE_DIR=str(named))[2]
    assert Path(kept_in).parent == named


def test_code_that_nobody_loads_any_more_is_removed(sources: Path, tmp_path: Path) -> None:
    unused = Path(called(sources, str(tmp_path))[2])
    assert unused.exists()
    os.utime(unused, (time.time() - 100 * 86400.0,) * 2)
    (sources / 'callee.py').write_text(CALLEE.format(factor=3.0))
    called(sources, str(tmp_path))
    assert not unused.exists()


def test_the_digest_is_of_what_files_hold_not_of_when_they_were_written(sources: Path) -> None:
    before = digest_of([sources])
    os.utime(sources / 'caller.py', (1.0, 1.0))
    assert digest_of([sources]) == before
    (sources / 'caller.py').write_text(CALLER + '# changed')
    assert digest_of([sources]) != before


@pytest.mark.parametrize('damage', [
    lambda content: b'', lambda content: content[:-9],
    lambda content: content[:99] + bytes([content[99] ^ 255]) + content[100:],
], ids=['empty', 'cut off', 'altered'])
@pytest.mark.parametrize('suffix', ['.nbi', '.nbc'])
def test_damaged_code_is_compiled_again_with_one_note(sources, tmp_path, capsys, suffix, damage):
    kept_in = Path(called(sources, str(tmp_path))[2])
    for file in kept_in.glob(f'*{suffix}'):
        file.write_bytes(damage(file.read_bytes()))
    assert called(sources, str(tmp_path))[:2] == (21.0, 0)
    assert capsys.readouterr().err.count('was damaged') == 1
    assert called(sources, str(tmp_path))[:2] == (21.0, 1)


def test_a_folder_of_another_user_is_not_used(sources: Path, tmp_path: Path, monkeypatch) -> None:
    kept_in = called(sources, '/proc/none', NUMBA_CACHE_DIR=str(tmp_path))[2]
    monkeypatch.setattr(os, 'geteuid', lambda: Path(kept_in).stat().st_uid + 1)
    _, hits, none = called(sources, '/proc/none', NUMBA_CACHE_DIR=str(tmp_path))
    assert (hits, none) == (0, 'None')


def test_code_that_others_could_have_written_is_not_loaded(sources: Path, tmp_path: Path) -> None:
    kept_in = Path(called(sources, str(tmp_path))[2])
    assert kept_in.stat().st_mode & 0o777 == 0o700
    kept_in.chmod(0o770)
    assert called(sources, str(tmp_path))[:2] == (21.0, 0)
    assert kept_in.stat().st_mode & 0o777 == 0o700


def test_a_link_in_place_of_the_folder_is_not_followed(sources: Path, tmp_path: Path) -> None:
    kept_in = Path(called(sources, str(tmp_path))[2])
    moved = tmp_path / 'moved'
    kept_in.rename(moved)
    kept_in.symlink_to(moved)
    assert called(sources, str(tmp_path))[2] != str(kept_in)
