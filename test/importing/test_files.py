"""Claims about files as loggers leave them: what is wrong is named, never passed on."""

from datetime import timezone
from io import BytesIO
from pathlib import Path
import struct
from typing import Any

from logger_files import make_record, mdf4_bytes
import map_documents
from map_documents import convert, document, LOAD, plain_table, PROBE, readings, ROWS, stamps, TIME
import numpy as np
import pytest
from scipy.io import savemat

from saddlering_ros.bags.reader import read_raw
from saddlering_ros.importing.calibration import (
    CountedTime,
    DatedTime,
    ImportingError,
    MISSING,
    RegularTime,
    unit_of,
)
from saddlering_ros.importing.convert import draft_map, import_files, save_preview
from saddlering_ros.importing.mapping import read_map
from saddlering_ros.importing.source import open_sources
from saddlering_ros.rig import default_rig


def lines(**columns: list[str]) -> list[str]:
    return plain_table(**columns).splitlines()


def test_rows_of_another_width_are_left_out_and_counted(tmp_path: Path) -> None:
    text = lines()
    text[10] += ';7'
    result = convert(tmp_path, '\n'.join(text) + '\n', document())
    assert len(readings(tmp_path)) == ROWS - 1
    assert result.warnings == (
        f'{tmp_path}/a.csv: rows without 3 columns are left out: 1, first line 11 with 4',)


@pytest.mark.parametrize(('rows', 'change', 'said'), [
    (50, 31, 'the delimiter changes in line 32 from semicolon to comma: correct the file'),
    (900, 501, 'rows without 3 columns are left out: 400, first line 502 with 1, of 900 rows')])
def test_a_delimiter_that_changes_half_way_is_refused_with_its_line(tmp_path, rows, change, said):
    text = lines(t=[f'{0.01 * i:.2f}' for i in range(rows)], F=['1'] * rows, w=['1'] * rows)
    text[change:] = [line.replace(';', ',') for line in text[change:]]
    numbered = {**LOAD, 'column': '#2'}, {**PROBE, 'column': '#3'}
    assert said in map_documents.refusal(
        tmp_path, document(*numbered, time={**TIME, 'column': '#1'}), '\n'.join(text) + '\n')


def test_zero_bytes_at_the_end_of_a_file_are_a_row_that_is_left_out(tmp_path: Path) -> None:
    """A recorder that is cut off leaves them; a short file was "neither a text file nor ..."."""
    result = convert(tmp_path, plain_table() + '\0' * 4096, document())
    assert len(readings(tmp_path)) == ROWS
    assert 'rows without 3 columns are left out: 1' in result.warnings[0]


def test_a_unit_that_the_file_states_otherwise_is_told(tmp_path: Path) -> None:
    """A time in ms that the map took for s was imported without a word."""
    text = plain_table().replace('t;F;w', 't [ms];F [kN];w in mm', 1)
    result = convert(tmp_path, text, document({**LOAD, 'column': 'F*'}, {**PROBE, 'column': 'w*'},
                                              time={**TIME, 'column': 't*'}))
    assert result.warnings == (
        f"{tmp_path}/a.csv: column 't [ms]' is in ms by the file and in s by the map (time.unit), "
        'which counts: correct the map if the file is right',)


def test_one_time_that_cannot_be_read_or_goes_back_costs_its_row_alone(tmp_path: Path) -> None:
    many = 200
    time = [f'{0.01 * i:.2f}' for i in range(many)]
    columns = {'t': time, 'F': ['1'] * many, 'w': ['1'] * many}
    for bad, words in (('noon', 'rows with an unreadable time are left out: 1, first row 101'),
                       ('0.5', 'whose time goes back are left out: 1, first row 101, by up to '
                               '0.49 s')):
        folder = tmp_path / bad
        folder.mkdir()
        result = convert(folder, plain_table(**{**columns, 't': [*time[:100], bad, *time[101:]]}),
                         document())
        assert len(readings(folder)) == many - 1
        assert any(words in line for line in result.warnings)


def test_a_row_that_repeats_the_row_before_it_costs_nothing(tmp_path: Path) -> None:
    """A file with 2 % of its rows twice was refused with the advice to split it."""
    heading, *rows = lines()
    twice = [row for row in rows for _ in range(2)]
    result = convert(tmp_path, '\n'.join([heading, *twice]) + '\n', document())
    assert len(readings(tmp_path)) == ROWS
    assert result.warnings == (
        f'{tmp_path}/a.csv: rows that repeat the row before are left out: {ROWS}, first row 2',)
    other = [f'{row}1' if number % 2 else row for number, row in enumerate(twice)]
    folder = tmp_path / 'other'
    folder.mkdir()
    assert 'rows that have the time of an earlier row are left out: ' in map_documents.refusal(
        folder, document(), '\n'.join([heading, *other]) + '\n')


def test_a_counter_of_milliseconds_that_rolls_over_is_told_with_its_remedy(tmp_path: Path) -> None:
    table = plain_table(t=[str((65_300 + 10 * row) % 65_536) for row in range(ROWS)])
    words = map_documents.refusal(tmp_path, document(time={'column': 't', 'unit': 'ms'}), table)
    assert 'or a counter that rolls over rate: and start:' in words


