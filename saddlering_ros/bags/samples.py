"""Displacements as a table by the stamps of a record, and its files (CSV, Parquet)."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import BagError
from saddlering_ros.files import Provenance, whole_file
from saddlering_ros.record.batches import BRIDGED, Displacements, DOUBTFUL_LOAD, NOT_KNOWN
from saddlering_ros.record.record import Record
from saddlering_ros.rig import CHANNELS

COLUMNS = ('stamp_ns', 'time', 'load', 'delta_x', 'delta_y', 'gamma', 'parity', 'validity')
SUFFIXES = ('.csv', '.parquet')

Columns = dict[str, NDArray[Any]]
"""The columns of a stretch of the table by their names in `COLUMNS`."""


def displacement_columns(run: Record, batch: Displacements) -> Columns:
    """Displacements of a run, measured, simulated or their difference, as a table.

    time [s] counts from the record's first load stamp; load [N]; delta_x, delta_y, parity [m] and
    gamma [rad], NaN where not known; validity is 0 where all four are known from sound readings,
    else a sum of the constants of RingDisplacement.msg.
    """
    rows = np.searchsorted(run.stamps, batch.stamps)
    return {'stamp_ns': batch.stamps, 'time': run.time[rows], 'load': run.load[rows],
            **dict(zip(CHANNELS, batch.channels, strict=True)), 'validity': batch.validity}


@dataclass
class SamplesSummary:
    """Summary of a stream of samples; values of each column by its name."""

    count: int = 0  # of samples
    lowest: dict[str, float] = field(default_factory=dict)
    highest: dict[str, float] = field(default_factory=dict)
    last: dict[str, float] = field(default_factory=dict)  # at the last sample, NaN where unknown
    at_peak: dict[str, float] = field(default_factory=dict)  # at the highest load
    validity: dict[str, int] = field(default_factory=dict)  # numbers of samples

    def watch(self, parts: Iterable[Columns]) -> Iterator[Columns]:
        """Pass stretches of the table on and count them."""
        for columns in parts:
            if len(columns['load']):
                self._add(columns)
            yield columns

    def _add(self, columns: Columns) -> None:
        peak = int(columns['load'].argmax())
        if not self.count or columns['load'][peak] > self.at_peak['load']:
            self.at_peak = {name: float(column[peak]) for name, column in columns.items()}
        for name, column in columns.items():
            low, high = float(np.fmin.reduce(column)), float(np.fmax.reduce(column))
            self.lowest[name] = float(np.fmin(low, self.lowest.get(name, low)))
            self.highest[name] = float(np.fmax(high, self.highest.get(name, high)))
            self.last[name] = float(column[-1])
        self.count += len(columns['load'])
        marks = columns['validity']
        masks = {'sound': marks == 0,
                 **{f'without {name}': marks & bit > 0 for name, bit in NOT_KNOWN.items()},
                 'bridged': marks & BRIDGED > 0, 'by a doubtful load': marks & DOUBTFUL_LOAD > 0}
        for words, mask in masks.items():
            self.validity[words] = self.validity.get(words, 0) + int(np.count_nonzero(mask))


def check_table_path(path: Path) -> None:
    """Raise BagError, before any work is done, if no table can be written at `path`."""
    if path.suffix.lower() not in SUFFIXES:
        raise BagError(f'{path}: the name ends in neither .csv nor .parquet: give one of these')


def write_samples(path: Path, parts: Iterable[Columns],
                  provenance: Provenance | None = None) -> None:
    """Write the stretches of a table at `path`, whole or not at all.

    CSV numbers have the fewest digits that give the same float. A parquet file has the provenance
    in the metadata `saddlering.provenance` of its schema (JSON).
    """
    check_table_path(path)
    with whole_file(path, BagError) as temporary:
        if path.suffix.lower() == '.csv':
            with temporary.open('w', encoding='ascii', newline='') as file:
                file.writelines(csv_lines(parts))
        else:
            import pyarrow
            from pyarrow import parquet

            metadata = None if provenance is None else {
                'saddlering.provenance': json.dumps(provenance.as_dict())}
            schema = pyarrow.schema(
                [(name, {'stamp_ns': pyarrow.int64(), 'validity': pyarrow.uint8()}.get(
                    name, pyarrow.float64())) for name in COLUMNS], metadata)
            with parquet.ParquetWriter(temporary, schema, compression='zstd') as writer:
                for columns in parts:
                    writer.write_table(pyarrow.table(columns, schema))


def csv_lines(parts: Iterable[Columns]) -> Iterator[str]:
    """The lines of the CSV file, the names of the columns first."""
    yield ','.join(COLUMNS) + '\n'
    for columns in parts:
        for row in zip(*(column.tolist() for column in columns.values()), strict=True):
            yield ','.join(map(repr, row)) + '\n'
