"""Claims about formats: a bag written in any of them comes back equal to the last bit."""

from dataclasses import replace
from pathlib import Path

from logger_files import CHANNELS, make_record, map_text, Record, WRITERS
from map_documents import convert
import numpy as np
import pytest

from saddlering_ros.bags.reader import read_raw
from saddlering_ros.files import sha256_of_file
from saddlering_ros.importing.source import open_sources
from saddlering_ros.rig.instruments import stated_by


def assert_equal_to(record: Record, bag: Path) -> None:
    raw = read_raw(bag)
    for name, values in record.readings().items():
        topic = raw.topics[f'/rig/{name}']
        assert np.array_equal(topic.stamps, record.stamps)
        assert np.array_equal(topic.values, values)


@pytest.mark.parametrize('name', WRITERS)
def test_a_bag_comes_back_from_every_format_to_the_last_bit(tmp_path: Path, name: str) -> None:
    record = make_record()
    if name == 'TDMS':  # npTDMS writes moments to the microsecond
        record = replace(record, stamps=record.stamps // 1000 * 1000)
    file, write = tmp_path / WRITERS[name][0], WRITERS[name][1]
    time = write(file, record)
    (source,) = open_sources([file])
    assert name.removesuffix(' plain') == source.FORMAT
    result = convert(tmp_path, '', map_text(time), files=[file.name])
    assert_equal_to(record, tmp_path / 'bag')
    assert result.warnings == ()


def test_what_the_map_says_of_the_test_and_where_it_came_from_is_in_the_bag(tmp_path) -> None:
    file, write = tmp_path / 'a.csv', WRITERS['CSV'][1]
    text = map_text(write(file, make_record())).replace(
        'unit: N}', 'unit: N, uncertainty: {gain: 0.001, certificate: K-4711}}')
    convert(tmp_path, '', text, files=[file.name])
    found = read_raw(tmp_path / 'bag').facts
    stated, certificates = stated_by([found.details['instruments']], 'bag')
    assert (stated.load_gain, certificates) == (0.001, 'K-4711')
    assert (found.test, found.elevation_deg, found.rig) == ('dynamic', 50.0, 'SR-017')
    assert {'operator': 'J. Doe', 'service_hours': '120', 'slew_deg': '90', 'ring': 'R 7',
            'bench': '2', 'maintenance': 'True',
            'date': '2026-11-20'}.items() <= found.details.items()
    assert found.details['import_map'].strip() == text.strip()
    assert sha256_of_file(file) in found.details['import_sources']


def test_more_rows_than_a_block_are_written_in_order(tmp_path: Path) -> None:
    record = make_record(rows=150_000, period=100_000)
    time = WRITERS['HDF5'][1](tmp_path / 'a.h5', record)
    result = convert(tmp_path, '', map_text(time), files=['a.h5'])
    assert_equal_to(record, tmp_path / 'bag')
    counts = {name: course.count for name, course in result.runs[0].courses.items()}
    assert counts == dict.fromkeys(CHANNELS, 150_000)
