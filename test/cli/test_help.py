"""Claims about the command line: it teaches, completes, guesses, and keeps pipes plain."""

import json
import os
from pathlib import Path
import pty
import shlex
import subprocess
import sys

import pytest

from saddlering_ros.cli import main as command
from saddlering_ros.errors import did_you_mean
from saddlering_ros.ros.names import ACTION, names, REPLAY, TIME

ROOT = Path(__file__).resolve().parents[2]
PARSER, DECLARED = command.build_parser()
COMMANDS = sorted(DECLARED)


def help_of(name, capsys):
    with pytest.raises(SystemExit):
        PARSER.parse_args([name, '--help'])
    return capsys.readouterr().out


@pytest.mark.parametrize('name', COMMANDS)
def test_the_help_of_every_command_ends_with_examples_that_can_be_parsed(name, capsys):
    shown = help_of(name, capsys)
    assert 'examples:\n' in shown
    for line, words in DECLARED[name][0].examples:
        assert f'  # {words}\n  {line}\n' in shown
        assert PARSER.parse_args(shlex.split(line)[1:]).command == name


@pytest.mark.parametrize('name', COMMANDS)
def test_every_command_that_finds_something_can_say_it_in_json_on_stdout(name, capsys):
    shown = ' '.join(help_of(name, capsys).split())
    assert '--json FILE' in shown
    assert '- for stdout' in shown


@pytest.mark.parametrize(('words', 'hint'), [
    (['identfy', 'bag'], 'did you mean identify?'),
    (['simulate', 'bag', '--params', 'p', '--elevaton', '50'], 'did you mean --elevation?'),
    (['info', 'bag', '--test', 'statc'], 'did you mean static?'),
    (['generate', 'out', '--test', 'static', '--elevation', '50', '--effect',
      'radial_fricton=5000'], 'did you mean radial_friction?'),
    (['generate', '--effect', 'radial_fricton=5000'], 'did you mean radial_friction?')])
def test_what_is_mistyped_is_refused_in_one_line_with_what_was_meant(words, hint, capsys):
    try:
        status = command.main(words)
    except SystemExit as left:
        status = left.code
    said = capsys.readouterr()
    assert (status, said.out, said.err.count('\n')) == (2, '', 1)
    assert hint in said.err


def test_nothing_is_suggested_for_what_is_like_nothing():
    assert did_you_mean('xyz', ['identify', 'info']) == ''


