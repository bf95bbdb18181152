"""The bags beside make_bags.py: small, complete, made by it, and silent about their fault."""

import importlib.util
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from benchmarks.examiner import RUNS, write_campaign
from saddlering_ros.bags.reader import read_raw, read_run
from saddlering_ros.monitoring.detector import RestLearner
from saddlering_ros.monitoring.monitor import SHORT_REST
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, TRUE_TO_SCALE

BAGS = Path(__file__).resolve().parents[2] / 'bags'


@pytest.fixture(name='make_bags', scope='module')
def make_bags_fixture():
    spec = importlib.util.spec_from_file_location('make_bags', BAGS / 'make_bags.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize('name', RUNS)
def test_a_shipped_bag_is_whole_and_at_most_two_megabytes(name):
    assert sum(file.stat().st_size for file in (BAGS / name).iterdir()) <= 2_000_000
    run = read_run(BAGS / name)
    assert run.test == RUNS[name].test
    assert np.degrees(run.elevation) == pytest.approx(RUNS[name].elevation_deg)
    assert run.notes == []
    assert run.load.max() == pytest.approx(FULL_SCALE_LOAD, rel=0.06)
    assert displacement_of_run(default_rig(), run).zero.near_preload


@pytest.mark.parametrize('name', [name for name, plan in RUNS.items() if plan.test == 'static'])
def test_a_shipped_static_bag_has_fifty_one_plateaus(name):
    assert len(plateaus(read_run(BAGS / name))) == 51


@pytest.mark.parametrize('name', [name for name, plan in RUNS.items() if plan.test == 'dynamic'])
def test_a_shipped_dynamic_bag_rests_long_enough_for_the_alarm(name):
    rig, run = default_rig(), read_run(BAGS / name)
    learner = RestLearner(rig.limits.rest_band, 0.02)
    delta_x = displacement_of_run(rig, run).displacement.delta_x
    samples = zip(run.stamps.tolist(), delta_x[:, None].tolist(), run.load.tolist(), strict=True)
    found = next(filter(None, (learner.step(*sample) for sample in samples)))
    assert found.seconds >= SHORT_REST


def test_the_shipped_bags_are_those_the_script_makes(make_bags, tmp_path):
    name = 'dynamic_50_fast'
    made, = write_campaign(make_bags.truth(), tmp_path, [name], make_bags.SETTINGS)
    shipped, again = read_raw(BAGS / name), read_raw(made)
    for topic in shipped:
        assert np.array_equal(shipped[topic].stamps, again[topic].stamps)
        level = 10.0 if topic.endswith('load') else 5e-8
        assert np.max(np.abs(shipped[topic].values - again[topic].values)) < level


def test_the_true_contact_law_is_not_the_default_one(make_bags):
    ratio = make_bags.truth().contact.to_array() / TRUE_TO_SCALE.to_array()
    stiffness_and_damping = ratio[[0, 2, 3, 5]]
    assert np.all(np.abs(stiffness_and_damping - 1.0) > 0.1)


def test_the_fault_stands_in_no_file_beside_the_bags(make_bags):
    fault = make_bags.truth().effects[0].effect.id.encode()
    for file in BAGS.rglob('*'):
        if file.suffix in ('.yaml', '.mcap', '.md'):
            assert fault not in file.read_bytes()


def test_the_virtual_rig_never_sees_the_simulator_nor_the_catalogue():
    code = ('import sys, benchmarks.examiner; '
            'print([m for m in sys.modules if m.startswith(("saddlering_ros.ring", '
            '"saddlering_ros.effects", "saddlering_ros.discrepancy"))])')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True,
                          cwd=BAGS.parent)
    assert done.stdout.strip() == '[]'
