"""Claims about poor input: what the data allow is done, what they do not is said."""

from dataclasses import replace

import pytest

from saddlering_ros import diagnose, diagnosis
from saddlering_ros.bags.reader import read_run
from saddlering_ros.cli.main import main
from saddlering_ros.diagnosis import DiagnosisError
from saddlering_ros.diagnosis.records import build_record, check_set
from saddlering_ros.doubts import Finding
from saddlering_ros.errors import BagError
from saddlering_ros.rig import default_rig


def notes_of(bags) -> str:
    rig = default_rig()
    return ' / '.join(check_set([build_record(rig, read_run(bag), held_out=False)
                                 for bag in bags], rig))


def test_no_bags_is_an_error_in_one_line():
    with pytest.raises(DiagnosisError, match='at least one'):
        diagnosis.diagnose_ring([], rig=default_rig())


def test_a_load_that_never_rises_is_an_error_in_one_line(campaign):
    run = read_run(campaign()[2])
    with pytest.raises(DiagnosisError, match=r'no load exceeds 5\.0 t, a fifth of full scale'):
        diagnosis.diagnose_ring([replace(run, load=0.1 * run.load)], rig=default_rig())
    notes = [Finding('the load begins at 500 N', units='kgf or daN')]
    with pytest.raises(DiagnosisError, match=r'; the readings look like kgf or daN$'):
        diagnosis.diagnose_ring([replace(run, load=0.1 * run.load, notes=notes)],
                                rig=default_rig())


def test_a_bag_that_is_not_there_is_status_2_and_one_line(tmp_path, capsys):
    assert main(['diagnose', str(tmp_path / 'nothing')]) == 2
    told = capsys.readouterr().err.strip()
    assert len(told.splitlines()) == 1
    assert 'nothing' in told


def test_bags_held_out_must_be_bags(campaign, tmp_path):
    with pytest.raises(BagError):
        diagnose([campaign()[0]], hold_out=[tmp_path / 'nothing'])


@pytest.mark.slow
@pytest.mark.parametrize('run', ['static_50', 'dynamic_50'])
def test_one_clean_run_gives_no_cause_and_says_what_is_missing(campaign, run):
    verdict = diagnose(campaign(runs=[run])).found
    assert verdict.verdict == 'none'
    assert verdict.to_json()['causes'] == []
    assert 'one run only' in ' '.join(verdict.notes)
    assert 'one elevation only' in ' '.join(verdict.notes)


@pytest.mark.parametrize('kind', ['static', 'dynamic'])
def test_runs_of_one_kind_only_are_said_to_be_so(campaign, kind):
    notes = notes_of([bag for bag in campaign() if bag.name.startswith(kind)])
    assert f'{kind} runs only' in notes
    assert 'one elevation only' not in notes


def test_a_short_run_is_said_to_be_short(campaign):
    assert 'slower effects cannot show' in notes_of(campaign()[2:3])


def test_a_sound_dynamic_run_beside_static_ones_alone_shows_no_cause(campaign):
    """No static run determines the damping that it needs."""
    dynamic, *static = campaign(runs=('dynamic_50', 'static_50', 'static_70'), seed=7)
    found = diagnose(static, hold_out=[dynamic]).found
    assert (found.verdict, found.diagnosis.complete) == ('none', True)
    assert 'a held-out dynamic run is fitted, too' in ' '.join(found.notes)
    shown = found.to_json()['runs'][-1]['channels']['delta_x']
    assert shown['nrmse_after'] < 2.0 * shown['noise_floor']
