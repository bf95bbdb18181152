"""A short record of a rig, and writers of it in every format that is imported."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
import struct
from typing import Any
import zlib

import h5py
import nptdms
import numpy as np
from scipy.io import savemat

START = 1_790_000_000_123_456_789
CHANNELS = ('hydraulic_load', *(f'eddy_current_{number}' for number in (1, 2, 3, 4)))


@dataclass(frozen=True)
class Record:
    """Stamps (N,) [ns], and the readings of the five channels [N], [m] as a bag holds them."""

    stamps: np.ndarray
    load: np.ndarray
    gaps: np.ndarray

    def readings(self) -> dict[str, np.ndarray]:
        return dict(zip(CHANNELS, (self.load, *self.gaps), strict=True))


def make_record(rows: int = 400, period: int = 500_000) -> Record:
    rng = np.random.default_rng(5)
    jitter = rng.integers(0, period // 3, rows)
    stamps = START + np.arange(rows) * period + jitter
    gaps = np.float32(1e-3 + 1e-5 * rng.standard_normal((4, rows))).astype(float)
    return Record(stamps, 1e5 + 1e4 * rng.standard_normal(rows), gaps)


def write_csv(path: Path, record: Record) -> str:
    lines = ['Time,' + ','.join(CHANNELS)]
    for row, stamp in enumerate(record.stamps.tolist()):
        seconds = f'{stamp // 10**9}.{stamp % 10**9:09d}'
        lines.append(','.join([seconds, *(repr(float(v[row]))
                                          for v in record.readings().values())]))
    path.write_text('\n'.join(lines) + '\n')
    return '{column: Time, unit: s}'


def write_tdms(path: Path, record: Record) -> str:
    times = record.stamps.astype('datetime64[ns]')
    stamps = [nptdms.types.TimeStamp(time) for time in times]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [nptdms.ChannelObject('Messung', name, values)
             for name, values in record.readings().items()] +
            [nptdms.ChannelObject('Messung', 'Zeit', stamps)])
    return '{column: Zeit, format: file}'


def write_mat5(path: Path, record: Record) -> str:
    savemat(path, {'t': record.stamps.reshape(-1, 1),
                   'data': record.readings()}, do_compression=True)
    return '{column: t, unit: ns}'


def write_mat73(path: Path, record: Record) -> str:
    """As MATLAB does: an HDF5 file behind 512 bytes of its own, matrices the other way round."""
    with h5py.File(path, 'w', userblock_size=512) as file:
        for name, values in {'t': record.stamps, **record.readings()}.items():
            item = file.create_dataset(name, data=values.reshape(1, -1))
            item.attrs['MATLAB_class'] = np.bytes_('int64' if name == 't' else 'double')
    with path.open('r+b') as file:
        file.write(b'MATLAB 7.3 MAT-file, Platform: GLNXA64'.ljust(124) + b'\0\2IM')
    return '{column: t, unit: ns}'


def write_hdf5(path: Path, record: Record) -> str:
    with h5py.File(path, 'w') as file:
        file.create_dataset('run/t', data=record.stamps, chunks=True, compression='gzip')
        for name, values in record.readings().items():
            item = file.create_dataset(f'run/{name}', data=values)
            item.attrs['unit'] = 'N' if name == CHANNELS[0] else 'm'
    return '{column: run/t, unit: ns}'


def write_mdf4(path: Path, record: Record, *, zipped: bool = True) -> str:
    """One sorted group: a master of whole nanoseconds by a linear conversion, and the channels."""
    stamps = record.stamps - record.stamps[0]
    table = np.empty(len(stamps), dtype=[('t', '<i8')] + [(name, '<f8') for name in CHANNELS])
    table['t'] = stamps
    for name, values in record.readings().items():
        table[name] = values
    path.write_bytes(mdf4_bytes(int(record.stamps[0]), table, zipped))
    return '{from: file}'


def mdf4_bytes(start: int, table: np.ndarray, zipped: bool) -> bytes:
    """An MDF 4.10 file with one group; its first column is the master [ns]."""
    data = bytearray(b'MDF     4.10    test    \0\0\0\0'.ljust(64, b'\0'))
    data[28:30] = struct.pack('<H', 410)

    def block(name: str, links: Sequence[int], content: bytes) -> int:
        place = len(data)
        size = 24 + 8 * len(links) + len(content)
        data.extend(struct.pack('<4s4xQQ', name.encode(), size, len(links)))
        data.extend(struct.pack(f'<{len(links)}Q', *links) + content)
        data.extend(b'\0' * (-len(data) % 8))
        return place

    header = block('##HD', [0] * 6, struct.pack('<QhhBBBxdd', start, 60, 0, 0, 0, 0, 0.0, 0.0))
    channels = 0
    for name in reversed(table.dtype.names or ()):
        kind, offset = table.dtype[name], table.dtype.fields[name][1]  # type: ignore[index]
        is_master = name == (table.dtype.names or ())[0]
        text = block('##TX', [], name.encode() + b'\0')
        stated = b's' if is_master else b'N' if name == CHANNELS[0] else b'm'
        unit = block('##TX', [], stated + b'\0')
        conversion = block('##CC', [0] * 4, struct.pack(
            '<BBHHHdddd', 1, 0, 0, 0, 2, 0.0, 0.0, 0.0, 1e-9)) if is_master else 0
        channels = block('##CN', [channels, 0, text, 0, conversion, 0, unit, 0], struct.pack(
            '<BBBBIIIIBxHdddddd', 2 if is_master else 0, int(is_master),
            4 if kind.kind == 'f' else 2, 0, offset, 8 * kind.itemsize, 0, 0, 0, 0, *[0.0] * 6))
    group = block('##CG', [0, channels, 0, 0, 0, 0], struct.pack(
        '<QQHHIII', 0, len(table), 0, 0, 0, table.itemsize, 0))
    raw = table.tobytes()
    if zipped:
        turned = np.frombuffer(raw, np.uint8).reshape(len(table), -1).T.tobytes()
        packed = zlib.compress(turned)
        records = block('##DZ', [], b'DT' + struct.pack(
            '<BxIQQ', 1, table.itemsize, len(raw), len(packed)) + packed)
    else:
        records = block('##DT', [], raw)
    first = block('##DG', [0, group, records, 0], struct.pack('<Q', 0))
    struct.pack_into('<Q', data, header + 24, first)
    return bytes(data)


WRITERS: dict[str, tuple[str, Callable[..., str]]] = {
    'CSV': ('a.csv', write_csv), 'TDMS': ('a.tdms', write_tdms), 'MAT 5': ('a.mat', write_mat5),
    'MAT 7.3': ('b.mat', write_mat73), 'HDF5': ('a.h5', write_hdf5), 'MDF4': ('a.mf4', write_mdf4),
    'MDF4 plain': ('a.mf4', partial(write_mdf4, zipped=False))}


def map_text(time: str, **changes: Any) -> str:
    """A map of columns that are named as their channels; `changes` replace whole sections."""
    channels = ''.join(
        f'  {name}: {{column: {name}, unit: {"N" if name == CHANNELS[0] else "m"}'
        f'{"" if name == CHANNELS[0] else ", range: [0, 0.002]"}}}\n' for name in CHANNELS)
    sections = {'time': time, 'channels': f'\n{channels}',
                'test': '{test: dynamic, elevation_deg: 50, rig: SR-017, operator: J. Doe, '
                        'date: 2026-11-20, service_hours: 120, slew_deg: 90, ring: R 7, '
                        'bench: 2, maintenance: true}', **changes}
    return '\n'.join(f'{key}: {value}' for key, value in sections.items()) + '\n'
