"""Claims about the `saddlering` command itself: statuses, one line on stderr, nothing else."""

import argparse
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from saddlering_ros.cli import main as command
from saddlering_ros.cli._arguments import finish
from saddlering_ros.errors import SaddleringError

ROOT = Path(__file__).resolve().parents[2]

ARGUMENTS = argparse.Namespace(command='try', traceback=False, signals=[])


def raising(error):
    def run(_args):
        raise error
    return run


def report(error, **arguments):
    return command.run_reporting(raising(error),
                                 argparse.Namespace(**{**vars(ARGUMENTS), **arguments}))


def done_by(*command, cwd=ROOT, **options):
    return subprocess.run(command, text=True, capture_output=True, cwd=cwd, timeout=60,
                          check=False, **options)


def saddlering(*arguments):
    return done_by(sys.executable, '-m', 'saddlering_ros.cli.main', *arguments)


def in_shell(line, **options):
    """`saddlering` with the rest of a line of bash."""
    return done_by('bash', '-c', f'"$0" -m saddlering_ros.cli.main {line}', sys.executable,
                   **options)


def test_a_done_command_returns_its_own_status():
    assert command.run_reporting(lambda _args: 0, ARGUMENTS) == 0


@pytest.mark.parametrize(('error', 'status', 'said'), [
    (SaddleringError('a.mcap: no samples; record it again'), 2,
     'a.mcap: no samples; record it again'),
    (SaddleringError('a.yaml: bad\n  line 3\n'), 2, 'a.yaml: bad line 3'),
    (PermissionError(13, 'Permission denied', 'a.yaml'), 2, 'a.yaml: Permission denied'),
    (FileNotFoundError(2, 'No such file', 'a.yaml'), 2, 'a.yaml: No such file'),
    (IsADirectoryError(21, 'Is a directory', 'a'), 2, 'a: Is a directory'),
    (ModuleNotFoundError("No module named 'rclpy'", name='rclpy'), 1,
     'Python package rclpy is not installed here; docs/install.md lists the requirements'),
    (ZeroDivisionError('division by zero'), 1,
     'failed: ZeroDivisionError: division by zero (--traceback shows the place)'),
    (KeyboardInterrupt(), 130, '')])
def test_an_error_is_one_line_and_its_status(capsys, error, status, said):
    assert report(error) == status
    assert capsys.readouterr() == ('', said and f'saddlering try: {said}\n')


def test_a_signal_that_an_import_turns_into_its_own_failure_ends_the_command(capsys):
    """Ctrl-C in the first half second: "failed: ImportError: initialization failed"."""
    assert report(ImportError('initialization failed'), signals=[signal.SIGTERM]) == 143
    assert capsys.readouterr() == ('', '')


def test_a_signal_leaves_its_number_for_a_failure_that_hides_it():
    done = ended('came = leave_by_exception()\n'
                 'try: os.kill(os.getpid(), signal.SIGTERM)\n'
                 'except SystemExit: os.write(1, str(came).encode())\n')
    assert (done.stdout, done.returncode) == ('[15]', 0)


@pytest.mark.parametrize('words', [
    'info bag --elevation 5_0', 'info bag --elevation ٥٠', 'plan --noise １',
    'diagnose bag --seed 1_0', 'generate out --test static --elevation 50 --set K1=1_0e8',
    'generate out --test static --elevation 50 --effect radial_friction=1_000',
    'identify bag --bounds n1=1_1:2', 'rig --draft x.yaml --set preload=1_0',
    'plan --test static:5_0', 'info bag --elevation=--', 'displacement bag --elevation=--'])
