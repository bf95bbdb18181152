"""Claims about maps: units are stated, a reading is its calibration in SI, and nothing else."""

from dataclasses import replace
from pathlib import Path

from logger_files import CHANNELS, map_text
import map_documents
from map_documents import cells, convert, document, LOAD, plain_table, PROBE, readings, ROWS, TIME
import numpy as np
import pytest

from saddlering_ros.bags.reader import read_raw
from saddlering_ros.errors import BagError
from saddlering_ros.importing.mapping import read_map
from saddlering_ros.rig import default_rig


@pytest.mark.parametrize(('entry', 'expected'), [
    ({'unit': 'N'}, lambda v: v),
    ({'unit': 'kN'}, lambda v: v * 1000.0),
    ({'unit': 't'}, lambda v: v * 9806.65),
    ({'unit': 'lbf'}, lambda v: v * 4.4482216152605),
    ({'unit': 'kN', 'scale': 2.5, 'offset': -3.0}, lambda v: (v * 2.5 - 3.0) * 1000.0),
    ({'unit': 'kN', 'polarity': -1}, lambda v: -v * 1000.0),
    ({'unit': 'V', 'scale': 50.0, 'scale_unit': 'kN/V'}, lambda v: v * 50.0 * 1000.0),
    ({'unit': 'V', 'polynomial': [1.0, 2.0, 0.5], 'polynomial_unit': 'kN'},
     lambda v: (1.0 + v * (2.0 + v * 0.5)) * 1000.0),
    ({'unit': 'bar', 'piston_area': 0.0123}, lambda v: v * 1e5 * 0.0123),
    ({'unit': 'bar', 'piston_area': 0.0123, 'rod_pressure': 'w', 'rod_area': 0.0085},
     lambda v: v * 1e5 * 0.0123 - cells(plain_table(), 'w') * 1e5 * 0.0085)])
def test_a_load_is_its_calibration_in_si_to_the_last_bit(tmp_path, entry, expected) -> None:
    convert(tmp_path, plain_table(), document({'column': 'F', **entry}))
    assert np.array_equal(readings(tmp_path), expected(cells(plain_table(), 'F')))


def test_a_gap_is_its_calibration_table_and_a_reading_outside_is_left_out(tmp_path: Path) -> None:
    (tmp_path / 'probe.csv').write_text('V;mm\n1,0;0,2\n1,02;0,5\n1,04;1,9\n')
    probe = {'column': 'w', 'unit': 'V', 'table': 'probe.csv', 'range': [0, 0.002]}
    result = convert(tmp_path, plain_table(), document(probe=probe))
    volts = cells(plain_table(), 'w')
    inside = volts <= 1.04
    assert 0 < inside.sum() < ROWS
    expected = np.interp(volts[inside], [1.0, 1.02, 1.04], [0.2, 0.5, 1.9]) / 1000.0
    assert np.array_equal(readings(tmp_path, CHANNELS[2]), np.float32(expected))
    assert any('outside of its calibration table, left out: ' in line for line in result.warnings)


def test_an_elevation_in_milliradians_is_read_as_such(tmp_path: Path) -> None:
    map_ = document()
    map_['channels']['elevation'] = {'column': 'phi', 'unit': 'mrad'}
    convert(tmp_path, plain_table(phi=['872.66'] * ROWS), map_)
    assert np.allclose(readings(tmp_path, 'elevation'), 0.87266, rtol=1e-12)


def test_a_decimal_comma_reads_as_a_decimal_point(tmp_path: Path) -> None:
    convert(tmp_path, plain_table().replace('.', ','), document())
    assert np.array_equal(readings(tmp_path), cells(plain_table(), 'F') * 1000.0)


def test_a_delay_moves_the_stamps_of_its_channel_alone(tmp_path: Path) -> None:
    convert(tmp_path, plain_table(), document(probe={**PROBE, 'delay': 0.004}))
    topics = read_raw(tmp_path / 'bag').topics
    shift = topics['/rig/hydraulic_load'].stamps - topics['/rig/eddy_current_1'].stamps
    assert set(shift.tolist()) == {4_000_000}


EIGHT = 1_795_161_600_000_000_000
"""2026-11-20 08:00:00 UTC."""


@pytest.mark.parametrize(('time', 'columns', 'first'), [
    (TIME, {}, EIGHT),
    ({'rate': 100, 'start': '2026-11-20T08:00:00Z'}, {}, EIGHT),
    ({'column': 'd', 'format': 'iso', 'zone': 'Europe/Berlin'},
     {'d': [f'2026-11-20 09:00:00.{i:02d}' for i in range(ROWS)]}, EIGHT),
    ({'column': 'd', 'format': 'iso'},
     {'d': [f'2026-11-20T08:00:00.{i:02d}Z' for i in range(ROWS)]}, EIGHT),
    ({'column': ['d', 'e'], 'format': '%d.%m.%Y %H:%M:%S', 'zone': 'UTC'},
     {'d': ['20.11.2026'] * ROWS, 'e': [f'08:00:00,{i:02d}' for i in range(ROWS)]}, EIGHT),
    ({'column': 'd', 'unit': 's'},
     {'d': [f'1795161600.{i:02d}0000001' for i in range(ROWS)]}, EIGHT + 1),
    ({'column': 'd', 'unit': 'ms', 'start': '2026-11-20T08:00:00Z'},
     {'d': [str(10 * i) for i in range(ROWS)]}, EIGHT)])
