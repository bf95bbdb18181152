"""Claims about files that could be read wrongly without a sign: refused, or read rightly."""

from dataclasses import replace
import json
from pathlib import Path
import resource
import shlex
import struct
import warnings
import zlib

import h5py
from logger_files import make_record, write_mdf4, write_tdms
from map_documents import convert, document, plain_table, readings, refusal, ROWS, stamps, TIME
from matplotlib.figure import Figure
import nptdms
import numpy as np
import pytest
from scipy.io import savemat

from saddlering_ros.cli.main import main
from saddlering_ros.files import share_directory
from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.convert import draft_map
from saddlering_ros.importing.source import open_sources

DATA = Path(__file__).resolve().parents[2] / 'docs' / 'data'
GROUPED = [f'{1 + i // 10}.{100 + i},5' for i in range(ROWS)]
FROM_FILE = document(time={'from': 'file'})
COMMA = {'t': [f'{i},25' for i in range(ROWS)], 'w': [f'1,{200 + i}' for i in range(ROWS)]}


def test_a_point_in_a_file_with_decimal_comma_is_refused_until_it_is_declared(tmp_path) -> None:
    loads = [f'4.{700 + i}' for i in range(ROWS)]
    said = refusal(tmp_path, document(), plain_table(**COMMA, F=loads))
    assert "'4.700' in column 'F'" in said
    assert 'thousands: "."' in said
    for cells in (loads, GROUPED):
        convert(tmp_path, plain_table(**COMMA, F=cells), document(csv={'thousands': '.'}),
                overwrite=True)
        expected = [1e3 * float(cell.replace('.', '').replace(',', '.')) for cell in cells]
        assert np.array_equal(readings(tmp_path), expected)


@pytest.mark.parametrize('cell', ['1,000.5', '1,000', "1'000.5", '1 000.5', '1.2.3'])
def test_a_number_with_another_mark_is_refused_and_not_left_out(tmp_path, cell) -> None:
    loads = [cell if i == 7 else f'{i}.5' for i in range(ROWS)]
    assert repr(cell) in refusal(tmp_path, document(), plain_table(F=loads))
    times = [f'{i}.{100 + i}' for i in range(ROWS)]
    assert "in column 't'" in refusal(
        tmp_path, document(), plain_table(**{**COMMA, 't': times}, F=['1,5'] * ROWS))


@pytest.mark.parametrize('first', [0.0, -0.25])
def test_a_time_without_a_date_from_zero_or_before_it_loses_no_sample(tmp_path, first) -> None:
    times = [f'{first + 0.01 * i:.2f}' for i in range(ROWS)]
    convert(tmp_path, plain_table(t=times), document(time={'column': 't', 'unit': 's'}))
    assert stamps(tmp_path).min() > 0
    assert (stamps(tmp_path) - stamps(tmp_path)[0] == 10_000_000 * np.arange(ROWS)).all()


@pytest.mark.parametrize(('column', 'cell', 'words'), [
    *(('t', cell, f'{cell!r} is no number') for cell in ('1_0', '١٢', '１', '0x10')),
    ('F', 'ERR', "cells of column 'F' that are not numbers are left out: 1, first 'ERR'"),
    ('w', '1e45', 'too large for a message, left out: 1')])
def test_one_cell_that_is_no_reading_is_left_out_and_said(tmp_path, column, cell, words) -> None:
    cells = [cell if i == 7 else f'{1 + i / 100:.2f}' for i in range(ROWS)]
    result = convert(tmp_path, plain_table(**{column: cells}), document())
    assert any(words in line for line in result.warnings)
    kept = [len(readings(tmp_path, name)) for name in ('hydraulic_load', 'eddy_current_2')]
    assert kept == [ROWS - (column in given) for given in ('tF', 'tw')]


def test_a_quotation_mark_without_its_partner_swallows_no_rows(tmp_path: Path) -> None:
    text = plain_table().splitlines()
    text[10] = text[10].replace(';', ';"', 1)
    text[30] = text[30].replace(';', ';"', 1)
    said = refusal(tmp_path, document(), '\n'.join(text) + '\n')
    assert 'line 11 has a quotation mark without its partner' in said
    assert '20 rows of 50 would be lost' in said


