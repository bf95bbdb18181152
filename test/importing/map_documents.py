"""Maps and tables as tests need them: one clock, a load, and one column for all probes."""

from collections.abc import Sequence
import json
from pathlib import Path
from typing import Any

from logger_files import CHANNELS
import numpy as np
import pytest

from saddlering_ros.bags.reader import read_raw
from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.convert import import_files, ImportResult
from saddlering_ros.importing.mapping import read_map

ROWS = 50
TIME = {'column': 't', 'unit': 's', 'start': '2026-11-20T08:00:00Z'}
LOAD = {'column': 'F', 'unit': 'kN'}
PROBE = {'column': 'w', 'unit': 'mm', 'range': [0, 0.002]}
TEST = {'test': 'dynamic', 'elevation_deg': 50}


def document(load: dict[str, Any] | None = None, probe: dict[str, Any] | None = None,
             **sections: Any) -> dict[str, Any]:
    channels = {name: dict(probe or PROBE) for name in CHANNELS[1:]}
    return {'time': TIME, 'channels': {CHANNELS[0]: load or LOAD, **channels}, 'test': TEST,
            **sections}


def table(**columns: list[str]) -> str:
    rows = zip(*columns.values(), strict=True)
    return '\n'.join([';'.join(columns), *(';'.join(row) for row in rows)]) + '\n'


def plain_table(**columns: list[str]) -> str:
    given = {'t': [f'{0.01 * i:.2f}' for i in range(ROWS)],
             'F': [f'{10 + i / 7:.4f}' for i in range(ROWS)],
             'w': [f'{1 + i / 900:.5f}' for i in range(ROWS)]}
    return table(**{**given, **columns})


def convert(folder: Path, text: str, map_: dict[str, Any] | str, files: Sequence[str] = (),
            **options: Any) -> ImportResult:
    """Import `text` as a.csv, or `files` of the folder."""
    if text:
        (folder / 'a.csv').write_text(text)
    (folder / 'map.yaml').write_text(map_ if isinstance(map_, str) else json.dumps(map_))
    return import_files([folder / name for name in files or ['a.csv']],
                        read_map(folder / 'map.yaml'), folder / 'bag', **options)


def readings(folder: Path, name: str = CHANNELS[0]) -> np.ndarray:
    values: np.ndarray = read_raw(folder / 'bag').topics[f'/rig/{name}'].values
    return values


def refusal(folder: Path, map_: Any, text: str = '', **options: Any) -> str:
    with pytest.raises(ImportingError) as caught:
        convert(folder, text or plain_table(), map_, **options)
    assert '\n' not in str(caught.value)
    return str(caught.value)


def cells(text: str, name: str) -> np.ndarray:
    head, *rows = [line.split(';') for line in text.split()]
    return np.array([float(row[head.index(name)]) for row in rows])


def stamps(folder: Path) -> np.ndarray:
    found: np.ndarray = read_raw(folder / 'bag').topics['/rig/hydraulic_load'].stamps
    return found
