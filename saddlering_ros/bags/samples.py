"""Displacement samples as a table, and the files (CSV, parquet) that hold it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.measured import MeasuredRun
from saddlering_ros.provenance import Provenance
from saddlering_ros.rig import CHANNELS, Displacement
from saddlering_ros.writing import whole_file

COLUMNS = ('stamp_ns', 'time', 'load', 'delta_x', 'delta_y', 'gamma', 'parity')
SUFFIXES = ('.csv', '.parquet')


@dataclass(frozen=True)
class DisplacementSamples:
    """Displacements at N stamps, measured or simulated, as the live nodes publish them.

    stamps (N,) int64 [ns]; time (N,) [s] since the record's first load stamp; load (N,) [N];
    displacement: delta_x, delta_y, parity [m] and gamma [rad], of (N,) arrays.
    """

    stamps: NDArray[np.int64]
    time: NDArray[np.float64]
    load: NDArray[np.float64]
    displacement: Displacement

    def __len__(self) -> int:
        return len(self.stamps)

    def finite(self) -> DisplacementSamples:
        """Those samples whose displacement is known."""
        kept = np.isfinite([getattr(self.displacement, name) for name in CHANNELS]).all(axis=0)
        displacement = Displacement(
            **{name: np.asarray(getattr(self.displacement, name))[kept] for name in CHANNELS})
        return DisplacementSamples(self.stamps[kept], self.time[kept], self.load[kept],
                                   displacement)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Every column by its name in `COLUMNS`."""
        channels = {name: np.asarray(getattr(self.displacement, name)) for name in CHANNELS}
        return {'stamp_ns': self.stamps, 'time': self.time, 'load': self.load, **channels}


def measured_samples(measured: MeasuredRun) -> DisplacementSamples:
    """The samples of a measured run at which all four probes have a reading."""
    kept = measured.complete
    displacement = Displacement(
        **{name: np.asarray(getattr(measured.displacement, name))[kept] for name in CHANNELS})
    return DisplacementSamples(
        measured.stamps[kept], measured.time[kept], measured.load[kept], displacement)


def check_table_path(path: Path) -> None:
    """Raise BagError, before any work is done, if no table can be written at `path`."""
    if path.suffix.lower() not in SUFFIXES:
        raise BagError(f'{path}: the name ends in neither .csv nor .parquet: give one of these')
    if path.is_dir():
        raise BagError(f'{path}: is a directory: give the name of a file')


def write_samples(
    path: Path, samples: DisplacementSamples, provenance: Provenance | None = None,
) -> None:
    """Write the table at `path` as its suffix says, whole or not at all.

    CSV numbers are the shortest that read back as the same float. A parquet file carries the
    provenance as the schema's metadata `saddlering.provenance` (JSON); CSV has no place for it.
    """
    check_table_path(path)
    with whole_file(path, BagError) as temporary:
        if path.suffix.lower() == '.csv':
            with temporary.open('w', encoding='ascii', newline='') as file:
                file.writelines(csv_lines(samples))
        else:
            _write_parquet(temporary, samples, provenance)


def csv_lines(samples: DisplacementSamples) -> Iterator[str]:
    """The lines of the CSV file, the names of the columns first."""
    columns = samples.columns()
    yield ','.join(columns) + '\n'
    for row in zip(*(column.tolist() for column in columns.values()), strict=True):
        yield ','.join(map(repr, row)) + '\n'


def _write_parquet(
    path: Path, samples: DisplacementSamples, provenance: Provenance | None,
) -> None:
    import pyarrow
    from pyarrow import parquet

    table = pyarrow.table(samples.columns())
    if provenance is not None:
        table = table.replace_schema_metadata(
            {'saddlering.provenance': json.dumps(provenance.as_dict())})
    parquet.write_table(table, path, compression='zstd')
