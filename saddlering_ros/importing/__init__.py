"""Measured files of a data logger as bags: readers of formats, maps, calibration, conversion."""

from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.convert import import_files, ImportedRun, ImportResult
from saddlering_ros.importing.draft import Draft, draft_map
from saddlering_ros.importing.mapping import ImportMap, parse_map, read_map
from saddlering_ros.importing.preview import save_preview
from saddlering_ros.importing.source import open_sources

__all__ = [
    'Draft', 'ImportMap', 'ImportResult', 'ImportedRun', 'ImportingError', 'draft_map',
    'import_files', 'open_sources', 'parse_map', 'read_map', 'save_preview',
]