def test_every_way_to_state_the_time_gives_the_same_stamps(tmp_path, time, columns, first):
    convert(tmp_path, plain_table(**columns), document(time=time))
    assert np.array_equal(map_documents.stamps(tmp_path), first + np.arange(ROWS) * 10_000_000)


@pytest.mark.parametrize(('map_', 'words'), [
    (document({'column': 'F'}), "channels.hydraulic_load: the unit of column 'F' is not stated"),
    (document({'column': 'F', 'unit': 'kn'}), 'did you mean kN?'),
    (document({'column': 'F', 'unit': 'V'}), 'is a voltage (V) where a force is needed'),
    (document({'column': 'F', 'unit': 'bar'}), 'give piston_area'),
    (document({'column': 'Q', 'unit': 'kN'}), "no file has a column 'Q' (there are: t, #1, F,"),
    (document({**LOAD, 'scal': 2}), 'has unknown entries (scal): did you mean scale?'),
    (document({**LOAD, 'scale': 2, 'table': 'x.csv'}), 'table and scale are both given'),
    (document({**LOAD, 'scale': 'big'}), "scale is 'big': give a number"),
    (document({'column': 'F', 'unit': 'V', 'scale': 1, 'scale_unit': 'kN/mV'}), 'like mm/V'),
    (document({'column': 'F', 'unit': 'TODO'}), 'hydraulic_load.unit is still TODO: state it'),
    (document(probe={**PROBE, 'range': [2, 0]}), 'give [low, high] in metres'),
    (document(probe={'column': 'w', 'unit': 'mm'}), 'the range of the probe is not stated'),
    (document(time={'column': 't'}), 'the unit of the time is not stated'),
    (document({**LOAD, 'time': {'column': 't', 'unit': 's'}}), 'hydraulic_load.time has no start'),
    (document(time={'rate': 100}), 'a rate needs a start'),
    (document(time={'rate': 100, 'start': '2026-11-20T08:00:00'}), 'without a time zone'),
    (document(time={'rate': 100, 'start': '2026-11-20T08:00:00', 'zone': '+44:00'}),
     "time.zone is '+44:00', which is not a known time zone"),
    (document(time={'column': 't', 'unit': 'kN'}), 'give a unit of time'),
    (document(test={'test': 'dynamic'}), 'test.elevation_deg is missing in the map'),
    (document(test={'test': 'fast', 'elevation_deg': 5}), "test is 'fast': give static or dyn"),
    (document(test={**map_documents.TEST, 'elevatoin': 5}), 'did you mean elevation_deg?'),
    (document(split={'by': 'gaps'}), 'give column or gap'),
    (document(csv={'first_line': 'two'}), "csv.first_line is 'two': give a number"),
    ({'time': TIME}, 'channels: is missing'),
    ([1], 'is not a map')])
def test_a_map_that_leaves_something_open_is_refused(tmp_path, map_, words) -> None:
    assert words in map_documents.refusal(tmp_path, map_)


def test_the_rig_gives_the_range_of_its_probes_and_its_hash(tmp_path: Path) -> None:
    rig = default_rig()
    convert(tmp_path, plain_table(), document(probe={'column': 'w', 'unit': 'mm'}), rig=rig)
    raw = read_raw(tmp_path / 'bag')
    assert raw.facts.details['rig_hash'] == rig.digest


def test_the_map_of_the_contract_reads(tmp_path: Path) -> None:
    text = map_text('{column: Time, unit: s, zone: UTC}').replace(
        'column: hydraulic_load, unit: N',
        'column: "Kraft*", unit: kN, scale: 1, offset: 0')
    (tmp_path / 'map.yaml').write_text(text)
    assert read_map(tmp_path / 'map.yaml').channels[0].column == 'Kraft*'


def test_a_radial_probe_that_the_rig_lacks_is_stated_in_the_map(tmp_path: Path) -> None:
    map_ = document()
    map_['channels']['eddy_current_3'] = 'absent'
    convert(tmp_path, plain_table(), map_)
    rig = default_rig()
    rig = replace(rig, probes=replace(rig.probes, absent=3))
    assert len(read_raw(tmp_path / 'bag', rig=rig)['/rig/eddy_current_3']) == ROWS
    with pytest.raises(BagError, match=r'rig\.probes\.absent: 3'):
        read_raw(tmp_path / 'bag')
    map_['channels']['eddy_current_1'] = 'absent'
    assert 'are both absent, and delta_x needs one' in map_documents.refusal(tmp_path, map_)
