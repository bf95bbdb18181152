"""Claims about the public Python API: names, imports, results, progress and cancel."""

import ast
import csv
from dataclasses import replace
import inspect
import json
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent.parent / 'identification'))
from identification_records import dynamic_run, RIG, static_run

import saddlering_ros
from saddlering_ros import (
    Bag,
    Cancelled,
    displacement,
    identify,
    Progress,
    read_bag,
    read_parameters,
    residual,
    SaddleringError,
    show_progress,
    simulate,
    validate,
)
from saddlering_ros.api.inputs import frame
from saddlering_ros.bags.write import write_bag
from saddlering_ros.identification.settings import IdentificationSettings, SwarmSettings
from saddlering_ros.record.record import TestMetadata

QUICK = {'particles': 8, 'iterations': 6, 'seed': 1}


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp('bags')
    paths = []
    for run in (static_run(50.0, seed=1), dynamic_run(50.0, seconds=3.0, seed=2)):
        facts = TestMetadata(run.test, float(np.degrees(run.elevation)))
        paths.append(write_bag(folder / run.name, facts, run.stamps, run.load, [run.stamps] * 4,
                               list(run.gaps), RIG.probes))
    return [read_bag(path) for path in paths]


@pytest.fixture(scope='module')
def reports():
    return []


@pytest.fixture(scope='module')
def found(bags, reports):
    return identify(bags, on_progress=reports.append, **QUICK)


@pytest.fixture(scope='module')
def judged(bags, found):
    return validate(bags, parameters=found)


def test_importing_the_package_imports_nothing_heavy():
    script = ('import sys, saddlering_ros; saddlering_ros.__version__; '
              'print(*({"numpy", "scipy", "numba", "yaml", "rclpy"} & set(sys.modules)))')
    answer = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                            check=True)
    assert answer.stdout.split() == []


def test_every_public_name_is_there_and_has_a_docstring():
    for name in set(saddlering_ros.__all__) - {'__version__'}:
        assert inspect.getdoc(getattr(saddlering_ros, name)), name
    with pytest.raises(AttributeError, match='no_such_name'):
        _ = saddlering_ros.no_such_name


def test_names_for_type_checkers_are_the_names_that_are_loaded():
    tree = ast.parse(inspect.getsource(saddlering_ros))
    guarded = next(item for item in tree.body if isinstance(item, ast.If))
    typed = {alias.name for item in guarded.body for alias in item.names}
    assert typed == set(saddlering_ros._PLACES) == set(saddlering_ros.__all__) - {'__version__'}


@pytest.mark.parametrize('name', ['identify', 'validate', 'diagnose', 'read_bag', 'displacement',
                                  'simulate', 'residual'])
def test_options_are_keywords_only(name):
    first, *rest = inspect.signature(getattr(saddlering_ros, name)).parameters.values()
    assert first.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
    assert all(item.kind is inspect.Parameter.KEYWORD_ONLY for item in rest)