def test_quoted_cells_with_a_decimal_comma_are_read(tmp_path: Path) -> None:
    rows = [line.replace('.', ',').split(';') for line in plain_table().splitlines()]
    text = '\n'.join(','.join(f'"{cell}"' for cell in row) for row in rows) + '\n'
    convert(tmp_path, text, document())
    assert len(readings(tmp_path)) == ROWS


@pytest.mark.parametrize('mark', ['\x85', '\x0c', '\x1c', '\u2028'])
def test_a_mark_in_the_heading_lines_that_only_python_calls_a_line_end_costs_no_row(
        tmp_path: Path, mark: str) -> None:
    convert(tmp_path, f'logger{mark}7\nmade by{mark}x\n' + plain_table(), document())
    assert len(readings(tmp_path)) == ROWS


def test_a_file_that_ends_within_a_line_is_said_to_be_cut_off(tmp_path: Path) -> None:
    result = convert(tmp_path, plain_table()[:-3], document())
    assert any('may be cut off' in line for line in result.warnings)
    assert convert(tmp_path, plain_table(), document(), overwrite=True).warnings == ()


def side_by_side() -> str:
    """A fast load and slow gaps in one table, each with a time; short columns end in blanks."""
    rows = [f'{i / 100:.2f};{i};' + (f'{i / 10:.1f};1.{i}' if i < 10 else ';')
            for i in range(100)]
    return 'Time;F [kN];Time;w [mm]\n' + '\n'.join(rows) + '\n'


def test_two_rates_side_by_side_in_one_table_are_two_clocks(tmp_path: Path) -> None:
    map_ = document(load={'column': 'F*', 'unit': 'kN'},
                    probe={'column': 'w*', 'unit': 'mm', 'range': [0, 0.002],
                           'time': {**TIME, 'column': 'Time#2'}},
                    time={**TIME, 'column': 'Time'})
    result = convert(tmp_path, side_by_side(), map_)
    assert (len(readings(tmp_path)), len(readings(tmp_path, 'eddy_current_2'))) == (100, 10)
    assert [line for line in result.warnings if 'left out' in line] == []


def test_the_draft_gives_each_channel_the_time_beside_it_and_the_pressure_of_the_rod(tmp_path):
    path = tmp_path / 'a.csv'
    head = 'Zeit [s];p Kolben [bar];p Stange [bar];Zeit [s];' + ';'.join(
        f'Weg{i} [mm]' for i in range(1, 5))
    rows = [f'{i / 100};{i};1;' + (f'{i / 10};1;1;1;1' if i < 10 else ';;;;') for i in range(99)]
    path.write_text('\n'.join([head, *rows]) + '\n')
    text, _ = draft_map(open_sources([path]))
    assert 'piston_area: TODO, rod_pressure: "p Stange [bar]", rod_area: TODO' in text
    load, probe = (next(line for line in text.splitlines() if name in line)
                   for name in ('hydraulic_load', 'eddy_current_2'))
    assert 'time: {column: "Zeit [s]#2", unit: s}' in probe
    assert 'time:' not in load


def test_a_time_that_does_not_fit_its_format_is_shown_with_it(tmp_path: Path) -> None:
    times = [f'20.11.2026 08:00:{i:02d}' for i in range(ROWS)]
    times[3] = '20/11/2026'
    form = '%d.%m.%Y %H:%M:%S'
    map_ = document(time={'column': 't', 'format': form, 'zone': 'UTC'})
    result = convert(tmp_path, plain_table(t=times), map_)
    assert any(f"'20/11/2026' does not fit {form}" in line for line in result.warnings)
    assert len(stamps(tmp_path)) == ROWS - 1
    map_ = document(time={'column': 't', 'format': '%m/%d/%Y %H:%M:%S', 'zone': 'UTC'})
    said = refusal(tmp_path, map_, plain_table(t=times), overwrite=True)
    assert "'20.11.2026 08:00:00' does not fit %m/%d/%Y %H:%M:%S" in said


BERLIN = {'column': 't', 'format': '%d.%m.%Y %H:%M:%S', 'zone': 'Europe/Berlin'}
TWICE = 'occurs twice in Europe/Berlin (end of summer time): give zone: +02:00 for the first'


