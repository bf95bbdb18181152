"""Claims on effects of the user's own folder: laws added to the load or to a reading."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from pushed import pushed
import pytest

from saddlering_ros import effects, rig
from saddlering_ros.bags.reader import read_run
from saddlering_ros.cli.main import build_parser, main
from saddlering_ros.discrepancy import Point
from saddlering_ros.effects import EffectError, use_folder
from saddlering_ros.effects.law import Law, LawHistory, read_law_effect
from saddlering_ros.rig import CHANNELS, default_rig, ParameterSet, TRUE_TO_SCALE, write_parameters
from saddlering_ros.ring.simulator import RingSimulator, simulate

RIG = default_rig()
TIME = np.arange(0.0, 3.0, 2e-3)
LOAD = np.interp(TIME, [0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 1.5e5, 2e4]) + RIG.preload
STEP = """\
id: seat_snaps
title: A seat snaps over
target: {target}
coordinate: {coordinate}
unit: m
turn: 2000.0
size: {{low: -1.0e-4, high: 1.0e-4, scale: 5.0e-6, start: 5.0e-6}}
table: {{at: [20000.0, 80000.0, 81000.0, 200000.0], values: [0.0, 0.0, 1.0, 1.0]}}
"""
IN_THE_LOAD = STEP.replace('1.0e-4', '1.0e+4').replace('5.0e-6', '5000.0')


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Write one effect file and take its folder."""
    monkeypatch.setenv(effects.FOLDER_VARIABLE, '')

    def write(target: str = 'delta_x', coordinate: str = 'load', text: str = STEP) -> Path:
        path = tmp_path / 'seat_snaps.yaml'
        path.write_text(text.format(target=target, coordinate=coordinate))
        use_folder(tmp_path)
        return path

    return write


def parameters(size: float | None = None) -> ParameterSet:
    values = {} if size is None else {'size': size}
    return ParameterSet(TRUE_TO_SCALE, {'seat_snaps': values})


def moved(extra: ParameterSet) -> np.ndarray:
    plain = simulate(RIG, ParameterSet(TRUE_TO_SCALE), 0.9, TIME, LOAD)
    return simulate(RIG, extra, 0.9, TIME, LOAD).probes - plain.probes


@pytest.mark.parametrize('target', CHANNELS)
def test_a_law_of_the_folder_is_added_to_its_channel_alone(folder, target: str) -> None:
    folder(target, text=STEP.replace('unit: m', 'unit: rad') if target == 'gamma' else STEP)
    change = rig.probes_to_displacement(RIG.probes, moved(parameters(2e-6)))
    for name in CHANNELS:
        highest = 2e-6 if name == target else 0.0
        assert getattr(change, name).max() == pytest.approx(highest, rel=1e-3, abs=1e-12), name


def test_a_law_in_the_load_is_felt_as_load(folder) -> None:
    folder('hydraulic_load', text=IN_THE_LOAD)
    felt = LOAD + np.interp(LOAD, [2e4, 8e4, 8.1e4, 2e5], [0.0, 0.0, 3e3, 3e3])
    expected = simulate(RIG, ParameterSet(TRUE_TO_SCALE), 0.9, TIME, felt)
    found = simulate(RIG, parameters(3e3), 0.9, TIME, LOAD)
    assert np.allclose(found.probes, expected.probes, atol=1e-12)


@pytest.mark.parametrize(
    'coordinate', ['load', 'direction', 'rate', 'time', 'hysteresis', 'relaxation'])
def test_live_equals_offline_bit_for_bit(folder, coordinate: str) -> None:
    folder('eddy_current_2', coordinate)
    whole = simulate(RIG, parameters(), 0.9, TIME, LOAD)
    live = RingSimulator(RIG, parameters(), 0.9)
    assert np.array_equal(pushed(live, TIME, LOAD)[1], whole.probes)


def test_a_direction_turns_after_the_load_turned_back_enough() -> None:
    law = Law('delta_x', 'direction', (0.0, 1e6), (1.0, 1.0), 2000.0)
    load = np.array([0.0, 5e3, 4e3, 2e3, 1e3])
    history = LawHistory(law, 0.0, 0.0)
    assert history.push(np.arange(5.0), load).tolist() == [0.0, 0.0, 0.0, -2.0, -2.0]


