"""Claims about the certificates of a rig's instruments: their entries, and what they change."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.rig import default_rig, Instruments, RigError
from saddlering_ros.rig.instruments import difference_of, instruments_from, NAMES, stated_by
from saddlering_ros.ring.small_errors import CERTIFIED, certified_errors

RIG = default_rig()
STATED = dict.fromkeys(NAMES, 0.001)


def test_one_number_serves_four_probes_and_four_numbers_one_each():
    assert instruments_from({'probe_gain': 0.002}, 'f').probe_gain == (0.002,) * 4
    four = [0.001, 0.002, 0.003, 0.004]
    assert instruments_from({'probe_gain': four}, 'f').probe_gain == tuple(four)


@pytest.mark.parametrize(('entry', 'said'), [
    ({'load_gian': 1e-3}, 'load_gain'), ({'load_gain': 0.0}, 'above zero'),
    ({'load_gain': -1e-3}, 'above zero'), ({'clock': [1e-3, 1e-3]}, 'above zero'),
    ({'probe_gain': [1e-3, 1e-3]}, 'four of them'), ({'weight': True}, 'above zero'),
    ('none', 'not a section')])
def test_an_entry_of_no_use_is_refused_in_one_line(entry, said):
    with pytest.raises(RigError, match=said) as refusal:
        instruments_from(entry, 'rig.yaml')
    assert '\n' not in str(refusal.value)


def test_certificates_do_not_change_the_hash_of_a_rig():
    assert replace(RIG, instruments=instruments_from(STATED, 'f')).digest == RIG.digest


def test_every_stated_instrument_has_an_error_and_the_others_have_none():
    assert certified_errors(RIG) == {}
    made = certified_errors(replace(RIG, instruments=instruments_from(STATED, 'f')))
    assert {CERTIFIED[source.rstrip('_1234')][0] for source in made} == set(NAMES)
    assert Instruments(load_gain=1e-3).not_stated == tuple(
        name for name in NAMES if name != 'load_gain')


def certificate(folder, quantity, before=''):
    """A DCC with one quantity, in the elements of PTB's schema."""
    path = folder / 'cell.xml'
    path.write_text(
        f'<?xml version="1.0"?>{before}<dcc:digitalCalibrationCertificate '
        'xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si"><dcc:data>'
        '<dcc:quantity refType="force_sensitivity basic_measuredValue"><dcc:name>'
        f'<dcc:content lang="en">sensitivity</dcc:content></dcc:name>{quantity}</dcc:quantity>'
        '</dcc:data></dcc:digitalCalibrationCertificate>')
    return path


def expanded(value, unit, uncertainty, factor):
    return (f'<si:real><si:value>{value}</si:value><si:unit>{unit}</si:unit>'
            '<si:measurementUncertaintyUnivariate><si:expandedMU>'
            f'<si:valueExpandedMU>{uncertainty}</si:valueExpandedMU>'
            f'<si:coverageFactor>{factor}</si:coverageFactor>'
            '</si:expandedMU></si:measurementUncertaintyUnivariate></si:real>')


LIST = ('<si:realListXMLList><si:valueXMLList>100 200</si:valueXMLList>'
        '<si:unitXMLList>\\newton</si:unitXMLList><si:expandedUncXMLList>'
        '<si:uncertaintyXMLList>0.2 0.2</si:uncertaintyXMLList>'
        '<si:coverageFactorXMLList>2</si:coverageFactorXMLList></si:expandedUncXMLList>'
        '</si:realListXMLList>')


@pytest.mark.parametrize(('name', 'quantity', 'wanted'), [
    ('load_gain', expanded(2.0, r'\volt\per\volt', 0.002, 2), 5e-4),
    ('load_gain', expanded(0.01, r'\percent', 0.1, 2), 5e-4),
    ('load_gain', LIST, 1e-3), ('load_offset', LIST, 0.1),
    ('clearance', expanded(40.0, r'\micro\metre', 1.0, 2.0), 5e-7),
    ('elevation', expanded(50.0, r'\degree', 0.02, 2.0), np.radians(0.01))])
def test_an_entry_is_read_from_a_digital_calibration_certificate(tmp_path, name, quantity, wanted):
    certificate(tmp_path, quantity)
    for called in ('force_sensitivity', 'sensitivity'):
        entry = {name: {'certificate': 'cell.xml', 'quantity': called}}
        stated = instruments_from(entry, str(tmp_path / 'rig.yaml'))
        assert getattr(stated, name) == pytest.approx(wanted)


@pytest.mark.parametrize(('before', 'quantity', 'called', 'said'), [
    ('', expanded(1.0, r'\metre', 0.1, 2), 'gain', 'one of basic_measuredValue, force_sens'),
    ('', expanded(1.0, r'\metre', 0.1, 2), 'sensitivity', 'is in m, and N is needed'),
    ('', expanded(1.0, r'\newton', 'x', 2), 'sensitivity', 'no number'),
    ('', expanded(1.0, r'\newton', 0.0, 2), 'sensitivity', 'above zero'),
    ('', '<si:real>', 'sensitivity', 'cannot be read as XML'),
    ('<!DOCTYPE a [<!ENTITY b "c">]>', '&b;', 'sensitivity', 'document type')])
def test_a_certificate_of_no_use_is_refused_in_one_line(tmp_path, before, quantity, called, said):
    certificate(tmp_path, quantity, before)
    with pytest.raises(RigError, match=said) as refusal:
        instruments_from({'load_offset': {'certificate': 'cell.xml', 'quantity': called}},
                         str(tmp_path / 'rig.yaml'))
    assert '\n' not in str(refusal.value)


def test_bags_state_their_instruments_and_two_calibrations_differ_by_both():
    stated, names = stated_by(['', '{"load_gain": 0.003, "certificates": ["A"]}'], 'bags')
    assert stated.load_gain == 3e-3
    assert names == 'A'
    assert difference_of(stated, Instruments(load_gain=4e-3)) == Instruments(load_gain=5e-3)
    both, _ = stated_by([f'{{"probe_gain": {gains}}}' for gains in (
        [0.001, 0.003, 0.001, 0.001], [0.002, 0.001, 0.001, 0.001])], 'bags')
    assert both.probe_gain == (0.002, 0.003, 0.001, 0.001)
    with pytest.raises(RigError, match='as saddlering import writes it'):
        stated_by(['{'], 'bags')
