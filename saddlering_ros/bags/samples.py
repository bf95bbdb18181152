"""Displacement samples as a table, and its files (CSV, Parquet)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.scan import OnShare
from saddlering_ros.files import Provenance, whole_file
from saddlering_ros.record.errors import BagError
from saddlering_ros.record.measured import given_of, MeasuredRun, validity_of
from saddlering_ros.record.record import Record
from saddlering_ros.record.scratch import blocks
from saddlering_ros.record.validity import BRIDGED, DOUBTFUL_LOAD, is_published, NOT_KNOWN
from saddlering_ros.rig import (
    CHANNELS,
    Displacement,
    gap_increment,
    measured_displacement,
    Rig,
    ZeroReading,
)

COLUMNS = ('stamp_ns', 'time', 'load', 'delta_x', 'delta_y', 'gamma', 'parity', 'validity')
SUFFIXES = ('.csv', '.parquet')


@dataclass(frozen=True)
class DisplacementSamples:
    """Displacements at N stamps, measured or simulated, as the live nodes publish them.

    stamps (N,) int64 [ns]; time (N,) [s] since the record's first load stamp; load (N,) [N];
    displacement: delta_x, delta_y, parity [m] and gamma [rad], of (N,) arrays, NaN where not
    known; validity (N,): 0 where all four are known from sound readings, else a sum of the
    constants of RingDisplacement.msg.
    """

    stamps: NDArray[np.int64]
    time: NDArray[np.float64]
    load: NDArray[np.float64]
    displacement: Displacement
    validity: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.stamps)

    def rows(self, kept: NDArray[Any]) -> DisplacementSamples:
        """The samples of a mask (N,) or of indices."""
        displacement = Displacement(
            **{name: np.asarray(getattr(self.displacement, name))[kept] for name in CHANNELS})
        return DisplacementSamples(self.stamps[kept], self.time[kept], self.load[kept],
                                   displacement, self.validity[kept])

    @property
    def is_finite(self) -> NDArray[np.bool_]:
        """Mask (N,) of samples with a known displacement in every channel."""
        known = [getattr(self.displacement, name) for name in CHANNELS]
        return np.asarray(np.isfinite(known).all(axis=0))

    def columns(self) -> dict[str, NDArray[Any]]:
        """Every column by its name in `COLUMNS`."""
        channels = {name: np.asarray(getattr(self.displacement, name)) for name in CHANNELS}
        return {'stamp_ns': self.stamps, 'time': self.time, 'load': self.load, **channels,
                'validity': self.validity}


def measured_samples(measured: MeasuredRun) -> DisplacementSamples:
    """The samples of a measured run that the live node publishes."""
    return DisplacementSamples(
        measured.stamps, measured.time, measured.load, measured.displacement,
        measured.validity).rows(measured.given)


def measured_blocks(
    rig: Rig, run: Record, zero: ZeroReading, on_progress: OnShare = lambda share: None,
) -> Iterator[DisplacementSamples]:
    """The same samples stretch by stretch, so that a long run is never in memory as a whole."""
    for part in blocks(len(run.time), run.stamps, run.time, run.load, run.gaps):
        samples, given = measured_rows(rig, run, zero, part)
        yield samples.rows(given)
        on_progress(part.stop / len(run.time))


def measured_rows(
    rig: Rig, run: Record, zero: ZeroReading, part: slice,
) -> tuple[DisplacementSamples, NDArray[np.bool_]]:
    """Displacements at the rows of a stretch of a run, and which of them the live node gives."""
    increments = gap_increment(rig.probes, run.gaps[:, part], np.array(zero.gaps))
    found = measured_displacement(rig.probes, increments)
    validity = validity_of(run, found, part)
    samples = DisplacementSamples(
        run.stamps[part], run.time[part], run.load[part], found, validity)
    return samples, given_of(run, part) & is_published(validity)


@dataclass
class SamplesSummary:
    """Summary of a stream of samples.

    count: number of samples; lowest, highest, last, at_peak: of each column by name, the last
    two at the last sample and at the highest load, NaN where unknown; validity: number of
    samples that are sound, lack a channel, were interpolated across a refused reading, or
    depend on a doubtful load.
    """

    count: int = 0
    lowest: dict[str, float] = field(default_factory=dict)
    highest: dict[str, float] = field(default_factory=dict)
    last: dict[str, float] = field(default_factory=dict)
    at_peak: dict[str, float] = field(default_factory=dict)
    validity: dict[str, int] = field(default_factory=dict)

    def watch(self, parts: Iterable[DisplacementSamples]) -> Iterator[DisplacementSamples]:
        """Pass samples on and count them."""
        for samples in parts:
            if len(samples):
                self._add(samples.columns())
            yield samples

    def _add(self, columns: dict[str, NDArray[Any]]) -> None:
        peak = int(columns['load'].argmax())
        if not self.count or columns['load'][peak] > self.at_peak['load']:
            self.at_peak = {name: float(column[peak]) for name, column in columns.items()}
        for name, column in columns.items():
            low, high = float(np.fmin.reduce(column)), float(np.fmax.reduce(column))
            self.lowest[name] = float(np.fmin(low, self.lowest.get(name, low)))
            self.highest[name] = float(np.fmax(high, self.highest.get(name, high)))
            self.last[name] = float(column[-1])
        self.count += len(columns['load'])
        self._count_validity(columns['validity'])

    def _count_validity(self, marks: NDArray[np.uint8]) -> None:
        found = {'sound': marks == 0,
                 **{f'without {name}': marks & bit > 0 for name, bit in NOT_KNOWN.items()},
                 'bridged': marks & BRIDGED > 0, 'by a doubtful load': marks & DOUBTFUL_LOAD > 0}
        for words, mask in found.items():
            self.validity[words] = self.validity.get(words, 0) + int(np.count_nonzero(mask))


def check_table_path(path: Path) -> None:
    """Raise BagError, before any work is done, if no table can be written at `path`."""
    if path.suffix.lower() not in SUFFIXES:
        raise BagError(f'{path}: the name ends in neither .csv nor .parquet: give one of these')
    if path.is_dir():
        raise BagError(f'{path}: is a directory: give the name of a file')


def write_samples(
    path: Path, samples: DisplacementSamples | Iterable[DisplacementSamples],
    provenance: Provenance | None = None,
) -> None:
    """Write the table of samples, or of stretches of them, at `path`, whole or not at all.

    CSV numbers are the shortest that read back as the same float. A parquet file carries the
    provenance as the schema's metadata `saddlering.provenance` (JSON); CSV has no place for it.
    """
    check_table_path(path)
    parts = [samples] if isinstance(samples, DisplacementSamples) else samples
    with whole_file(path, BagError) as temporary:
        if path.suffix.lower() == '.csv':
            with temporary.open('w', encoding='ascii', newline='') as file:
                file.writelines(csv_lines(parts))
        else:
            _write_parquet(temporary, parts, provenance)


def csv_lines(parts: Iterable[DisplacementSamples]) -> Iterator[str]:
    """The lines of the CSV file, the names of the columns first."""
    yield ','.join(COLUMNS) + '\n'
    for samples in parts:
        columns = samples.columns()
        for row in zip(*(column.tolist() for column in columns.values()), strict=True):
            yield ','.join(map(repr, row)) + '\n'


def _write_parquet(
    path: Path, parts: Iterable[DisplacementSamples], provenance: Provenance | None,
) -> None:
    import pyarrow
    from pyarrow import parquet

    metadata = None if provenance is None else {
        'saddlering.provenance': json.dumps(provenance.as_dict())}
    schema = pyarrow.schema(
        [(name, {'stamp_ns': pyarrow.int64(), 'validity': pyarrow.uint8()}.get(
            name, pyarrow.float64())) for name in COLUMNS], metadata)
    with parquet.ParquetWriter(path, schema, compression='zstd') as writer:
        for samples in parts:
            writer.write_table(pyarrow.table(samples.columns(), schema))