def test_a_rate_is_that_of_a_rising_load_once_its_filter_has_settled() -> None:
    law = Law('delta_x', 'rate', (-1e6, 1e6), (-1.0, 1.0), 2000.0)
    time = np.arange(0.0, 2.0, 1e-3)
    values = LawHistory(law, 0.0, 0.0).push(time, 2e5 * time)
    assert values[-1] == pytest.approx(0.2, rel=0.01)


def test_the_diagnosis_gets_the_effect_and_feels_a_law_in_the_load_as_load(folder, campaign):
    from saddlering_ros.diagnosis.records import build_record
    from saddlering_ros.diagnosis.ring_system import RingSystem

    assert 'seat_snaps' not in effects.catalogue()
    folder('hydraulic_load', text=IN_THE_LOAD)
    system, contact = RingSystem(RIG), TRUE_TO_SCALE.to_array()
    assert 'seat_snaps' in [effect.id for effect in system.effects]
    bag, = campaign(runs=['static_50'])
    run = build_record(RIG, read_run(bag), held_out=False).run
    grid = run.payload
    felt = grid.load + np.interp(grid.load, [2e4, 8e4, 8.1e4, 2e5], [0.0, 0.0, 3e3, 3e3])
    expected = system.predict_many(
        replace(run, payload=replace(grid, load=felt)), [Point(contact)])
    found = system.predict_many(run, [Point(contact, {'seat_snaps': {'size': 3e3}})])
    assert np.allclose(found, expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ('old', 'new', 'words'),
    [
        ('target: {target}', 'target: delta_z', "target is 'delta_z': choose from"),
        ('values: [0.0, 0.0, 1.0, 1.0]', 'values: [0.0, 1.0]', 'table: give 2 to 4096'),
        ('at: [20000.0, 80000.0', 'at: [90000.0, 80000.0', 'must rise'),
        ('values: [0.0, 0.0,', 'values: [0.0, .nan,', 'finite numbers'),
        ('scale: 5.0e-6', 'scale: 0.0', 'scale above zero'),
        ('size:', 'sizes:', 'size is missing'),
        ('id: seat_snaps', 'id: load_gain', 'the id load_gain is taken')])
def test_a_file_that_is_no_effect_is_refused_in_one_line(folder, old, new, words) -> None:
    with pytest.raises(EffectError, match=words) as refused:
        folder(text=STEP.replace(old, new))
    assert '\n' not in str(refused.value)


def test_a_folder_that_does_not_exist_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(EffectError, match='is no folder'):
        use_folder(tmp_path / 'nowhere')


@pytest.mark.parametrize('command', ['simulate', 'residual', 'validate', 'report', 'watch'])
def test_every_command_with_a_parameter_file_takes_the_folder_of_effects(command: str) -> None:
    parser, _ = build_parser()
    out = ['--out', 'page.html'] if command == 'report' else []
    args = parser.parse_args([command, 'bag', '--params', 'p.yaml', '--effects', 'own', *out])
    assert args.effects == Path('own')


def test_a_residual_uses_an_effect_of_the_folder(tmp_path, campaign, capsys, monkeypatch) -> None:
    monkeypatch.setenv(effects.FOLDER_VARIABLE, '')
    own = tmp_path / 'own'
    own.mkdir()
    (own / 'seat_snaps.yaml').write_text(STEP.format(target='delta_x', coordinate='load'))
    bag, = campaign(runs=['static_50'])
    write_parameters(tmp_path / 'extended.yaml', parameters(5e-6))
    command = ['residual', str(bag), '--params', str(tmp_path / 'extended.yaml')]
    assert main(command) == 2
    assert 'seat_snaps is not in the catalogue' in capsys.readouterr().err
    assert main([*command, '--effects', str(own)]) == 0


def test_a_proposed_law_becomes_a_file_that_gives_the_same_law(tmp_path: Path) -> None:
    from saddlering_ros.diagnosis.proposed_law import write_effect_files
    from saddlering_ros.discrepancy.law.proposal import LawProposal, Term

    at = np.linspace(0.0, 2e5, 65)
    values = 3e-6 * np.sin(at / 3e4)
    term = Term('delta_x', 'load', 'curve', 'a smooth curve', {}, at, values, 0.0 * at)
    law = LawProposal((term,), share=0.9, p_value=1e-9, reasons=())
    path, = write_effect_files(law, tmp_path / 'own', 2.4e5)
    effect = read_law_effect(path)
    bound = effect.bound(effect.complete({}))
    found = LawHistory(bound, 0.0, 0.0).push(np.arange(65.0), at)
    assert effect.id == 'proposed_delta_x_load'
    assert np.allclose(found, values - values[0], atol=1e-11)
