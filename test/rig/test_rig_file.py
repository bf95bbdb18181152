"""Claims about the rig file: what ships is the default, and every fault gets a line of its own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from saddlering_ros.rig import default_rig, load_rig, RigError, TONNE

SHIPPED = Path(__file__).resolve().parents[2] / 'config' / 'rig.yaml'


def rig_document() -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load(SHIPPED.read_text(encoding='utf-8'))
    return document


def write(path: Path, document: Any) -> Path:
    path.write_text(yaml.safe_dump(document), encoding='utf-8')
    return path


def test_the_shipped_file_holds_the_default_rig() -> None:
    assert load_rig(SHIPPED) == default_rig() == load_rig(None)


def test_dotted_keys_and_plain_exponents_read_like_the_nested_shape(tmp_path: Path) -> None:
    document = rig_document()
    parameters = document['/**']['ros__parameters']
    parameters['rig']['carriage'] = {'mass': '5e3', 'inertia': 3000, 'weight_x': 0.0}
    parameters['rig.carriage.weight'] = 40000
    rig = load_rig(write(tmp_path / 'rig.yaml', document))
    assert (rig.carriage.mass, rig.carriage.weight) == (5000.0, 40e3)


def _set(document: dict[str, Any], name: str, value: Any) -> None:
    *parents, last = name.split('.')
    place = document['/**']['ros__parameters']
    for parent in parents:
        place = place[parent]
    if value is None:
        del place[last]
    else:
        place[last] = value


@pytest.mark.parametrize(('name', 'value', 'words'), [
    ('rig.axial_rows.rollers', 2, 'give a number from 3'),
    ('rig.axial_rows.rollers', 97.5, 'give a whole number'),
    ('rig.axial_rows.pitch_radius', -0.6, 'give a number from'),
    ('rig.axial_rows.clearance', 'wide', 'give a number'),
    ('rig.middle_row.height', True, 'give a number'),
    ('rig.carriage.mass', None, 'is missing: add this number'),
    ('rig.carriage.inertia', float('nan'), 'give a number from'),
    ('rig.carriage.weight', [1, 2], 'give a number'),
    ('rig.trunnion', None, 'is missing: add this section'),
    ('rig.trunnion', 3.0, 'is not a section'),
    ('rig.trunnion.z', 1.0, 'remove them or correct their spelling'),
    ('rig.probes.polarity', [1, 1, 0, 1], 'four numbers, each 1 or -1'),
    ('rig.probes.polarity', [1, 1, 1], 'four numbers, each 1 or -1'),
    ('rig.probes.max_range', 0.0, 'give the span in metres'),
    ('rig.preload', -1.0, 'give a number from'),
    ('rig.preload', 3e5, 'not below rig.full_scale_load, 245166 N: correct one of them'),
    ('rig.full_scale_load', 4903.0, 'rig.preload is 4903.32 N, not below'),
    ('bounds.K1', [1e9, 2e7], 'give [low, high] with 0 < low < high'),
    ('bounds.n1', [1.0], 'give [low, high]'),
    ('bounds.D1', 'any', 'give [low, high]'),
    ('bounds.K3', [1.0, 2.0], 'remove them or correct their spelling')])
def test_a_fault_is_told_in_one_line_with_file_entry_and_remedy(tmp_path, name, value, words):
    document = rig_document()
    _set(document, name, value)
    path = write(tmp_path / 'rig.yaml', document)
    with pytest.raises(RigError) as caught:
        load_rig(path)
    message = str(caught.value)
    assert '\n' not in message
    assert str(path) in message
    assert words in message
    assert name.split('.')[-1] in message


def test_a_missing_file_and_a_folder_are_refused_in_one_line(tmp_path: Path) -> None:
    for path in (tmp_path / 'none.yaml', tmp_path):
        with pytest.raises(RigError, match='cannot be read'):
            load_rig(path)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / 'rig.yaml'
    path.write_bytes(b'\xff\xfe\x00\x80')
    with pytest.raises(RigError, match='not a text file'):
        load_rig(path)


@pytest.mark.parametrize(('full_scale', 'unit', 'shown'), [
    (25.0 * TONNE, 't', ('25 t', '0.5 t')), (TONNE, 't', ('1 t', '0.02 t')),
    (TONNE, 'kN', ('9.81 kN', '0.2 kN')), (400.0 * TONNE, 't', ('400 t', '8.0 t')),
    (7.6 * TONNE, 't', ('7.6 t', '0.15 t')), (200.0, 'kN', ('0.2 kN', '0.004 kN'))])
def test_a_small_rig_prints_its_loads_with_more_decimals(full_scale, unit, shown) -> None:
    rig = replace(default_rig(), full_scale_load=full_scale, force_unit=unit)
    assert (rig.full_scale_words, rig.force_words(0.02 * full_scale)) == shown
