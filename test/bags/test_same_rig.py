"""Claims about bags of another rig: asked about before anything is computed."""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path

import numpy as np
import pytest

from saddlering_ros.cli.main import main
from saddlering_ros.doubts import refuse_other_rig
from saddlering_ros.record import BagError, Record
from saddlering_ros.rig import default_rig

RIG = default_rig()
OTHER = replace(RIG, full_scale_load=98066.5)


def run_of(name: str = '', rig_hash: str = '') -> Record:
    return Record('a', Path('a'), 'static', math.radians(50.0), name, '', np.arange(3),
                   np.arange(3.0), np.arange(3.0), np.ones((4, 3)),
                   details={'rig_hash': rig_hash} if rig_hash else {})


def test_a_bag_of_another_rig_is_refused_with_what_to_do() -> None:
    for is_given, words in ((True, 'the given rig is another'), (False, 'no rig is given')):
        with pytest.raises(BagError) as caught:
            refuse_other_rig([run_of('SR-48', OTHER.digest)], RIG, is_given=is_given)
        message = str(caught.value)
        assert words in message
        assert "'SR-48'" in message
        assert OTHER.digest[:12] in message
        assert 'trust_rig=True' in message


def test_a_bag_of_the_same_rig_and_one_that_says_nothing_are_taken() -> None:
    runs = [run_of('SR-48', RIG.digest), run_of(), run_of('virtual rig')]
    refuse_other_rig(runs, RIG, is_given=False)
    assert not any(run.notes for run in runs)


def test_a_bag_that_only_names_its_rig_gets_a_note_where_no_file_is_given() -> None:
    run = run_of('SR-48')
    refuse_other_rig([run], RIG, is_given=False)
    assert "names the rig 'SR-48' and no rig file is given" in run.notes[0]


def test_a_forgotten_rig_file_costs_a_line_and_not_minutes(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = Path(__file__).resolve().parents[2] / 'docs' / 'data'
    bag = tmp_path / 'bag'
    assert main(['import', str(data / 'dynamic_30.csv'), '--map',
                 str(data / 'map_dynamic_30.yaml'), '--rig', str(data / 'rig.yaml'), '--out',
                 str(bag)]) == 0
    capsys.readouterr()
    for command in ('diagnose', 'identify'):
        assert main([command, str(bag)]) == 2
        assert 'no rig is given, and the shipped one is another' in capsys.readouterr().err