def test_two_runs_in_one_file_are_refused_until_the_map_splits_them(tmp_path: Path) -> None:
    twice = [f'{0.01 * (i % 25):.2f}' for i in range(ROWS)]
    assert 'several runs in one file need split' in map_documents.refusal(
        tmp_path, document(), plain_table(t=twice))
    result = convert(tmp_path, plain_table(t=twice),
                     document(split={'by': 'gap', 'seconds': 0.1,
                                     'runs': [{'elevation_deg': 0}, {'elevation_deg': 60}]}))
    assert [run.metadata.elevation_deg for run in result.runs] == [0.0, 60.0]
    assert [run.courses['hydraulic_load'].count for run in result.runs] == [25, 25]
    assert [run.path.name for run in result.runs] == ['1', '2']


def test_a_column_splits_runs_and_names_them(tmp_path: Path) -> None:
    run = ['up'] * 20 + [''] * 5 + ['down'] * 25
    result = convert(tmp_path, plain_table(run=run), document(
        split={'by': 'column', 'column': 'run',
               'runs': {'up': {'elevation_deg': 30}, 'down': {'elevation_deg': 60}}}))
    assert [run.path.name for run in result.runs] == ['up', 'down']
    assert [run.courses['eddy_current_4'].count for run in result.runs] == [20, 25]
    assert [run.metadata.elevation_deg for run in result.runs] == [30.0, 60.0]


def test_several_files_are_pieces_of_one_record_in_order_of_time(tmp_path: Path) -> None:
    text = lines()
    (tmp_path / 'z.csv').write_text('\n'.join(text[:26]) + '\n')
    (tmp_path / 'b.csv').write_text('\n'.join([text[0], *text[26:]]) + '\n')
    convert(tmp_path, plain_table(), document())
    whole = stamps(tmp_path)
    convert(tmp_path, '', document(), files=['b.csv', 'z.csv'], overwrite=True)
    assert np.array_equal(stamps(tmp_path), whole)


def test_channels_of_two_files_with_rates_of_their_own_make_one_bag(tmp_path: Path) -> None:
    (tmp_path / 'load.csv').write_text('t,F\n' + ''.join(f'{i / 10},{i}\n' for i in range(10)))
    (tmp_path / 'gaps.csv').write_text('t,w\n' + ''.join(f'{i / 100},1\n' for i in range(100)))
    convert(tmp_path, '', document(), files=['load.csv', 'gaps.csv'])
    assert len(readings(tmp_path)) == 10
    assert len(readings(tmp_path, 'eddy_current_3')) == 100


@pytest.mark.parametrize('change', [
    lambda text: text.encode('utf-16'),
    lambda text: text.encode('utf-8-sig'),
    lambda text: text.replace(';', '\t').encode(),
    lambda text: text.replace(';', ' ').encode(),
    lambda text: text.replace('\n', ';\r\n').encode(),
    lambda text: ('# made by a logger\n# a;b;c;d\n' + text).encode(),
])
def test_encodings_delimiters_and_line_ends_make_no_difference(tmp_path, change) -> None:
    convert(tmp_path, plain_table(), document())
    expected = readings(tmp_path)
    (tmp_path / 'a.csv').write_bytes(change(plain_table()))
    result = convert(tmp_path, '', document(), overwrite=True)
    assert np.array_equal(readings(tmp_path), expected)
    assert result.warnings == ()


PREAMBLE = 'Messung;Prüfstand\nBearbeiter;x\n\nZeit [s];Kraft;Weg;Weg\ns;kN;V;V\n'


def test_lines_before_the_headings_units_below_and_equal_names_are_seen(tmp_path: Path) -> None:
    path = tmp_path / 'a.csv'
    rows = ''.join(f'{i / 100:.2f};{i},5;1,{i};2,{i}\n'.replace('.', ',') for i in range(30))
    path.write_bytes((PREAMBLE + rows).encode('latin-1'))
    (source,) = open_sources([path])
    assert [column.name for column in source.columns] == ['Zeit [s]', 'Kraft', 'Weg', 'Weg#2']
    assert [column.unit for column in source.columns] == ['s', 'kN', 'V', 'V']
    assert source.settings['first_line'] == 6
    assert "2 columns are named 'Weg'" in source.warnings[0]


@pytest.mark.parametrize('above', ['x;y', 'x' * 2000], ids=['lines', 'bytes'])
def test_data_may_begin_below_a_long_preamble(tmp_path: Path, above: str) -> None:
    path = tmp_path / 'a.csv'
    rows = ''.join(f'{i / 100};{i}.5\n' for i in range(30))
    path.write_text((above + '\n') * 499 + 'Zeit [s];Kraft [kN]\n' + rows)
    (source,) = open_sources([path], {'header_line': 500, 'first_line': 501})
    assert [column.name for column in source.columns] == ['Zeit [s]', 'Kraft [kN]']


