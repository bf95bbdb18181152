"""What a result writes never replaces what it was made from."""

import os
from pathlib import Path
import shutil
from types import SimpleNamespace

import pytest

from saddlering_ros import read_bag
from saddlering_ros.api.functions import Curves
from saddlering_ros.api.inputs import ApiError, origins
from saddlering_ros.api.results import DiagnosisResult, Plot, Result, ValidationResult
from saddlering_ros.cli._arguments import check_files
from saddlering_ros.cli.main import build_parser
from saddlering_ros.files import FileConflict, Origin
from saddlering_ros.pages.charts import Chart
from saddlering_ros.rig import default_rig

ROOT = Path(__file__).resolve().parents[2]


class _Summary(Result):
    """A result without an analysis."""

    def summary(self):
        return 'a result'

    def columns(self):
        return {'value': [1.0]}

    def plot(self):
        raise NotImplementedError

    def _write_report(self, path, command):
        raise NotImplementedError

    def _document(self):
        return {'value': 1.0, 'provenance': {'files': []}}


@pytest.fixture
def place(tmp_path):
    shutil.copytree(ROOT / 'bags' / 'dynamic_50_fast', tmp_path / 'bag')
    (tmp_path / 'params.json').write_text('mine')
    return tmp_path


@pytest.mark.parametrize('name', ['bag/metadata.json', 'params.json', 'link.json', 'hard.json'])
def test_a_result_is_not_saved_over_its_inputs(place, name):
    rig = default_rig()
    (place / 'link.json').symlink_to(place / 'params.json')
    data = next((place / 'bag').glob('*.mcap'))
    os.link(data, place / 'hard.json')
    result = _Summary((read_bag(place / 'bag', rig=rig),), rig,
                      (Origin(str(place / 'params.json')),))
    before = data.read_bytes()
    with pytest.raises(FileConflict, match='choose'):
        result.save(place / name)
    assert data.read_bytes() == before
    assert (place / 'params.json').read_text() == 'mine'
    result.save(place / 'other.json')
    assert '"value": 1.0' in (place / 'other.json').read_text()


def test_an_effect_file_in_use_is_an_input(place, monkeypatch):
    effects = place / 'effects'
    effects.mkdir()
    own = effects / 'own.yaml'
    own.write_text('mine')
    monkeypatch.setenv('SADDLERING_EFFECTS', str(effects))
    rig = default_rig()
    made_from = origins()
    assert [item.path for item in made_from] == [str(own)]
    result = _Summary((read_bag(place / 'bag', rig=rig),), rig, made_from)
    (place / 'own.json').symlink_to(own)
    with pytest.raises(FileConflict, match='own'):
        result.save(place / 'own.json')
    args = build_parser()[0].parse_args(['info', 'bag', '--json', str(own)])
    with pytest.raises(FileConflict, match='SADDLERING_EFFECTS'):
        check_files(args)
    assert own.read_text() == 'mine'


def test_an_output_that_is_no_path_is_refused_in_one_line():
    result = _Summary((), default_rig(), ())
    with pytest.raises(ApiError, match='path is of type int'):
        result.save(3)
    with pytest.raises(ApiError, match='path is None'):
        Plot(Chart((), 4.0, 3.0), result._spare_inputs).save(None)
    with pytest.raises(ApiError, match='path is of type int'):
        Curves(*[None] * 12).save(3)
    for write in (ValidationResult((), default_rig(), (), None).save_plots,
                  DiagnosisResult((), default_rig(), (), None).with_effect_files):
        with pytest.raises(ApiError, match='folder is None'):
            write(None)


def test_a_plot_is_not_saved_over_an_input(place):
    rig = default_rig()
    picture = place / 'plot.png'
    picture.write_text('mine')
    result = _Summary((), rig, (Origin(str(picture)),))
    plot = Plot(Chart((), 4.0, 3.0), result._spare_inputs)
    with pytest.raises(FileConflict, match='plot'):
        plot.save(picture)
    plot.save(place / 'other.png')
    assert (place / 'other.png').read_bytes().startswith(b'\x89PNG')
    assert picture.read_text() == 'mine'


def test_pictures_and_effect_files_do_not_replace_inputs(place):
    rig = default_rig()
    bag = read_bag(place / 'bag', rig=rig)
    picture = place / '01_bag.png'
    picture.write_text('mine')
    run = SimpleNamespace(name='bag')
    with pytest.raises(FileConflict, match='bag'):
        ValidationResult((bag,), rig, (), SimpleNamespace(runs=[run])).save_plots(place / 'bag')
    with pytest.raises(FileConflict, match='01_bag'):
        ValidationResult((bag,), rig, (Origin(str(picture)),),
                         SimpleNamespace(runs=[run])).save_plots(place)
    term = SimpleNamespace(target='delta_x', coordinate='load', law='table')
    law = SimpleNamespace(terms=(term,))
    found = SimpleNamespace(diagnosis=SimpleNamespace(law=law), rig=rig)
    with pytest.raises(FileConflict, match='bag'):
        DiagnosisResult((bag,), rig, (), found).with_effect_files(place / 'bag')
    assert picture.read_text() == 'mine'
    assert sorted(path.name for path in (place / 'bag').iterdir()) == sorted(
        path.name for path in (ROOT / 'bags' / 'dynamic_50_fast').iterdir())


def test_a_table_of_causes_has_its_headings_without_a_cause(tmp_path):
    found = SimpleNamespace(to_json=lambda: {'verdict': 'none', 'causes': []})
    DiagnosisResult((), default_rig(), (), found).save(tmp_path / 'causes.csv')
    assert (tmp_path / 'causes.csv').read_text().startswith('cause,title,parameter,value,std,unit')
