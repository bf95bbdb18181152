"""Blind draws: another process hides something, the diagnosis sees bags, then the seal opens.

A few fixed draws, a test each, so that a failure is the commit's. `make bench-blind` runs those
marked campaign too, then benchmarks/blind.py: pairs, fresh draws by the hundred, and the rates
that they must keep.
"""

import json
from pathlib import Path
import subprocess
import sys

import pytest

from benchmarks.examiner import open_seal, score, SEALED
from saddlering_ros import diagnose

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures('no_next_test')]

EXAMINER = str(Path(__file__).parents[2] / 'benchmarks' / 'examiner.py')
TWO, THREE = 'static_50,dynamic_50', 'static_50,dynamic_50,static_70'
SHORT = ('--hold', '2', '--duration', '8', '--dynamic-rate', '250', '--sizes', '0.7', '1')


def diagnosed(folder: Path, kind: str, seed: int, *effects: str, runs: str = TWO) -> str:
    """How the verdict on a draw counts: drawn and sealed in another process, then opened."""
    command = [sys.executable, EXAMINER, '--seed', str(seed),
               '--kind', kind, '--out', str(folder / 'rig'), '--runs', runs, *SHORT]
    for effect in effects:
        command += ['--effect', effect]
    drawn = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    answer = diagnose(drawn['bags'], seed=seed).to_json()
    truth = open_seal(folder / 'rig' / SEALED, drawn['seal'])
    groups = [cause['group'] for cause in answer['causes'] if 'effect' in cause]
    print(truth['effects'], answer['verdict'], groups)
    return score(kind, [item['effect'] for item in truth['effects']], answer['verdict'],
                 groups)[0]


@pytest.mark.campaign
def test_a_sound_rig_gets_no_cause(tmp_path: Path) -> None:
    assert diagnosed(tmp_path, 'clean', 101, runs=THREE) == 'right'


@pytest.mark.parametrize(('effect', 'seed'), [('damping_law', 104)])
def test_a_hidden_effect_is_found(tmp_path: Path, effect: str, seed: int) -> None:
    assert diagnosed(tmp_path, 'single', seed, effect) == 'right'


def test_an_effect_outside_the_catalogue_is_unknown(tmp_path: Path) -> None:
    runs = 'static_50,dynamic_50_fast'
    assert diagnosed(tmp_path, 'outside', 106, 'out:tilt_backlash', runs=runs) == 'right'


@pytest.mark.campaign
@pytest.mark.parametrize(('seed', 'effect'), [(7002, 'radial_clearance')])
def test_a_draw_that_once_failed_gets_no_wrong_name(tmp_path, seed, effect) -> None:
    assert diagnosed(tmp_path, 'single', seed, effect, runs=THREE) != 'wrong'