def test_a_bag_is_read_once_and_passed_on(bags, found, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError('read again')
    monkeypatch.setattr('saddlering_ros.api.inputs.read_run', refuse)
    assert validate(bags, parameters=found).bags == tuple(bags)


def test_a_bag_shows_what_it_is(bags):
    assert isinstance(bags[0], Bag)
    assert bags[0].summary().startswith(f'{bags[0].name}: static test at 50 deg')
    assert list(bags[0].columns())[:3] == ['stamp_ns', 'time', 'load']


def test_progress_is_reported_in_one_form(reports, found):
    assert all(isinstance(item, Progress) and item.task == 'identify' for item in reports)
    assert all(0.0 <= item.share <= 1.0 for item in reports)
    assert reports[-1].stage == 'intervals'


def test_a_cancelled_identification_raises_with_what_it_had(bags):
    with pytest.raises(Cancelled) as stopped:
        identify(bags, is_cancelled=lambda: True, **QUICK)
    assert stopped.value.partial.found.cancelled


def test_a_cancelled_validation_raises_the_same_class(bags, found):
    with pytest.raises(Cancelled):
        validate(bags, parameters=found, is_cancelled=lambda: True)


def test_parameters_are_a_row_each_and_a_file(found, tmp_path):
    columns = found.columns()
    assert columns['parameter'] == ['K1', 'n1', 'D1', 'K2', 'n2', 'D2']
    assert columns['value'][0] == found.parameters.contact.K1
    found.save(tmp_path / 'found.yaml')
    assert read_parameters(tmp_path / 'found.yaml').contact == found.parameters.contact


def test_results_are_saved_as_their_name_ends(judged, tmp_path):
    judged.save(tmp_path / 'all.json')
    assert json.loads((tmp_path / 'all.json').read_text()) == json.loads(
        json.dumps(judged.to_json()))
    judged.save(tmp_path / 'table.csv')
    with (tmp_path / 'table.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8
    assert float(rows[0]['rmse']) == judged.found.runs[0].channels['delta_x'].rmse
    with pytest.raises(SaddleringError, match=r'end the name with \.png, \.svg, \.pdf$'):
        judged.plot().save(tmp_path / 'plot.txt')
    for name in ('all.txt', 'law.yaml'):
        with pytest.raises(SaddleringError, match=r'end the name with \.json, \.csv$'):
            judged.save(tmp_path / name)


def test_results_show_themselves_in_a_notebook(found, judged, bags):
    assert '<table' in found._repr_html_()
    assert 'delta_x' in judged._repr_html_()
    assert 'static test' in bags[0]._repr_html_()
    assert judged.plot()._repr_png_().startswith(b'\x89PNG')


def test_a_result_is_printed_as_its_summary_and_shown_as_one_line(found, bags):
    assert str(found) == found.summary()
    assert repr(found).startswith('<IdentificationResult Identification (default method) from 2')
    assert repr(bags[0]).startswith('<Bag ')
    assert '\n' not in repr(found) + repr(bags[0])


@pytest.mark.parametrize('path', ['', '.'])
def test_a_folder_in_place_of_a_report_is_refused(judged, tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SaddleringError, match='is a directory: give the name of a file'):
        judged.write_report(path)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures('no_pictures')
def test_a_report_is_written(judged, tmp_path):
    judged.write_report(tmp_path / 'page.html', command='python mine.py')
    assert 'python mine.py' in (tmp_path / 'page.html').read_text()


@pytest.mark.parametrize('library', ['pandas', 'polars'])
def test_a_frame_needs_its_library_and_the_error_names_it(monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(SaddleringError, match=f'pip install {library}'):
        frame(library, {'a': [1]})


def test_a_result_has_tables_by_name_and_refuses_others(judged):
    curves = judged.table('curves')
    assert {'time_s', 'load_N', 'delta_x_measured', 'delta_x_simulated'} <= set(curves)
    assert len({len(values) for values in curves.values()}) == 1
    assert judged.table() == judged.columns()
    with pytest.raises(SaddleringError, match='give one of curves'):
        judged.table('candidates')


def test_progress_is_one_line_that_ends(capsys):
    show_progress(Progress('identify', 'swarm', 0.5))
    show_progress(Progress('identify', 'refinement', 1.0))
    printed = capsys.readouterr().out
    assert printed.count('\n') == 1
    assert printed.split('\r')[-1].startswith('refinement: ####################')


def test_parameters_of_another_rig_are_refused_unless_the_rig_is_trusted(bags, found, tmp_path):
    rig = saddlering_ros.load_rig()
    assert found.parameters.source.rig_hash == rig.digest
    file = tmp_path / 'params.yaml'
    found.save(file)
    text = file.read_text().replace(rig.digest, 'f' * 64)
    file.write_text(text)
    with pytest.raises(SaddleringError, match='belong to the rig with the hash ffff'):
        saddlering_ros.validate(bags, parameters=file)
    assert saddlering_ros.validate(bags, parameters=file, trust_rig=True)


def another_rig():
    return replace(saddlering_ros.load_rig(), full_scale_load=2.6e5)


def test_a_bag_remembers_the_rig_with_which_it_was_read(bags):
    mine = another_rig()
    seen = [Bag(bag.run, mine) for bag in bags]
    assert identify(seen, **QUICK).rig is mine


def test_another_rig_in_the_call_is_refused_unless_it_is_trusted(bags, found):
    with pytest.raises(SaddleringError, match='was read with the rig with the hash'):
        validate(bags, parameters=found, rig=another_rig())
    with pytest.raises(SaddleringError, match='different rigs'):
        identify([bags[0], Bag(bags[1].run, another_rig())])
    trusted = validate(bags, parameters=found, rig=another_rig(), trust_rig=True)
    assert trusted.rig.full_scale_load == 2.6e5


def test_a_message_names_the_arguments_and_not_the_options_of_a_command(bags, found):
    with pytest.raises(SaddleringError) as refused:
        validate(bags[0].path, parameters=found, rig=another_rig())
    assert 'rig=FILE' in str(refused.value)
    assert '--' not in str(refused.value)


def test_options_of_an_identification_may_be_one_object(bags, found):
    settings = IdentificationSettings(swarm=SwarmSettings(particles=8, iterations=6), seed=1)
    assert identify(bags, settings=settings).parameters.contact == found.parameters.contact


def test_the_residual_is_measured_minus_simulated_at_the_same_stamps(bags, found):
    bag = bags[1]
    measured, simulated = displacement(bag), simulate(bag, parameters=found)
    left = residual(bag, parameters=found)
    for name in ('delta_x', 'delta_y', 'gamma', 'parity'):
        here, there = (getattr(one, name)[np.isin(one.stamp_ns, left.stamp_ns)]
                       for one in (measured, simulated))
        assert np.array_equal(getattr(left, name), here - there, equal_nan=True)
    assert len(left) > 2000


def test_curves_note_the_parameters_that_their_data_leave_open(bags, found):
    """The commands alone did so: an undetermined D moved a dynamic simulation without a word."""
    law = found.parameters
    law = replace(law, source=replace(law.source, undetermined={'D2': 'why'}))
    for curves in (simulate, residual):
        assert any('do not determine D2: where' in note
                   for note in curves(bags[1], parameters=law).notes)


def test_curves_are_arrays_a_table_a_file_and_a_figure(bags, tmp_path):
    curves = displacement(bags[1])
    assert list(curves.columns()) == ['stamp_ns', 'time', 'load', 'delta_x', 'delta_y', 'gamma',
                                      'parity', 'validity']
    assert np.array_equal(curves.delta_x, bags[1].columns()['delta_x'])
    doubted = replace(bags[1], run=replace(bags[1].run, notes=['a doubt']))
    assert displacement(doubted).notes == ('a doubt',)
    curves.save(tmp_path / 'curves.csv')
    assert len((tmp_path / 'curves.csv').read_text().splitlines()) == len(curves) + 1
    assert curves.plot()._repr_png_().startswith(b'\x89PNG')
    with pytest.raises(SaddleringError):
        curves.save(bags[1].path / 'metadata.yaml')


def test_curves_report_progress_and_can_be_cancelled(bags, found):
    seen = []
    simulate(bags[1], parameters=found, on_progress=seen.append)
    assert seen[-1].share == 1.0
    with pytest.raises(Cancelled):
        simulate(bags[1], parameters=found, is_cancelled=lambda: True)
