"""Claims about bags of another rig: asked about before anything is computed."""

from dataclasses import replace
import json
import math
from pathlib import Path
import re

from forked_nodes import endings
import numpy as np
import pytest

from saddlering_ros import read_bag
from saddlering_ros.bags.write import write_bag
from saddlering_ros.cli.main import main
from saddlering_ros.doubts.comparison import refuse_other_rig, refuse_repeats
from saddlering_ros.errors import BagError
from saddlering_ros.files import share_directory
from saddlering_ros.quantities import told_once
from saddlering_ros.record.record import Record, TestMetadata
from saddlering_ros.rig import ParameterSet, ParameterSource, TRUE_TO_SCALE, write_parameters
from saddlering_ros.rig.description import default_rig

RIG = default_rig()
OTHER = replace(RIG, full_scale_load=98066.5)


def run_of(name: str = '', rig_hash: str = '') -> Record:
    return Record('a', Path('a'), 'static', math.radians(50.0), name, '', np.arange(3),
                  np.arange(3.0), np.arange(3.0), np.ones((4, 3)),
                  details={'rig_hash': rig_hash} if rig_hash else {})


def test_a_bag_of_another_rig_is_refused_with_what_to_do() -> None:
    for rig, of_bag, words in ((RIG, OTHER, 'the shipped rig is in use, which is another'),
                               (OTHER, RIG, 'the rig in use is another')):
        with pytest.raises(BagError) as caught:
            refuse_other_rig([run_of('SR-48', of_bag.digest)], rig)
        message = str(caught.value)
        assert words in message
        assert "'SR-48'" in message
        assert of_bag.digest[:12] in message
        assert 'trust_rig=True' in message


def test_a_bag_of_the_same_rig_and_one_that_says_nothing_are_taken() -> None:
    runs = [run_of('SR-48', RIG.digest), run_of(), run_of('virtual rig')]
    refuse_other_rig(runs, RIG)
    assert not any(run.notes for run in runs)


def test_a_bag_that_only_names_its_rig_gets_a_note_where_no_file_is_given() -> None:
    run = run_of('SR-48')
    refuse_other_rig([run], RIG)
    assert "names the rig 'SR-48', and the shipped rig is simulated" in run.notes[0]


def test_what_all_runs_of_a_fit_have_in_common_is_told_once() -> None:
    runs = [run_of('SR-48') for _ in range(3)]
    refuse_other_rig(runs, RIG)
    runs[1].notes.append('the load is negative')
    told = told_once((name, note) for name, run in zip('abc', runs, strict=True)
                     for note in run.notes)
    assert len(told) == 2
    assert told[0].startswith("a, b, c: the bag names the rig 'SR-48'")
    assert told[1] == 'b: the load is negative'


def test_tests_of_two_rings_that_are_fitted_together_get_a_note() -> None:
    runs = [run_of('bench 1'), run_of('bench 1'), run_of()]
    for number, run in enumerate(runs):
        run.load[:] += 10.0 * number
    refuse_repeats(runs[:2], runs[2:])
    assert not any(run.notes for run in runs)
    runs = [replace(run, details={'ring': ring}) for run, ring in zip(runs, 'ABB', strict=True)]
    for _ in range(2):
        refuse_repeats(runs[:2], runs[2:])
    assert all(len(run.notes) == 1 and 'name the rings A and B' in run.notes[0] for run in runs)


def test_a_forgotten_rig_file_costs_a_line_and_not_minutes(tmp_path, capsys) -> None:
    data = Path(__file__).resolve().parents[2] / 'docs' / 'data'
    bag = tmp_path / 'bag'
    assert main(['import', str(data / 'dynamic_30.csv'), '--map',
                 str(data / 'map_dynamic_30.yaml'), '--rig', str(data / 'rig.yaml'), '--out',
                 str(bag)]) == 0
    capsys.readouterr()
    for command in ('diagnose', 'identify'):
        assert main([command, str(bag)]) == 2
        assert 'the shipped rig is in use, which is another' in capsys.readouterr().err


