"""Claim: a new effect with a law of its own is its file and one line in the law functions."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

import saddlering_ros

PACKAGE = Path(saddlering_ros.__file__).parent
EFFECT = Path(__file__).with_name('added_effect.py')
LAW = Path('ring/kernels/extension_laws.py')
BEFORE = '                        + m.settling_tilt * highest\n'
AFTER = BEFORE + '                        + m.tilt_hardening * moment * abs(moment)\n'

PROGRAM = """
import numpy as np
from saddlering_ros.effects import catalogue, extension_of
from saddlering_ros.rig import default_rig, TRUE_TO_SCALE
from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.extension_laws import series_motion
from saddlering_ros.ring.model import model_of

for hardening in (0.0, 3e-15):
    effects = {'tilt_hardening': {'hardening': hardening}} if hardening else {}
    model = model_of(default_rig(), 0.9, TRUE_TO_SCALE.to_array(), extension_of(effects))
    w, s = np.zeros(at.WORK_SIZE), np.zeros(at.STATE_SIZE)
    w[at.RESOLVED + 2] = -2e4
    series_motion.py_func(model.view(np.recarray)[0], s, w)
    print(w[at.MOTION + 2])
print(catalogue()['tilt_hardening'].title)
"""


@pytest.fixture(scope='module')
def changed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with the effect added."""
    root = tmp_path_factory.mktemp('added')
    copy = root / PACKAGE.name
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns('__pycache__'))
    shutil.copy(EFFECT, copy / 'effects' / 'tilt_hardening.py')
    laws = (copy / LAW).read_text(encoding='utf-8')
    assert laws.count(BEFORE) == 1
    (copy / LAW).write_text(laws.replace(BEFORE, AFTER), encoding='utf-8')
    return root


def test_its_own_file_and_one_line_of_a_law_are_all_it_takes(changed: Path) -> None:
    # The law runs as plain Python: compiling all kernels would take half a minute.
    environment = {**os.environ, 'PYTHONPATH': str(changed)}
    done = subprocess.run([sys.executable, '-c', PROGRAM], env=environment, cwd=changed,
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    without, with_it, title = done.stdout.splitlines()
    assert float(without) == 0.0
    assert float(with_it) == pytest.approx(-3e-15 * 2e4**2)
    assert title == 'Tilt compliance that hardens'


def test_a_name_declared_twice_is_refused_in_one_line(changed: Path) -> None:
    other = changed / 'saddlering_ros/effects/twin.py'
    shutil.copy(EFFECT, other)
    environment = {**os.environ, 'PYTHONPATH': str(changed)}
    asked = 'from saddlering_ros.effects import own_parameters; own_parameters()'
    done = subprocess.run([sys.executable, '-c', asked], env=environment, cwd=changed,
                          capture_output=True, text=True, check=False)
    other.unlink()
    assert 'extension parameter tilt_hardening is declared twice' in done.stderr
