"""Blind tests: draws repeat per seed, the seal holds, and nothing of the truth is in the bags."""

import json
from pathlib import Path
import subprocess
import sys

from mcap.records import Chunk
from mcap.stream_reader import StreamReader
import numpy as np
import pytest
import zstandard

from benchmarks import examiner
from benchmarks.examiner import CLEAN, draw_truth, KINDS, open_seal, OUTSIDE, PAIR, SEALED, SINGLE
from saddlering_ros.bags.reader import read_run
from saddlering_ros.errors import VirtualRigError
from saddlering_ros.virtual_rig.effects import EFFECTS

EXAMINER = Path(__file__).parents[2] / 'benchmarks' / 'examiner.py'
SMALL = ['--runs', 'dynamic_50', '--duration', '2.5', '--dynamic-rate', '100']


def examine(out, *more):
    command = [sys.executable, EXAMINER, '--out', str(out), *SMALL]
    return subprocess.run([*command, *more], capture_output=True, text=True, check=False)


@pytest.fixture(name='blind', scope='module')
def blind_fixture(tmp_path_factory):
    out = tmp_path_factory.mktemp('blind')
    done = examine(out, '--seed', '5')
    assert done.returncode == 0, done.stderr
    return out, json.loads(done.stdout)


def test_the_examiner_prints_bags_and_seal_and_not_the_truth(blind):
    _, said = blind
    assert set(said) == {'seed', 'bags', 'seal'}
    assert read_run(said['bags'][0]).test == 'dynamic'


def test_the_seal_opens_with_its_digest_only(blind):
    out, said = blind
    truth = open_seal(out / SEALED, said['seal'])
    assert truth['effects'][0]['effect'] in EFFECTS
    with pytest.raises(VirtualRigError, match='broken'):
        open_seal(out / SEALED, '0' * 64)


def test_neither_bags_nor_sealed_file_name_the_effect(blind):
    out, said = blind
    name = open_seal(out / SEALED, said['seal'])['effects'][0]['effect'].encode()
    files = [file for file in out.rglob('*') if file.is_file()]
    assert len(files) > 2
    for file in files:
        assert name not in file.read_bytes()
    for bag in said['bags']:
        (mcap,) = Path(bag).glob('*.mcap')
        chunks = [record.data if record.compression == '' else zstandard.decompress(record.data)
                  for record in StreamReader(mcap.open('rb'), emit_chunks=True).records
                  if isinstance(record, Chunk)]
        assert chunks
        assert not any(name in chunk for chunk in chunks)


@pytest.mark.parametrize('kind', KINDS)
def test_a_draw_repeats_with_its_seed(kind):
    assert draw_truth(11, kind).to_json() == draw_truth(11, kind).to_json()
    assert draw_truth(11, kind).to_json() != draw_truth(12, kind).to_json()


def test_draws_are_of_the_kind_asked_for():
    for seed in range(30):
        assert draw_truth(seed, CLEAN).effects == ()
        single, = draw_truth(seed, SINGLE).effects
        outside, = draw_truth(seed, OUTSIDE).effects
        first, second = draw_truth(seed, PAIR).effects
        assert single.effect.in_catalogue
        assert not outside.effect.in_catalogue
        assert first.effect.id != second.effect.id


def test_draws_reach_every_effect_and_form():
    seen = {(item.effect.id, item.form)
            for seed in range(1500) for item in draw_truth(seed, SINGLE).effects}
    expected = {(effect.id, form) for effect in EFFECTS.values() if effect.in_catalogue
                for form in effect.forms}
    assert seen == expected


def test_sizes_stay_in_the_part_of_the_range_asked_for():
    settings = examiner.DrawSettings(effects=('radial_friction',), sizes=(0.9, 1.0))
    main = EFFECTS['radial_friction'].parameters[0]
    for seed in range(20):
        size = draw_truth(seed, SINGLE, settings).effects[0].values['force']
        assert main.low * (main.high / main.low) ** 0.9 <= size <= main.high


def test_all_runs_of_a_campaign_are_of_one_rig(tmp_path):
    truth = draw_truth(4, CLEAN)
    record = examiner.RecordSettings(duration=2.5, dynamic_rate=100.0)
    one, other = examiner.write_campaign(truth, tmp_path, ['dynamic_50', 'dynamic_70'], record)
    first, second = read_run(one), read_run(other)
    assert np.degrees([first.elevation, second.elevation]) == pytest.approx([50.0, 70.0])
    assert first.rig == second.rig
    assert not np.array_equal(first.gaps[0, :50], second.gaps[0, :50])