@pytest.fixture(name='bag_of_other_rig')
def bag_of_other_rig_fixture(tmp_path: Path) -> str:
    """A short bag that states the hash of another rig than the shipped one."""
    stamps = 1_700_000_000_000_000_000 + np.arange(400) * 10_000_000
    load = 5000.0 + np.linspace(0.0, 50e3, 400)
    gaps = [1e-3 + sign * 1e-10 * load for sign in (1, 1, -1, -1)]
    facts = TestMetadata('dynamic', 50.0, 'SR-48', 'run', {'rig_hash': OTHER.digest})
    return str(write_bag(tmp_path / 'other', facts, stamps, load, [stamps] * 4, gaps, RIG.probes))


@pytest.mark.parametrize('command', ['displacement', 'simulate', 'residual', 'watch', 'replay'])
def test_no_command_takes_a_bag_of_another_rig_silently(
        command: str, bag_of_other_rig: str, tmp_path: Path,
        capsys: pytest.CaptureFixture[str]) -> None:
    """Until this test, gamma came out as 281.9 for 398.4 urad, without a word."""
    law = tmp_path / 'law.yaml'
    write_parameters(law, ParameterSet(TRUE_TO_SCALE))
    params = [] if command == 'displacement' else ['--params', str(law)]
    assert main([command, bag_of_other_rig, *params]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1
    assert 'the shipped rig is in use, which is another' in said
    assert '--trust-rig' in said


def test_the_rig_of_the_project_is_taken_and_named(
        bag_of_other_rig: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    file = other_rig_file(tmp_path)
    monkeypatch.setenv('SADDLERING_RIG', str(file))
    assert main(['displacement', bag_of_other_rig, '--json', '-']) == 0
    said = capsys.readouterr()
    assert f'rig: {file} (SADDLERING_RIG), hash {OTHER.digest[:12]}' in said.err
    assert str(file) in [one['path'] for one in json.loads(said.out)['provenance']['files']]
    bag = read_bag(bag_of_other_rig)
    assert (bag.rig.digest, bag.rig.source) == (OTHER.digest, str(file))


def other_rig_file(folder: Path) -> Path:
    shipped = share_directory() / 'config' / 'rig.yaml'
    text = re.sub('full_scale_load: .*', 'full_scale_load: 98066.5', shipped.read_text())
    (folder / 'other.yaml').write_text(text)
    return folder / 'other.yaml'


@pytest.mark.ros
def test_no_node_takes_a_bag_or_parameters_of_another_rig_silently(bag_of_other_rig, tmp_path):
    law = law_of_other_rig(tmp_path)
    replays = [(name, ['--ros-args', '-p', f'bag:={bag_of_other_rig}'])
               for name in ('replay_clock', 'hydraulic_load', 'eddy_current')]
    *bags, parameters = endings(
        [*replays, ('ring_simulator', ['--ros-args', '-p', f'parameters_file:={law}'])])
    for status, said in bags:
        assert status == 2
        assert 'the shipped rig is in use, which is another' in said
        assert '--params-file FILE of that rig, or -p trust_rig:=true' in said
    assert parameters[0] == 2
    assert 'the parameters belong to the rig' in parameters[1]


def law_of_other_rig(folder: Path) -> Path:
    law = folder / 'law.yaml'
    write_parameters(law, ParameterSet(TRUE_TO_SCALE, {}, ParameterSource(
        'assumed', (), None, None, '', rig_hash=OTHER.digest)))
    return law


def test_a_bag_of_another_rig_is_computed_where_the_rig_is_trusted(bag_of_other_rig, capsys):
    assert main(['displacement', bag_of_other_rig, '--trust-rig']) == 0
    assert 'gamma' in capsys.readouterr().out


@pytest.mark.parametrize('command', ['simulate', 'residual', 'watch', 'replay', 'plan'])
def test_no_command_takes_parameters_of_another_rig_silently(command, tmp_path, capsys) -> None:
    law = law_of_other_rig(tmp_path)
    bag = Path(__file__).resolve().parents[2] / 'bags' / 'dynamic_50_fast'
    assert main([command, *([] if command == 'plan' else [str(bag)]), '--params', str(law)]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1
    assert f'the parameters belong to the rig with the hash {OTHER.digest[:12]}' in said
