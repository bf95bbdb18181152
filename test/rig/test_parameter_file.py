"""Claims about parameter files: they come back as they were, whole or not at all."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
import yaml

from saddlering_ros import rig
from saddlering_ros.rig import ParameterSet, RigError, TRUE_TO_SCALE, write_parameters
from saddlering_ros.rig.parameter_file import parameters_from_mapping, parameters_to_mapping

FULL = ParameterSet(
    TRUE_TO_SCALE, {'radial_friction': {'force': 1.5e3, 'presliding': 2e-6}},
    rig.ParameterSource('swarm', ('bags/static_50', 'bags/dynamic_50'), 1.25e-3,
                        np.arange(36.0).reshape(6, 6) * 1e-7, 'made for a test'))


def test_a_parameter_set_comes_back_from_its_file_to_the_last_bit(tmp_path: Path) -> None:
    write_parameters(tmp_path / 'p.yaml', FULL)
    back = rig.read_parameters(tmp_path / 'p.yaml')
    assert back.contact == FULL.contact
    assert back.effects == FULL.effects
    assert np.array_equal(back.source.covariance, FULL.source.covariance)
    assert (back.source.method, back.source.bags) == (FULL.source.method, FULL.source.bags)
    assert (back.source.objective, back.source.note) == (1.25e-3, 'made for a test')


positive = st.floats(1e-300, 1e300)
exponent = st.floats(0.5, 5.0)


@given(st.tuples(positive, exponent, st.floats(0.0, 1e300),
                 positive, exponent, st.floats(0.0, 1e300)))
def test_every_contact_law_survives_writing_and_reading(values) -> None:
    law = rig.ContactParameters.from_array(values)
    mapping = parameters_to_mapping(ParameterSet(law))['contact']
    assert parameters_from_mapping({'contact': mapping}, 'p').contact == law


def test_what_is_written_are_floats_to_any_yaml_reader(tmp_path: Path) -> None:
    write_parameters(tmp_path / 'p.yaml', FULL)
    document = yaml.safe_load((tmp_path / 'p.yaml').read_text(encoding='utf-8'))
    contact = document['/**']['ros__parameters']['contact']
    assert len(contact) == 6
    assert all(isinstance(value, float) for value in contact.values())


def test_stiffness_stands_beside_in_the_unit_that_adams_users_know(tmp_path: Path) -> None:
    source = parameters_to_mapping(ParameterSet(TRUE_TO_SCALE))['source']
    assert source['K1_in_N_per_mm_n'] == pytest.approx(6e4)


def test_a_covariance_with_a_nan_is_left_out_rather_than_written() -> None:
    source = rig.ParameterSource(covariance=np.full((6, 6), np.nan))
    mapping = parameters_to_mapping(ParameterSet(TRUE_TO_SCALE, {}, source))
    assert 'covariance' not in mapping['source']


CONTACT = 'contact: {K1: 1e8, n1: 1.1, D1: 3e6, K2: 1e8, n2: 1.1, D2: 3e6}'


@pytest.mark.parametrize(('body', 'words'), [
    ('other: 1', 'there is no contact section'),
    ('contact: {K1: 1e8}', 'contact.n1 is missing'),
    (CONTACT.replace('1e8', '-1e8', 1), 'contact.K1 is -100000000.0'),
    (CONTACT.replace('1e8', 'stiff', 1), "contact.K1 is 'stiff'"),
    (CONTACT.replace('3e6', '.nan', 1), 'contact.D1 is nan'),
    (CONTACT + '\n    effects: [1]', 'effects'),
    (CONTACT + '\n    effects: {settling: {amount: much}}', 'effects.settling.amount'),
    (CONTACT + '\n    source: {covariance: [1, 2]}', 'source.covariance has no 36 numbers')])
def test_a_fault_is_told_in_one_line_with_file_and_entry(tmp_path, body, words) -> None:
    path = tmp_path / 'p.yaml'
    path.write_text(f'/**:\n  ros__parameters:\n    {body}\n', encoding='utf-8')
    with pytest.raises(RigError) as caught:
        rig.read_parameters(path)
    message = str(caught.value)
    assert words in message
    assert str(path) in message
    assert ': give ' in message or ': add ' in message
    assert '\n' not in message


def test_contact_parameters_need_six_numbers() -> None:
    with pytest.raises(RigError, match='six numbers'):
        rig.ContactParameters.from_array([1.0, 2.0])


def test_a_place_that_is_no_folder_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(RigError, match='choose another place'):
        write_parameters(tmp_path / 'file' / 'p.yaml', FULL)


def test_a_hash_that_begins_like_a_binary_number_is_read_again(tmp_path):
    digest = '0b7772d5c8359d7e6fa4f89b173757c7dd88c68592bced24c42b124620ee154d'
    source = rig.ParameterSource(method='given', bags=('a',), sha256=(digest,))
    write_parameters(tmp_path / 'p.yaml', ParameterSet(TRUE_TO_SCALE, {}, source))
    assert rig.read_parameters(tmp_path / 'p.yaml').source.sha256 == (digest,)


def test_names_of_digits_come_back_from_a_file_as_they_were(tmp_path: Path) -> None:
    source = rig.ParameterSource('diagnose', ('20250101', '1e5'), note='7')
    write_parameters(tmp_path / 'found.yaml', ParameterSet(TRUE_TO_SCALE, {}, source))
    assert rig.read_parameters(tmp_path / 'found.yaml').source == source
