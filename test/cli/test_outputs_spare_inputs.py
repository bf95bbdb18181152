"""Claims about outputs: none replaces what a command reads, by whatever name or link."""

import argparse
from collections.abc import Iterator
from functools import cache
import os
from pathlib import Path
import shutil

import pytest

from saddlering_ros.cli._arguments import bags_below, folder_filled, OneLineParser, Role
from saddlering_ros.cli.main import build_parser, main
from saddlering_ros.files import share_directory
from saddlering_ros.rig import ParameterSet, TRUE_TO_SCALE, write_parameters

SHIPPED = share_directory() / 'bags' / 'dynamic_50_fast'
WORDS_OF_PATHS = ('FILE', 'DIR', 'FOLDER', 'OUT', 'BAG')


@cache
def commands() -> dict[str, OneLineParser]:
    parser, _ = build_parser()
    choices = next(action.choices for action in parser._actions
                   if isinstance(action, argparse._SubParsersAction))
    return dict(choices)


def cases() -> Iterator[tuple[str, argparse.Action, argparse.Action]]:
    """Each (command, output, input) that there is."""
    for name, parser in commands().items():
        paths = [action for action in parser._actions if isinstance(action.type, Role)]
        for output in paths:
            for read in paths:
                if output.type.is_written and not read.type.is_written:
                    yield name, output, read


def test_every_argument_that_names_a_path_declares_what_becomes_of_it() -> None:
    undeclared = {(name, action.dest) for name, parser in commands().items()
                  for action in parser._actions
                  if action.type is Path or (not isinstance(action.type, Role) and any(
                      word in str(action.metavar or '') for word in WORDS_OF_PATHS))}
    assert not undeclared


def words(command: str, given: dict[str, Path]) -> list[str]:
    """A command line with these arguments, and with what else the command asks for."""
    line = [command]
    for action in commands()[command]._actions:
        if action.dest in given or action.required:
            value = given.get(action.dest, Path('elsewhere'))
            line += [*action.option_strings[-1:], str(value)]
    return line


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    shutil.copytree(SHIPPED, tmp_path / 'own')
    return tmp_path / 'own'


def kept(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob('*')) if path.is_file()}


@pytest.mark.parametrize(
    ('command', 'output', 'read'), list(cases()), ids=lambda one: getattr(one, 'dest', one))
def test_no_command_takes_an_input_for_an_output(
        command: str, output: argparse.Action, read: argparse.Action, bag: Path, tmp_path: Path,
        capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'file.yaml').write_text('rig: {}')
    before = kept(tmp_path)
    if read.type.is_bag:
        source = tmp_path if read.type is bags_below else bag
        target = bag / 'metadata.yaml'
    else:
        source = target = tmp_path / 'file.yaml'
    assert main(words(command, {read.dest: source, output.dest: target})) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1
    assert 'is read' in said
    assert kept(tmp_path) == before


@pytest.mark.parametrize('make', [
    lambda bag, link: link.symlink_to(bag / 'metadata.yaml'),
    lambda bag, link: os.link(bag / 'metadata.yaml', link),
], ids=['symbolic', 'hard'])
def test_a_link_to_a_file_of_the_bag_is_no_output(bag: Path, tmp_path: Path, make) -> None:
    make(bag, tmp_path / 'link.json')
    before = kept(tmp_path)
    assert main(['info', str(bag), '--json', str(tmp_path / 'link.json')]) == 2
    assert kept(tmp_path) == before


def test_a_linked_folder_of_the_bag_takes_no_output(bag: Path, tmp_path: Path) -> None:
    (tmp_path / 'link').symlink_to(bag)
    assert main(['info', str(bag), '--json', str(tmp_path / 'link' / 'new.json')]) == 2
    assert main(['info', str(tmp_path / 'link'), '--json', str(bag / 'new.json')]) == 2
    assert main(['info', str(next(bag.glob('*.mcap'))), '--json', str(bag / 'new.json')]) == 2
    assert not (bag / 'new.json').exists()


def test_two_outputs_are_not_one_file(bag: Path, tmp_path: Path) -> None:
    out = str(tmp_path / 'one.json')
    assert main(['displacement', str(bag), '--out', out, '--json', out]) == 2
    assert not Path(out).exists()


def test_a_folder_that_holds_an_input_is_not_replaced(bag: Path, tmp_path: Path) -> None:
    (bag / 'p.yaml').write_text('precious')
    assert main(['generate', str(bag), '--test', 'dynamic', '--elevation', '50', '--overwrite',
                 '--params', str(bag / 'p.yaml')]) == 2
    assert (bag / 'p.yaml').read_text() == 'precious'


