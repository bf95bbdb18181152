"""Results as tables: columns, pandas data frames, CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import csv
from pathlib import Path
from typing import Any, TYPE_CHECKING

from saddlering_ros.api.errors import ApiError
from saddlering_ros.files import whole_file

if TYPE_CHECKING:
    import pandas

Columns = Mapping[str, Sequence[Any]]


def dataframe(columns: Columns) -> pandas.DataFrame:
    """Columns as a pandas DataFrame; ApiError if pandas is not installed."""
    try:
        import pandas
    except ModuleNotFoundError as problem:
        raise ApiError('to_dataframe needs pandas: pip install pandas, or use columns(), which '
                       'gives the same as plain lists') from problem
    return pandas.DataFrame(dict(columns))


def columns_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Rows with the same keys as lists by key."""
    return {key: [row[key] for row in rows] for key in (rows[0] if rows else {})}


def write_csv(path: Path, columns: Columns) -> None:
    """Write columns as CSV, whole or not at all; an empty cell for None."""
    with whole_file(path, ApiError) as temporary, temporary.open(
            'w', encoding='utf-8', newline='') as file:
        table = csv.writer(file)
        table.writerow(columns)
        table.writerows(zip(*columns.values(), strict=True))