@pytest.mark.parametrize(('day', 'zone', 'words'), [
    ('25.10.2026', 'Europe/Berlin', f"('25.10.2026 02:30:00') are doubtful: it {TWICE}"),
    ('25.10.2026', '+01:00', ''), ('25.10.2026', '+02:00', ''),
    ('26.10.2026', 'Europe/Berlin', ''),
    ('29.03.2026', 'Europe/Berlin', "('29.03.2026 02:30:00') are doubtful: it does not occur in "
     'Europe/Berlin (beginning of summer time): give the zone of a clock that does not change, '
     '+01:00')])
def test_a_local_time_that_a_change_of_summer_time_makes_doubtful_is_refused_until_it_is_stated(
        tmp_path: Path, day: str, zone: str, words: str) -> None:
    """The first of both hours was taken without a word."""
    times = [f'{day} 02:30:{i:02d}' for i in range(ROWS)]
    map_ = document(time={**BERLIN, 'zone': zone})
    if words:
        assert words in refusal(tmp_path, map_, plain_table(t=times))
    else:
        convert(tmp_path, plain_table(t=times), map_)
        assert len(stamps(tmp_path)) == ROWS


def test_a_start_in_the_hour_that_occurs_twice_is_refused(tmp_path: Path) -> None:
    start = '2026-10-25T02:30:00'
    said = refusal(tmp_path, document(time={'rate': 100, 'start': start, 'zone': 'Europe/Berlin'}))
    assert f"time.start is '{start}', which {TWICE}" in said
    convert(tmp_path, plain_table(), document(time={'rate': 100, 'start': f'{start}+01:00'}))
    assert stamps(tmp_path)[0] == 1_792_891_800_000_000_000


def test_a_dataset_without_a_place_for_values_is_no_column(tmp_path: Path) -> None:
    with h5py.File(tmp_path / 'a.h5', 'w') as file:
        file['nothing'] = h5py.Empty('f8')
        file['F'] = np.arange(5.0)
    assert [column.name for column in open_sources([tmp_path / 'a.h5'])[0].columns] == ['F']


def test_a_matlab_file_that_unpacks_without_end_is_refused_in_bounded_memory(tmp_path) -> None:
    path = tmp_path / 'a.mat'
    savemat(path, {'small': np.arange(9.0)}, do_compression=True)
    element = packed_zeros(3 << 30)
    with path.open('ab') as file:
        file.write(struct.pack('<II', 15, len(element)) + element)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ImportingError, match='unpacks to more than 1 GB') as caught:
        open_sources([path])
    assert '\n' not in str(caught.value)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 18  # 256 MB


