"""Waves of the raceways as an entry of parameter files."""

import numpy as np
import pytest

from saddlering_ros.diagnosis.ring_wording import effect_rows
from saddlering_ros.effects import catalogue, effect, EffectError, extension_of
from saddlering_ros.effects.raceway_waves import as_effect, rms_of
from saddlering_ros.quantities import quantity
from saddlering_ros.rig import default_rig, ParameterSet, read_parameters, TRUE_TO_SCALE
from saddlering_ros.rig.parameter_file import write_parameters
from saddlering_ros.ring.simulator import simulate

WAVES = (1e-5 * np.sin(np.arange(48.0))).reshape(3, 16).tolist()


def test_no_diagnosis_searches_waves_but_every_simulation_knows_them():
    assert 'raceway_waves' not in catalogue()
    assert effect('raceway_waves').title == 'Waves of the raceways'
    extension = extension_of(as_effect(WAVES))
    assert [list(row.waves) for row in (
        extension.upper_row, extension.lower_row, extension.radial_row)] == WAVES


def test_a_parameter_file_with_waves_simulates_the_same_ring(tmp_path):
    rig = default_rig()
    time = np.arange(0.0, 4.0, 0.01)
    load = np.interp(time, [0.0, 2.0, 4.0], [rig.preload, rig.preload, rig.full_scale_load])
    wavy = ParameterSet(TRUE_TO_SCALE, as_effect(WAVES))
    write_parameters(tmp_path / 'wavy.yaml', wavy)
    even, before, after = (
        simulate(rig, parameters, 0.8, time, load).displacement.delta_y
        for parameters in (ParameterSet(TRUE_TO_SCALE), wavy,
                           read_parameters(tmp_path / 'wavy.yaml')))
    assert np.array_equal(before, after)
    assert np.ptp(before - even) > 0.01 * np.ptp(even)


def test_a_wave_that_does_not_exist_or_is_too_large_is_refused():
    with pytest.raises(EffectError, match='upper_cosine_9 does not exist'):
        extension_of({'raceway_waves': {'upper_cosine_9': 1e-6}})
    with pytest.raises(EffectError, match='give a number from'):
        extension_of({'raceway_waves': {'upper_cosine_1': 1.0}})


def test_the_size_of_a_row_is_the_rms_of_its_gap():
    angle = np.linspace(0.0, 2.0 * np.pi, 1000, endpoint=False)
    gap = 3e-6 * np.cos(angle) - 4e-6 * np.sin(2.0 * angle)
    waves = [3e-6, 0.0, 0.0, -4e-6]
    assert rms_of([waves, [0.0] * 4, waves]) == {
        'upper': pytest.approx(np.sqrt(np.mean(gap**2))), 'lower': 0.0,
        'radial': pytest.approx(np.sqrt(np.mean(gap**2)))}
    assert rms_of(()) == {} == as_effect(())


def test_a_reader_sees_the_rms_of_each_row_and_not_48_amplitudes():
    effects = {'load_gain': {'gain': 0.02}, **as_effect(WAVES)}
    assert effect_rows(effects) == [
        ['load_gain.gain', '+2.00 %'],
        *([f'raceway_waves.{row}', quantity(size, 'm')] for row, size in rms_of(WAVES).items())]
