"""Claims about rig and parameter files: what is misspelt, doubled or no file is refused."""

import os
from pathlib import Path

import pytest

from saddlering_ros.rig import load_rig, read_parameters, RigError

SHIPPED = (Path(__file__).resolve().parents[2] / 'config' / 'rig.yaml').read_text()
CONTACT = ('/**:\n  ros__parameters:\n'
           '    contact: {K1: 1e8, n1: 1.1, D1: 3e6, K2: 1e8, n2: 1.1, D2: 3e6}\n')


def refusal(path: Path, text: str) -> str:
    path.write_text(text, encoding='utf-8')
    read = read_parameters if 'contact:' in text else load_rig
    with pytest.raises(RigError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert '\n' not in message
    return message


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('preload:', 'preloda:', 'rig has unknown entries (preloda): did you mean preload?'),
    ('polarity:', 'polarty:', 'rig.probes has unknown entries (polarty): did you mean polarity?'),
    ('    rig:', '    rigg:', 'has unknown entries (rigg): did you mean rig?'),
    ('bounds:', 'bound:', 'has unknown entries (bound): did you mean bounds?'),
    ('      K1:', '      k1:', 'bounds has unknown entries (k1): did you mean K1?'),
    ('rollers: 97', 'rollers: 97\n        rollers: 98',
     "line 8: the key 'rollers' is given twice in one section (first in line 7)"),
    ('rollers: 110', 'rollers: 0110', 'the number 0110 is not in plain decimal digits'),
    ('rollers: 110', 'rollers: 0x6e', 'the number 0x6e is not in plain decimal digits'),
    ('mass: 4079.0', 'mass: 1:30', 'the number 1:30 is not in plain decimal digits'),
    ('mass: 4079.0', 'mass: 4_079', 'the number 4_079 is not in plain decimal digits'),
    ('    rig:\n', '    rig.preload: 1.0\n    rig:\n', 'rig.preload is given twice: remove one'),
    ('mass: 4079.0', 'mass: &m 4079.0\n        inertia: *m', 'holds an alias'),
    ('    bounds:', '    elevation: 3\n    bounds:', 'has unknown entries (elevation)'),
    ('/**:', 'ring_simulator:\n  ros__parameters: {max_step: 1.0}\n/**:', 'for several nodes')])
def test_a_fault_in_a_rig_file_is_refused_with_its_place(tmp_path, old, new, words) -> None:
    assert old in SHIPPED
    assert words in refusal(tmp_path / 'rig.yaml', SHIPPED.replace(old, new, 1))


@pytest.mark.parametrize(('text', 'words'), [
    ('', 'is not a ROS 2 parameter file'),
    ('[1, 2]', 'is not a ROS 2 parameter file'),
    ('rig: {}', 'has no ros__parameters'),
    ('/**:\n  ros__parameters: {a: [}', 'line 2: is not YAML'),
    ('a: 2026-13-40', 'is not YAML (month must be in 1..12)'),
    ('/**:\n  ros__parameters: {a: 1}', 'there is no rig section')])
def test_a_file_of_another_shape_is_refused_in_one_line(tmp_path, text, words) -> None:
    assert words in refusal(tmp_path / 'rig.yaml', text)


@pytest.mark.parametrize(('line', 'words'), [
    ('effect: {probe_gain: {gain: 0.02}}', '(effect): did you mean effects?'),
    ('contact: {K1: 1e8}', "the key 'contact' is given twice"),
    ('contact.K3: 1e8', 'contact has unknown entries (K3)'),
    ('source: {methd: x}', 'source has unknown entries (methd): did you mean method?'),
    ('source: {bags: 3}', 'source.bags is 3.0: give a list of texts'),
    ('source: {sha256: 3}', 'source.sha256 is 3.0: give a list of texts'),
    ('source: [1]', 'source is [1]: give a section'),
    ('effects: 3\n    effects.probe_gain: 1', 'effects is given as a value and as a section'),
    ('effects: [3]\n    effects.probe_gain.gain: 1', 'effects is given as a value and as a'),
    ('effects.probe_gain.gain: 1\n    effects: 3', 'effects is given as a value and as a section'),
])
def test_a_fault_in_a_parameter_file_is_refused_with_its_place(tmp_path, line, words) -> None:
    text = f'{CONTACT}    {line}\n'
    assert words.replace('3.0', '3') in refusal(tmp_path / 'p.yaml', text).replace('3.0', '3')


@pytest.mark.parametrize('read', [load_rig, read_parameters])
def test_a_pipe_and_an_endless_device_are_refused_at_once(tmp_path: Path, read) -> None:
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    for path in (pipe, Path('/dev/zero')):
        with pytest.raises(RigError, match='give the path of a regular file'):
            read(path)


def test_a_file_that_becomes_a_pipe_is_refused_at_once(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / 'rig.yaml'
    path.write_text(SHIPPED)
    before = path.stat()
    path.unlink()
    os.mkfifo(path)
    monkeypatch.setattr(Path, 'stat', lambda self, **_: before)
    with pytest.raises(RigError, match='give the path of a regular file'):
        load_rig(path)


@pytest.mark.skipif(not os.access('/proc/kmsg', os.R_OK), reason='only root reads this file')
def test_a_file_that_waits_for_data_is_not_waited_for() -> None:
    with pytest.raises(RigError, match='cannot be read'):
        load_rig(Path('/proc/kmsg'))


@pytest.mark.parametrize('read', [load_rig, read_parameters])
def test_a_file_over_a_megabyte_is_refused_by_its_size(tmp_path: Path, read) -> None:
    path = tmp_path / 'rig.yaml'
    with path.open('wb') as file:
        file.truncate(3 << 30)
    with pytest.raises(RigError, match='is larger than 1 MB'):
        read(path)


def test_equal_rigs_have_one_hash_however_they_are_written(tmp_path: Path) -> None:
    path = tmp_path / 'rig.yaml'
    path.write_text(SHIPPED.replace('mass: 4079.0', 'mass: 4.079e+3').replace('1.0e+9', '2.0e+9'))
    assert load_rig(path).digest == load_rig(None).digest
    path.write_text(SHIPPED.replace('mass: 4079.0', 'mass: 4079.1'))
    assert load_rig(path).digest != load_rig(None).digest


def test_the_hash_of_the_default_rig_stays_what_bags_hold_already() -> None:
    assert load_rig(None).digest == (
        'd499bde85c27edc689457a26ad4fc20850e62c632de28847e63988a6589710fc')