def test_a_number_in_other_than_decimal_digits_is_refused(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        status = command.main(words.split())
    except SystemExit as end:
        status = end.code
    said = capsys.readouterr().err
    assert (status, said.count('\n')) == (2, 1)
    assert 'no bag' not in said
    assert any(word in said for word in ('invalid', 'cannot be read', 'give', 'write'))
    assert os.listdir(tmp_path) == []


def test_traceback_shows_where(capsys):
    report(ZeroDivisionError('division by zero'), traceback=True)
    assert 'Traceback' in capsys.readouterr().err


def test_no_command_is_one_line_and_status_2():
    done = saddlering()
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr == (
        'saddlering: the following arguments are required: COMMAND; see saddlering --help\n')


def test_version_is_printed():
    done = saddlering('--version')
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout.startswith('saddlering 0.')


def test_every_command_of_the_contract_is_there():
    _, runs = command.build_parser()
    assert set(runs) >= {'info', 'displacement', 'simulate', 'identify', 'validate', 'diagnose',
                         'generate', 'demo'}


def test_a_reader_who_leaves_is_no_error():
    code = ('import sys, argparse; from saddlering_ros.cli.main import run_reporting\n'
            'def run(_args):\n'
            '    while True: print("line " * 1000)\n'
            'sys.exit(run_reporting(run, argparse.Namespace(command="try", traceback=False)))')
    child = subprocess.Popen([sys.executable, '-c', code], stdout=subprocess.PIPE,
                             stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert child.stdout is not None
    assert child.stderr is not None
    child.stdout.readline()
    child.stdout.close()
    assert child.stderr.read() == ''
    child.stderr.close()
    assert child.wait(30) == 141


@pytest.mark.parametrize(('number', 'status'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_that_is_repeated_closes_what_is_open(tmp_path, number, status):
    code = (
        'import pathlib, sys, time, types\n'
        'from saddlering_ros.cli import main as command\n'
        'def run(_args):\n'
        '    try:\n'
        f'        pathlib.Path({str(tmp_path / "running")!r}).touch()\n'
        '        time.sleep(30)\n'
        '    finally:\n'
        f'        pathlib.Path({str(tmp_path / "closing")!r}).touch()\n'
        f'        while not pathlib.Path({str(tmp_path / "repeated")!r}).exists():\n'
        '            time.sleep(0.01)\n'
        f'        pathlib.Path({str(tmp_path / "closed")!r}).touch()\n'
        'declared = command.arguments.Command("try", "", "", (), ())\n'
        'only = types.SimpleNamespace(COMMANDS=[declared], run=run)\n'
        'command.subcommand_modules = lambda: [only]\n'
        'sys.exit(command.main(["try"]))\n')
    child = subprocess.Popen([sys.executable, '-c', code], stderr=subprocess.PIPE, text=True,
                             cwd=ROOT)
    for state in ('running', 'closing'):
        while not (tmp_path / state).exists():
            assert child.poll() is None
            time.sleep(0.01)
        os.kill(child.pid, number)
    (tmp_path / 'repeated').touch()
    _, err = child.communicate(timeout=30)
    assert (child.returncode, err) == (status, '')
    assert (tmp_path / 'closed').exists()


def ended(code):
    """A program that has `leave_by_exception`, when it has ended."""
    head = 'import os, signal, time\nfrom saddlering_ros.cli.main import leave_by_exception\n'
    return done_by(sys.executable, '-c', head + code)


@pytest.mark.parametrize(('name', 'number', 'status'), [
    ('_numba_unpickle', 'SIGINT', -2), ('_numba_unpickle', 'SIGTERM', 143),
    ('_raw_object_cache_notify', 'SIGTERM', 143)])
def test_a_signal_waits_until_compiled_code_has_its_answer(name, number, status):
    done = ended(
        f'source = "def {name}(os, number):\\n'
        ' os.kill(os.getpid(), number)\\n os.write(1, b\'7\')"\n'
        'found = {}\n'
        'exec(compile(source, "/lib/numba/core/serialize.py", "exec"), found)\n'
        'leave_by_exception()\n'
        f'found["{name}"](os, signal.{number})\n'
        'time.sleep(30)\n')
    assert (done.stdout, done.returncode) == ('7', status)


def test_an_interrupt_while_the_command_imports_prints_nothing():
    code = ('import signal, sys\nsys.argv = ["/bin/saddlering"]\nimport saddlering_ros.cli\n'
            'signal.raise_signal(signal.SIGINT)\n')
    done = done_by(sys.executable, '-c', code)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, '')


def test_a_function_of_a_name_that_compiled_code_calls_is_left_at_once():
    done = ended(
        'leave_by_exception()\n'
        'def remove():\n os.kill(os.getpid(), signal.SIGTERM)\n os.write(1, b"7")\n'
        'remove()\n')
    assert (done.stdout, done.returncode) == ('', 143)


@pytest.mark.parametrize('made', ids=['its end', 'a weak reference'], argvalues=[
    'class Thing:\n def __del__(self): ended()\nthing = Thing()\ndel thing\n',
    'import weakref\nclass Thing: pass\nthings = weakref.WeakSet()\nclass Data(set):\n'
    ' def discard(self, item): ended()\nthings.data = Data()\nthing = Thing()\nthings.add(thing)\n'
    'del thing\n'])
def test_a_signal_at_the_end_of_an_object_is_not_lost(made):
    done = ended('leave_by_exception()\n'
                 f'def ended(): os.kill(os.getpid(), signal.SIGTERM)\n{made}time.sleep(30)\n')
    assert (done.returncode, done.stderr) == (143, '')


def test_with_standard_output_closed_a_command_still_ends_well(tmp_path):
    bag = ROOT / 'bags' / 'dynamic_50_fast'
    done = in_shell(f'info {bag} --json info.json >&-', cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, '')
    assert json.loads((tmp_path / 'info.json').read_text())


@pytest.mark.parametrize('place', [None, '-'])
def test_a_result_and_other_files_are_told_if_one_cannot_be_written(place, capsys):
    def full(*_, **__):
        raise SaddleringError('r.html: cannot be written (No space left on device)')
    result = SimpleNamespace(
        summary=lambda: 'verdict', to_json=lambda: {'verdict': 'none'}, write_report=full,
        save_parameters=lambda path: None)
    args = argparse.Namespace(json=place, out=Path('p.yaml'), report=Path('r.html'),
                              command_line='')
    with pytest.raises(SaddleringError, match='No space left'):
        finish(args, result)
    said = capsys.readouterr().out
    assert 'verdict' in said
    assert ('written: p.yaml' in said) == (place is None)


@pytest.mark.parametrize('place', [None, '-'])
def test_a_reader_that_is_gone_takes_no_file_away(place, monkeypatch):
    """`saddlering diagnose ... --report r.html | head -3` wrote no report, without a word."""
    written = []
    result = SimpleNamespace(
        summary=lambda: 'verdict', to_json=lambda: {'verdict': 'none'},
        write_report=lambda path, command: [written.append(path)])
    args = argparse.Namespace(json=place, report=Path('r.html'), command_line='')
    read_end, write_end = os.pipe()
    os.close(read_end)
    with open(write_end, 'w') as stream:
        monkeypatch.setattr('sys.stdout', stream)
        with pytest.raises(BrokenPipeError):
            finish(args, result)
        monkeypatch.undo()
        os.dup2(os.open(os.devnull, os.O_WRONLY), write_end)
    assert written == [Path('r.html')]


def test_info_writes_its_json_although_its_reader_is_gone(tmp_path):
    bag = ROOT / 'bags' / 'dynamic_50_fast'
    done = in_shell(f'info {bag} {bag} --json info.json | head -0; exit ${{PIPESTATUS[0]}}',
                    cwd=tmp_path)
    assert (done.returncode, done.stderr) == (141, '')
    assert len(json.loads((tmp_path / 'info.json').read_text())) == 2


@pytest.mark.parametrize(('words', 'said'), [
    (('displacement', 'bags/dynamic_50_fast', '--elevation', '5000'),
     'displacement: --elevation is 5000: give -10 to 90'),
    (('identify', 'bags/dynamic_50_fast', '--test', 'static'),
     'identify: bags/dynamic_50_fast: the load is held at')])
def test_a_refusal_names_what_was_typed_once(words, said):
    done = saddlering(*words)
    assert (done.returncode, done.stderr.count('\n')) == (2, 1)
    assert done.stderr.startswith(f'saddlering {said}')


@pytest.mark.parametrize('unbuffered', ['', '1'])
@pytest.mark.parametrize(('words', 'said'), [
    ('info bags/dynamic_50_fast', 'saddlering info'), ('--help', 'saddlering'),
    ('info --help', 'saddlering info'), ('--version', 'saddlering')])
def test_a_full_disk_behind_standard_output_is_told_as_such(words, said, unbuffered):
    done = in_shell(f'{words} > /dev/full',
                    env={**os.environ, 'PYTHONUNBUFFERED': unbuffered})
    assert done.returncode == 2
    assert done.stderr.startswith(f'{said}: No space left on device: standard output or the ')
    assert done.stderr.endswith('is full: choose another place\n')
    assert done.stderr.count('\n') == 1