def completed(line):
    """What the shell would be offered for a line, asked as argcomplete's shell code asks."""
    read, write = os.pipe()
    environment = {**os.environ, '_ARGCOMPLETE': '1', '_ARGCOMPLETE_IFS': '\n', 'COMP_LINE': line,
                   'COMP_POINT': str(len(line)), '_ARGCOMPLETE_SHELL': 'bash'}
    subprocess.run(
        ['bash', '-c', f'"$0" -m saddlering_ros.cli.main 8>&{write} 9>/dev/null', sys.executable],
        env=environment, cwd=ROOT, pass_fds=[write], timeout=60, check=False,
        stdout=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as answer:
        return answer.read().split()


@pytest.mark.parametrize(('line', 'offered'), [
    ('saddlering ident', {'identify'}),
    ('saddlering validate bag --test ', {'static', 'dynamic'}),
    ('saddlering generate out --eff', {'--effect'})])
def test_the_tab_key_completes_commands_options_and_choices(line, offered):
    assert offered <= set(completed(line))


def on_terminal(**extra):
    """What `saddlering info` writes on a terminal, with more in its environment."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, 'TERM': 'xterm-256color', **extra}
    child = subprocess.Popen(
        [sys.executable, '-m', 'saddlering_ros.cli.main', 'info', 'bags/dynamic_50_fast'],
        stdin=theirs, stdout=theirs, stderr=theirs, cwd=ROOT, env=environment)
    os.close(theirs)
    said = b''
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:
            break
        if not part:
            break
        said += part
    os.close(ours)
    assert child.wait(60) == 0
    return said


def test_colours_are_for_terminals_and_only_if_wanted():
    assert b'\x1b[32m' in on_terminal()
    assert b'\x1b[3' not in on_terminal(NO_COLOR='1')
    piped = subprocess.run(
        [sys.executable, '-m', 'saddlering_ros.cli.main', 'info', 'bags/dynamic_50_fast'],
        capture_output=True, cwd=ROOT, timeout=60, check=True)
    assert b'\x1b' not in piped.stdout + piped.stderr


def test_a_made_bag_is_told_in_json(tmp_path, capsys):
    out = tmp_path / 'made'
    assert command.main(['generate', str(out), '--test', 'dynamic', '--elevation', '50',
                         '--duration', '1', '--rate', '200', '--json', '-']) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told['bag'], told['test']) == (str(out), 'dynamic')
    assert told['load_samples'] > 100


def test_forces_and_lengths_are_printed_as_they_are_read_with_si_beside(capsys):
    assert command.main(['info', str(ROOT / 'bags' / 'dynamic_50_fast')]) == 0
    shown = ' '.join(capsys.readouterr().out.split())
    assert 't (4.80 to 237.10 kN)' in shown
    assert ' t ' in shown
    assert ' µm ' in shown


LIGHT = (*names(TIME, REPLAY, ACTION), 'ring_displacement')
"""Nodes that neither simulate nor judge: with SciPy and Numba, their start took twice as long."""


def test_help_info_and_campaigns_do_not_import_what_they_do_not_need():
    """A worker of a campaign imported matplotlib, which took two thirds of its start."""
    heavy = ('scipy', 'rosbags', 'matplotlib', 'numba', 'pyarrow')
    for statement, unwanted in (
            ("main(['--help'])", ('numpy', 'rich', 'importlib.metadata', 'rclpy', *heavy, 'mcap')),
            ("main(['info', 'bags/static_50'])", heavy),
            ('import saddlering_ros.campaign.task', heavy),
            (f'import {", ".join(f"saddlering_ros.nodes.{name}" for name in LIGHT)}', heavy)):
        program = ('import sys\nfrom saddlering_ros.cli.main import main\n'
                   f'try:\n    {statement}\nexcept SystemExit:\n    pass\n'
                   f'print([name for name in {unwanted!r} if name in sys.modules])')
        done = subprocess.run([sys.executable, '-S', '-c', _WITH_SITE + program], cwd=ROOT,
                              capture_output=True, text=True, check=True)
        assert done.stdout.splitlines()[-1] == '[]'


_WITH_SITE = f'import sys\nsys.path[:0] = {sys.path!r}\n'
"""The packages without what the environment imports at every start of Python."""


@pytest.mark.parametrize('name', COMMANDS)
def test_the_help_of_every_command_says_what_it_does_and_explains_each_option(name):
    action = next(one for one in PARSER._actions if one.dest == 'command')
    parser = action.choices[name]
    assert parser.description.endswith('.')
    assert [one.dest for one in parser._actions if not one.help] == []


@pytest.mark.parametrize(('words', 'hint'), [
    (['info', 'bags'], 'folder of 5: give bags/dynamic_50, '),
    (['info', 'docs/data/static_30.csv'], 'saddlering import docs/data/static_30.csv --draft'),
    (['generate', 'bags/static_50', '--test', 'static', '--elevation', '50'], 'give --overwrite'),
    (['import', 'docs/data/static_30.csv', '--map', 'docs/data/map_static_30.yaml', '--rig',
      'docs/data/rig.yaml', '--out', 'bags/static_50'], 'or give --overwrite'),
    (['rig', '--draft', 'new.yaml', '--set', 'axial_rows.rollers=2'],
     'saddlering rig: --set: rig.axial_rows.rollers is 2')])
def test_a_refusal_says_what_to_type(words, hint, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert command.main(words) == 2
    assert hint in capsys.readouterr().err


def test_a_plan_needs_no_folder_for_results(capsys):
    assert command.main(['campaign', str(ROOT / 'bags'), '--plan']) == 0
    assert '1 session of 1 ring, 5 bags' in capsys.readouterr().out