def packed_zeros(size: int) -> bytes:
    """A zlib stream of `size` zeros without its end; its blocks do not refer to each other."""
    packer, block = zlib.compressobj(9), bytes(1 << 24)
    first, next_one = (packer.compress(block) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    return first + next_one * (size >> 24)


@pytest.mark.parametrize(('wrong', 'said'), [
    ('scale: 0.0002, ', 'the unit or the scale of the probes is wrong'),
    ('scale: 200, ', 'and look like millimetres: correct unit or scale in the map'),
    ('piston_area: 0.0000123}', 'looks like kilonewtons: correct unit or scale in the map'),
    ('scale: -0.2, ', 'polarity')])
def test_an_import_says_what_info_and_the_rig_file_say(tmp_path, capsys, wrong, said) -> None:
    key = wrong.partition(':')[0]
    text = (DATA / 'map_static_30.yaml').read_text()
    right = next(piece for piece in ('scale: 0.2, ', 'piston_area: 0.0123}')
                 if piece.startswith(key))
    (tmp_path / 'map.yaml').write_text(text.replace(right, wrong))
    arguments = ['import', str(DATA / 'static_30.csv'), '--rig', str(DATA / 'rig.yaml'), '--map',
                 str(tmp_path / 'map.yaml'), '--out', str(tmp_path / 'bag'), '--json', '-']
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert said in printed.err
    assert any(said in line for line in json.loads(printed.out)['warnings'])


@pytest.mark.parametrize('unit', ['t', 'kN'])
def test_loads_of_an_import_are_printed_and_drawn_in_the_unit_of_the_rig_file(
        tmp_path: Path, monkeypatch, capsys, unit: str) -> None:
    rig, labels, save = tmp_path / 'rig.yaml', [], Figure.savefig
    text = (share_directory() / 'config' / 'rig.yaml').read_text()
    rig.write_text(text.replace('force_unit: t ', f'force_unit: {unit} '))

    def noted(figure, *args, **options):
        labels.append(figure.axes[0].get_ylabel())
        return save(figure, *args, **options)

    monkeypatch.setattr(Figure, 'savefig', noted)
    assert main(['import', str(DATA / 'dynamic_30.csv'), '--map',
                 str(DATA / 'map_dynamic_30.yaml'), '--rig', str(rig),
                 '--out', str(tmp_path / 'bag'), '--preview', str(tmp_path / 'a.png')]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if 'hydraulic_load' in line)
    assert line.split()[-1] == unit
    assert labels == [f'load / {unit}']


@pytest.mark.parametrize(('change', 'said'), [
    (lambda cell: cell.replace(',', '.'), 'is no clear number where the decimal mark is'),
    (lambda cell: cell if ':' in cell or cell.count('.') == 2 else 'NaN', 'has no sample'),
    (lambda cell: cell if ':' in cell or cell.count('.') == 2 else f'~{cell}',
     "first '~1."),
    (lambda cell: None, 'has no data from line 6 on')])
def test_a_file_that_is_not_as_its_map_states_is_told_what_and_not_to_state_it(
        tmp_path, capsys, change, said: str) -> None:
    lines = (DATA / 'static_30.csv').read_text('latin-1').splitlines()
    rows = [[change(cell) for cell in line.split(';')] for line in lines[5:50]]
    data = [';'.join(row) for row in rows if None not in row]
    (tmp_path / 'a.csv').write_text('\n'.join([*lines[:5], *data, '']), 'latin-1')
    assert main(['import', str(tmp_path / 'a.csv'), '--map', str(DATA / 'map_static_30.yaml'),
                 '--out', str(tmp_path / 'bag')]) == 2
    assert said in capsys.readouterr().err


def test_a_preview_of_another_kind_is_refused_before_the_bag_is_written(tmp_path, capsys) -> None:
    assert main(['import', str(DATA / 'dynamic_30.csv'), '--map',
                 str(DATA / 'map_dynamic_30.yaml'), '--out', str(tmp_path / 'bag'), '--preview',
                 str(tmp_path / 'a.txt')]) == 2
    assert 'give a name that ends in .png' in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_commands_that_an_import_prints_can_be_typed(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    Path('a test.csv').write_bytes((DATA / 'dynamic_30.csv').read_bytes())
    assert main(['import', 'a test.csv', '--draft', '--map', 'a map.yaml']) == 0
    command = capsys.readouterr().out.partition('then: saddlering ')[2]
    assert shlex.split(command) == ['import', 'a test.csv', '--map', 'a map.yaml', '--out', 'BAG']
    assert main(['import', 'a test.csv', '--map', str(DATA / 'map_dynamic_30.yaml'), '--out',
                 'a bag']) == 0
    command = capsys.readouterr().out.partition('next: saddlering ')[2]
    assert shlex.split(command) == ['info', 'a bag']
    assert main(['info', 'a test.csv']) == 2
    command = capsys.readouterr().err.partition('files by: saddlering ')[2]
    assert shlex.split(command)[:3] == ['import', 'a test.csv', '--draft']


def test_a_tdms_file_that_is_cut_off_is_said_to_be(tmp_path: Path, capfd) -> None:
    path = tmp_path / 'a.tdms'
    write_tdms(path, make_record())
    path.write_bytes(path.read_bytes()[:-900])
    (source,) = open_sources([path])
    assert any('less data than expected' in line for line in source.warnings)
    assert capfd.readouterr().err == ''


@pytest.mark.parametrize('first', [46350.0, 740310.0], ids=['a spreadsheet', 'in matlab'])
def test_days_of_another_epoch_are_refused_with_the_start_to_give(tmp_path, first) -> None:
    table = plain_table(t=[f'{first + i / 86400:.9f}' for i in range(ROWS)])
    said = refusal(tmp_path, document(time={'column': 't', 'unit': 'd'}), table)
    assert ('start: in time:' if first < 1e5 else 'no number that is a time in this unit') in said
    if first < 1e5:
        convert(tmp_path, table, document(
            time={'column': 't', 'unit': 'd', 'start': '1899-12-30T00:00:00Z'}))
        assert str(np.datetime64(int(stamps(tmp_path)[0]), 'ns'))[:10] == '2026-11-24'


def test_a_time_of_day_counts_from_the_midnight_that_is_given(tmp_path: Path) -> None:
    table = plain_table(t=[f'08:00:0{i}.5' if i < 10 else f'08:00:{i}.5' for i in range(ROWS)])
    clock = {'column': 't', 'format': '%H:%M:%S'}
    said = refusal(tmp_path, document(time=clock), table)
    assert 'have no date: add start:' in said
    for times, given in ((table, clock), (table.replace('.5;', ':5;'), {
            **clock, 'format': '%H:%M:%S:%f'})):
        convert(tmp_path, times, document(time={**given, 'start': '2026-11-20T00:00:00Z'}),
                overwrite=True)
        assert str(np.datetime64(int(stamps(tmp_path)[0]), 'ns'))[:21] == '2026-11-20T08:00:00.5'
    night = plain_table(t=[f'{"23:59" if i < 9 else "00:00"}:{51 + i if i < 9 else i - 9:02}'
                           for i in range(ROWS)])
    result = convert(tmp_path, night, document(time={
        **clock, 'start': '2026-11-20T00:00:00Z'}), overwrite=True)
    assert (result.warnings, len(stamps(tmp_path))) == ((), ROWS)
    assert str(np.datetime64(int(stamps(tmp_path)[-1]), 'ns'))[:10] == '2026-11-21'


def test_a_pressure_of_the_rod_in_another_unit_is_said(tmp_path: Path) -> None:
    columns = {'p [bar]': ['100.0'] * ROWS, 'rod [MPa]': ['0.2'] * ROWS}
    load = {'column': 'p', 'unit': 'bar', 'piston_area': 0.0123, 'rod_pressure': 'rod',
            'rod_area': 0.006}
    result = convert(tmp_path, plain_table(**columns), document(load))
    assert any("column 'rod [MPa]' is in MPa by the file and in bar by the map "
               '(channels.hydraulic_load.unit, of both pressures)' in line
               for line in result.warnings)


def test_fewer_runs_than_the_map_describes_are_said(tmp_path: Path) -> None:
    twice = [f'{0.01 * (i % 25):.2f}' for i in range(ROWS)]
    runs = [{'elevation_deg': degrees} for degrees in (0, 30, 60)]
    split = {'by': 'gap', 'seconds': 0.1, 'runs': runs}
    result = convert(tmp_path, plain_table(t=twice), document(split=split))
    assert 'describes 3 runs and the files hold 2' in result.warnings[0]
    split['runs'] = runs[:2]
    result = convert(tmp_path, plain_table(t=twice), document(split=split), overwrite=True)
    assert result.warnings == ()


def test_runs_by_gaps_that_share_readings_are_said(tmp_path: Path, capsys) -> None:
    """A logger that begins each file with the end of the one before."""
    head, *rows = plain_table().splitlines()
    for name, part in (('a', rows[:30]), ('b', rows[10:])):
        (tmp_path / f'{name}.csv').write_text('\n'.join([head, *part]) + '\n')
    (tmp_path / 'map.yaml').write_text(json.dumps(document(split={'by': 'gap', 'seconds': 0.1})))
    assert main(['import', *(str(tmp_path / f'{name}.csv') for name in 'ab'), '--map',
                 str(tmp_path / 'map.yaml'), '--out', str(tmp_path / 'bag')]) == 0
    said = capsys.readouterr().err
    assert f'bag/2: 20 of its 40 samples stand in {tmp_path}/bag/1 too' in said


def test_a_channel_without_a_sample_and_a_shared_column_are_named(tmp_path: Path) -> None:
    clock = {'wf_increment': 0.01, 'wf_start_time': np.datetime64('2026-11-20T08:00:00')}
    with nptdms.TdmsWriter(tmp_path / 'a.tdms') as writer:
        writer.write_segment([nptdms.ChannelObject('g', name, np.ones(count), properties=clock)
                              for name, count in (('F', ROWS), ('w', 0))])
    with pytest.raises(ImportingError, match='channel eddy_current_1 has no sample'):
        convert(tmp_path, '', FROM_FILE, files=['a.tdms'])
    said = refusal(tmp_path, document(split={'by': 'column', 'column': 'F'}))
    assert "column 'F' is that of the time or of split: too" in said


def write_waveforms(path: Path, *starts: float) -> None:
    """A segment of ROWS readings at 100 Hz for each start [s], as a program that appends does."""
    midnight = np.datetime64('2026-11-20T08:00:00', 'us')
    with nptdms.TdmsWriter(path) as writer:
        for start in starts:
            clock = {'wf_increment': 0.01, 'wf_start_time':
                     midnight + np.timedelta64(round(1e6 * start), 'us')}
            writer.write_segment([nptdms.ChannelObject('g', name, np.ones(ROWS), properties=clock)
                                  for name in 'Fw'])


def test_a_recording_appended_to_a_tdms_file_after_a_pause_is_refused(tmp_path: Path) -> None:
    file = tmp_path / 'a.tdms'
    write_waveforms(file, 0.0, 0.01 * ROWS + 10.0)
    with pytest.raises(ImportingError, match=r'second recording, from 2026-11-20 08:00:10\.500'):
        convert(tmp_path, '', FROM_FILE, files=['a.tdms'], overwrite=True)
    write_waveforms(file, 0.0, 0.01 * ROWS)
    convert(tmp_path, '', FROM_FILE, files=['a.tdms'], overwrite=True)
    assert np.ptp(stamps(tmp_path)) == (2 * ROWS - 1) * 10_000_000
    assert stamps(tmp_path)[0] == 1_795_161_600 * 10**9


def test_an_index_of_another_tdms_file_beside_it_is_not_read(tmp_path: Path) -> None:
    file, index = tmp_path / 'a.tdms', tmp_path / 'a.tdms_index'
    with nptdms.TdmsWriter(str(file), index_file=True) as writer:
        writer.write_segment([nptdms.ChannelObject('g', name, np.ones(5)) for name in 'Fw'])
    old = index.read_bytes()
    write_waveforms(file, 0.0)
    index.write_bytes(old)
    convert(tmp_path, '', FROM_FILE, files=['a.tdms'])
    assert len(readings(tmp_path)) == ROWS


def test_the_file_whose_time_has_no_date_is_named(tmp_path: Path) -> None:
    write_waveforms(tmp_path / 'a.tdms', 0.0)
    savemat(tmp_path / 'b.mat', {'t': 0.01 * np.arange(ROWS), 'G': np.ones(ROWS)})
    load = {'column': 'F', 'unit': 'kN', 'time': {'from': 'file'}}
    probe = {'column': 'G', 'unit': 'mm', 'range': [0, 0.002]}
    result = convert(tmp_path, '', document(load, probe, time={'column': 't', 'unit': 's'}),
                     files=['a.tdms', 'b.mat'])
    (line,) = [line for line in result.warnings if 'has no date' in line]
    assert line.startswith(f'{tmp_path / "b.mat"}: stamps count from 1970-01-02')


@pytest.mark.parametrize(('rate', 'is_said'), [(100.05, False), (200.0, True)])
def test_a_rate_that_the_file_states_otherwise_is_told(tmp_path, rate, is_said) -> None:
    write_waveforms(tmp_path / 'a.tdms', 0.0)
    record = replace(make_record(ROWS), stamps=10_000_000 * np.arange(ROWS))
    write_mdf4(tmp_path / 'a.mf4', record)
    time = {'rate': rate, 'start': '2026-11-20T08:00:00Z'}
    for name, columns in (('a.tdms', 'Fw'), ('a.mf4', ('hydraulic_load', 'eddy_current_1'))):
        result = convert(tmp_path, '', document(
            {'column': columns[0], 'unit': 'N'},
            {'column': columns[1], 'unit': 'mm', 'range': [0, 0.002]}, time=time),
            files=[name], overwrite=True)
        assert any('of 100 Hz by the file are read at 200 Hz' in line
                   for line in result.warnings) == is_said


@pytest.mark.parametrize(('rate', 'factor', 'is_said'), [
    (100.0, 0.01, False), (100.0, 10.0, False), (100.0, 1.0, False), (1000.0, 0.01, True)])
def test_a_rate_that_a_column_of_times_contradicts_is_told(tmp_path, rate, factor, is_said):
    """100 Hz by the column Zeit and 1000 Hz by the map: D came out ten times too small."""
    rows = [f'{factor * row};{5 + row / 100};1.0' for row in range(ROWS)]
    (tmp_path / 'a.csv').write_text('\n'.join(['Zeit;F;G', *rows]) + '\n')
    result = convert(tmp_path, '', document(
        {'column': 'F', 'unit': 'kN'}, {'column': 'G', 'unit': 'mm', 'range': [0, 0.002]},
        time={'rate': rate, 'start': '2026-11-20T08:00:00Z'}), files=['a.csv'])
    assert any("column 'Zeit' rises by 0.01 a row, and the rows are read at 1000 Hz" in line
               for line in result.warnings) == is_said


def test_packed_and_missing_readings_of_netcdf_are_unpacked(tmp_path: Path) -> None:
    packed = np.arange(ROWS, dtype=np.int16)
    packed[3] = -999
    with h5py.File(tmp_path / 'a.nc', 'w') as file:
        file['t'], file['w'] = 0.01 * np.arange(ROWS), np.ones(ROWS)
        file['F'] = packed
        file['F'].attrs.update({'scale_factor': 0.5, 'add_offset': 20.0, '_FillValue': -999})
    result = convert(tmp_path, '', document(), files=['a.nc'])
    assert np.array_equal(readings(tmp_path), 1e3 * (20.0 + 0.5 * np.delete(packed, 3)))
    assert 'missing readings of hydraulic_load, left out: 1' in result.warnings[0]


@pytest.mark.parametrize('scale', ['a tenth', np.array([]), np.array([1.0, 2.0])])
def test_a_scale_that_is_no_number_is_refused(tmp_path: Path, scale: object) -> None:
    with h5py.File(tmp_path / 'a.nc', 'w') as file:
        file['t'], file['w'] = 0.01 * np.arange(ROWS), np.ones(ROWS)
        file['F'] = np.arange(ROWS, dtype=np.int16)
        file['F'].attrs['scale_factor'] = scale
    with pytest.raises(ImportingError, match=r'nc: F: its attribute scale_factor is .*: give one'):
        convert(tmp_path, '', document(), files=['a.nc'])


def test_a_column_that_is_there_and_is_not_read_is_refused_with_the_reason(tmp_path) -> None:
    with h5py.File(tmp_path / 'a.h5', 'w') as file:
        file['run/F'], file['W'] = np.ones(ROWS, dtype=complex), np.ones((ROWS, 4))
    savemat(tmp_path / 'a.mat', {'F': np.ones(ROWS, dtype=complex), 'W': np.ones((ROWS, 4))})
    for name, why in (('a.h5', 'it is of type complex128'), ('a.mat', 'no vector or matrix of')):
        with pytest.raises(ImportingError, match=f"'F' of .* is not read, because .*{why}"):
            convert(tmp_path, '', document(), files=[name])
        seen = draft_map(open_sources([tmp_path / name]))[1]
        (line,) = [line for line in seen if ': not read, because' in line]
        assert 'F: not' in line


def test_an_infinite_reading_is_left_out_without_a_word_of_numpy(tmp_path: Path) -> None:
    loads = ['1e999' if i == 7 else f'{i}.5' for i in range(ROWS)]
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        result = convert(tmp_path, plain_table(F=loads), document())
    assert len(readings(tmp_path)) == ROWS - 1
    assert 'missing readings of hydraulic_load, left out: 1' in result.warnings[0]