def test_a_draft_keeps_what_it_knows_and_is_refused_until_completed(tmp_path: Path) -> None:
    path = tmp_path / 'a.csv'
    head = 'Zeit [s];Kraft [kN];Weg1 [V];Weg2 [V];Weg3 [V];Weg4 [V]\n'
    path.write_text(head + ''.join(f'{i / 100};{i}.5;1;2;3;4\n' for i in range(30)))
    draft, _ = draft_map(open_sources([path]))
    assert 'hydraulic_load: {column: "Kraft [kN]", unit: kN}' in draft
    assert 'eddy_current_3: {column: "Weg3 [V]", unit: V, scale: TODO' in draft
    (tmp_path / 'map.yaml').write_text(draft)
    with pytest.raises(ImportingError, match='is still TODO: state it'):
        read_map(tmp_path / 'map.yaml')
    completed = draft.replace('scale: TODO, scale_unit: TODO', 'scale: 0.2, scale_unit: mm/V')
    for old, new in (('range: TODO', 'range: [0, 0.002]'), ('test: TODO', 'test: static'),
                     ('deg: TODO', 'deg: 30')):
        completed = completed.replace(old, new)
    (tmp_path / 'map.yaml').write_text(completed)
    result = import_files([path], read_map(tmp_path / 'map.yaml'), tmp_path / 'bag')
    assert read_raw(tmp_path / 'bag').facts.test == 'static'
    save_preview(tmp_path / 'a.png', result.runs, default_rig())
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')


_FILE = BytesIO()
savemat(_FILE, {'data': make_record().readings()}, do_compression=True)
DAMAGED_MATLAB = _FILE.getvalue()[:400] + bytes(60) + _FILE.getvalue()[460:]
CHANNEL, BEYOND_RECORD = (struct.pack('<BBBBII', 0, 0, 4, 0, offset, 64) for offset in (8, 12))
DAMAGED_MDF = mdf4_bytes(0, np.zeros(9, [('t', '<i8'), ('F', '<f8')]), False).replace(
    CHANNEL, BEYOND_RECORD)


@pytest.mark.parametrize(('content', 'words'), [
    (b'', 'is empty'),
    (b'\0\1\2\3' * 40, 'is neither a text file nor of another format'),
    (b'hello world\n' * 9, 'no columns of numbers were found'),
    (b'TDSm' + bytes(60), 'is damaged, or a TDMS file'),
    (b'MDF     4.10    ' + bytes(60), 'is damaged'),
    (DAMAGED_MDF, 'is damaged'),
    (b'MDF     3.30    ' + bytes(60), 'is of MDF version 3.30'),
    (b'\x89HDF\r\n\x1a\n' + bytes(60), 'is damaged, or not an HDF5 file'),
    (b'MATLAB 5.0 MAT-file'.ljust(124) + b'\0\1IM' + bytes(9), 'is damaged, or a MATLAB file'),
    (DAMAGED_MATLAB, 'is damaged'), (None, 'cannot be read')])
def test_a_file_that_cannot_be_read_is_refused_in_one_line(tmp_path, content, words) -> None:
    path = tmp_path / 'a.dat'
    if content is None:
        path.symlink_to(path)
    else:
        path.write_bytes(content)
    with pytest.raises(ImportingError) as caught:
        open_sources([path])
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert '\n' not in str(caught.value)


def test_a_bag_that_is_there_is_not_replaced_and_a_failed_import_leaves_nothing(tmp_path) -> None:
    convert(tmp_path, plain_table(), document())
    with pytest.raises(ValueError, match='exists already'):
        convert(tmp_path, plain_table(), document())
    empty: dict[str, Any] = document(probe={**PROBE, 'column': 'v'}, time=TIME)
    (tmp_path / 'other').mkdir()
    words = map_documents.refusal(tmp_path / 'other', empty, plain_table(v=['nan'] * ROWS))
    assert 'eddy_current_1 has no sample' in words
    assert sorted(path.name for path in (tmp_path / 'other').iterdir()) == ['a.csv', 'map.yaml']


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(('cells', 'unit'), [
    (np.array(['1e99999999', '2e6'], dtype=object), 's'), (np.array([1e305, 2e6]), 's')])
def test_a_number_that_no_stamp_holds_is_a_cell_that_cannot_be_read(cells, unit):
    clock = CountedTime(('time',), unit_of(unit, 'unit'), 0)
    assert clock.stamps([cells], np.arange(2)).tolist() == [MISSING, 2_000_000 * 10 ** 9]


@pytest.mark.parametrize('year', ['1600', '2262', '9999'])
def test_a_date_that_no_stamp_holds_is_a_cell_that_cannot_be_read(year):
    clock = DatedTime(('time',), 'iso', timezone.utc)
    texts = np.array([f'{year}-06-01T00:00:00', '2000-01-01T00:00:00'])
    found = clock.stamps([texts], np.arange(2))
    assert found.tolist() == [MISSING, 946_684_800 * 10 ** 9]


def test_the_first_of_regular_rows_may_lie_behind_the_start():
    time = RegularTime(period=2e6, start=10, first=500.0)
    assert time.stamps([], np.arange(3)).tolist() == [510, 2_000_510, 4_000_510]