@pytest.mark.parametrize('line', [
    'report BAG --params p.yaml --out r.pdf', 'diagnose BAG --report r.docx',
    'validate BAG --params p.yaml --report r.png', 'identify BAG --report r.json'])
def test_a_page_is_not_written_under_the_name_of_another_format(line, bag, tmp_path, capsys):
    assert main([str(bag) if word == 'BAG' else word for word in line.split()]) == 2
    assert 'give a name that ends in .html' in capsys.readouterr().err


def test_an_output_beside_the_bag_is_written(bag: Path, tmp_path: Path) -> None:
    assert main(['info', str(bag), '--json', str(tmp_path / 'own.json')]) == 0
    assert (tmp_path / 'own.json').exists()


def test_an_effect_file_of_a_folder_that_is_read_is_no_output(bag, tmp_path, capsys) -> None:
    effect = tmp_path / 'mine' / 'snap.yaml'
    effect.parent.mkdir()
    effect.write_text('precious')
    (tmp_path / 'link.json').symlink_to(effect)
    for output in (effect, tmp_path / 'link.json'):
        assert main(['diagnose', str(bag), '--effects', str(effect.parent),
                     '--json', str(output)]) == 2
        assert 'is the file that is read as --effects' in capsys.readouterr().err
    assert effect.read_text() == 'precious'


@pytest.mark.parametrize('option', ['--json', '--preview', '--out'])
def test_a_calibration_table_of_a_map_is_no_output(option, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    columns = ['t', 'load', *(f's{probe}' for probe in range(1, 5))]
    rows = [f'{0.01 * row:.2f},{row},1,1,1,1' for row in range(50)]
    Path('data.csv').write_text('\n'.join([','.join(columns), *rows]))
    Path('table.png').write_text('V,mm\n0,0\n5,2\n')
    probes = ''.join(f'  eddy_current_{probe}: {{column: s{probe}, unit: V, table: table.png, '
                     'range: [0, 0.002]}\n' for probe in range(1, 5))
    Path('map.yaml').write_text(
        'time: {column: t, unit: s, start: "2026-11-20T08:00:00Z"}\nchannels:\n'
        f'  hydraulic_load: {{column: load, unit: kN}}\n{probes}'
        'test: {test: dynamic, elevation_deg: 50}\n')
    given = {'--out': 'bag', option: 'table.png'}
    options = [word for pair in given.items() for word in pair]
    assert main(['import', 'data.csv', '--map', 'map.yaml', *options, '--overwrite']) == 2
    assert 'table.png is the file that is read' in capsys.readouterr().err
    assert Path('table.png').read_text().startswith('V,mm')


@pytest.mark.parametrize('option', ['--params', '--rig'])
def test_a_pipe_given_as_a_file_is_refused_and_not_waited_for(option, bag, tmp_path, capsys):
    os.mkfifo(tmp_path / 'pipe')
    write_parameters(tmp_path / 'p.yaml', ParameterSet(TRUE_TO_SCALE))
    given = {'--params': tmp_path / 'p.yaml', option: tmp_path / 'pipe'}
    options = [str(word) for pair in given.items() for word in pair]
    assert main(['report', str(bag), *options, '--out', str(tmp_path / 'r.html')]) == 2
    assert 'give the path of a regular file' in capsys.readouterr().err


OUTPUTS = [(name, action) for name, parser in commands().items() for action in parser._actions
           if isinstance(action.type, Role) and action.type.is_written]


@pytest.mark.parametrize(('command', 'output'), OUTPUTS, ids=lambda one: getattr(one, 'dest', one))
def test_a_place_that_cannot_be_written_is_named_before_any_work(
        command: str, output: argparse.Action, tmp_path: Path,
        capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The inputs do not exist, and what is named is the output."""
    monkeypatch.chdir(tmp_path)
    Path('text').write_text('mine')
    Path('folder.html').mkdir()
    places = [('text/out.html', 'text is not a folder: choose another place')]
    if not (output.type.is_bag or output.type is folder_filled):
        places += [('folder.html', 'is a directory: give the name of a file')]
    for place, said in places:
        assert main(words(command, {output.dest: Path(place)})) == 2
        assert f'{place}: {said}' in capsys.readouterr().err
    assert main(words(command, {output.dest: Path('/proc/new/out.html')})) == 2
    assert ': /proc cannot be written to (No such file or dir' in capsys.readouterr().err
    assert sorted(os.listdir()) == ['folder.html', 'text']
