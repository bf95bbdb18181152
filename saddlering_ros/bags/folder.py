"""A bag on disk: its MCAP files, their order, metadata.yaml, and the metadata of its test."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
import re
from shlex import quote
import tempfile
from typing import Any

import yaml
import zstandard

from saddlering_ros.errors import BagError
from saddlering_ros.files import sha256_of_file, sha256_of_files, temporary_folder
from saddlering_ros.plain_yaml import parse_yaml, read_regular_text, YamlRefused
from saddlering_ros.quantities import first_of
from saddlering_ros.record import record
from saddlering_ros.record.record import DETAILS, KEYS, TestMetadata

METADATA = 'metadata.yaml'
INFORMATION = 'rosbag2_bagfile_information'
SUFFIXES = ('.mcap', '.mcap.zstd')

MAX_EXPANSION = 100
"""Largest ratio of the size of a recording to that of its file [bytes]: even constant readings do
not compress further. Messages of topics that are not the rig's count with their headers only."""

OVERRULE = {'test': ', or give test=KIND', 'elevation_deg': ', or give elevation_deg=DEG'}
"""Remedies for texts of a test that a caller may replace."""

UNPACKED_FILE_ALLOWED = 1 << 26
"""Size [bytes] of an unpacked file up to which the ratio is not checked."""

MESSAGES_ALLOWED = 1 << 24
"""Size [bytes] of all messages up to which the ratio is not checked."""


@dataclass(frozen=True)
class BagDirectory:
    """The files of a bag, in order of recording, and the content of metadata.yaml."""

    path: Path
    files: tuple[Path, ...]
    custom_data: dict[str, str] = field(default_factory=dict)
    start: int | None = None  # of the recording [ns since 1970]; None: not stated
    message_count: int | None = None  # of all files; None: not stated
    message_compression: str = ''  # of each message: '' or 'zstd' (mode "message" of rosbag2)
    has_metadata: bool = False
    unlisted: tuple[str, ...] = ()  # MCAP files beside them that metadata.yaml does not list

    @property
    def name(self) -> str:
        """Name of the bag: that of its directory, or of its file without .mcap."""
        return self.path.resolve().name.removesuffix('.mcap.zstd').removesuffix('.mcap')

    @property
    def size(self) -> int:
        """Bytes of its files; a missing file counts as 0."""
        return sum(file.stat().st_size for file in self.files if file.exists())

    def sha256(self) -> str:
        """One hash of all content: that of a bare file, or sha256_of_files of a directory."""
        if self.path.is_dir():
            described = [self.path / METADATA] if self.has_metadata else []
            return sha256_of_files((file.name, file) for file in (*described, *self.files))
        return sha256_of_file(self.path)


def open_directory(path: Path | str) -> BagDirectory:
    """The bag at `path`: a rosbag2 directory, its metadata.yaml, or a bare MCAP file."""
    path = Path(path)
    try:
        if path.name == METADATA and path.is_file():
            path = path.parent
        if path.is_dir():
            return _of_directory(path)
        if not path.exists():
            raise BagError(f'{path}: there is no such bag: check the path')
    except OSError as problem:
        raise BagError(f'{path}: cannot be read ({problem.strerror}): check the path') from problem
    if path.name.endswith('.db3'):
        raise _other_storage(path, 'sqlite3')
    if not (path.is_file() and path.name.endswith(SUFFIXES)):
        raise BagError(f'{path}: is not a bag: give a rosbag2 directory or an .mcap file, or make '
                       f'one of measured files by: saddlering import {quote(str(path))} --draft')
    # A bare file; metadata.yaml beside it counts if it names the file.
    beside = path.parent / METADATA
    information: dict[str, Any] = {}
    with suppress(BagError):
        if beside.is_file():
            information = parse_metadata(read_regular_text(beside, BagError), str(beside))
    named = {Path(name).name for name in _names(information)}
    if path.name not in named:
        return BagDirectory(path, (path,))
    of_bag = _with_information(path, (path,), information)
    return of_bag if len(named) == 1 else replace(of_bag, start=None, message_count=None)


def _other_storage(path: Path, storage: str) -> BagError:
    return BagError(f'{path}: is recorded with storage {storage}: convert it with "ros2 bag '
                    'convert" to storage mcap')


@contextmanager
def plain_file(path: Path) -> Iterator[Path]:
    """The file, or a temporary copy without the compression of whole files by rosbag2."""
    if not path.name.endswith('.zstd'):
        yield path
        return
    with temporary_folder(Path(tempfile.gettempdir()), 'saddlering-') as folder:
        plain = folder / path.name.removesuffix('.zstd')
        try:
            with path.open('rb') as source, plain.open('wb') as target:
                limit = max(MAX_EXPANSION * path.stat().st_size, UNPACKED_FILE_ALLOWED)
                for block in zstandard.ZstdDecompressor().read_to_iter(source):
                    limit -= len(block)
                    if limit < 0:
                        raise BagError(
                            f'{path}: unpacks to more than {MAX_EXPANSION} times its size: '
                            'no recorder writes such a file; use another bag')
                    target.write(block)
        except zstandard.ZstdError as problem:
            raise BagError(
                f'{path}: its compressed data are damaged: copy the file again') from problem
        except OSError as problem:
            raise BagError(
                f'{path}: cannot be decompressed ({problem.strerror}): check the file and the '
                f'space in {tempfile.gettempdir()}') from problem
        yield plain


def _of_directory(path: Path) -> BagDirectory:
    # A number counts as one, so that run_10 comes behind run_9.
    files_there = sorted(
        (file for file in path.iterdir() if file.name.endswith(SUFFIXES) and file.is_file()),
        key=lambda file: [(int(text or 0), '') if text.isdecimal() else (0, text)
                          for text in re.split(r'(\d+)', file.name)])
    if not (path / METADATA).is_file():
        if files_there:
            return BagDirectory(path, tuple(files_there))
        below = sorted(str(one.parent) for one in path.glob(f'*/{METADATA}'))
        raise BagError(
            f'{path}: is not a bag, but a folder of {len(below)}: give {first_of(below, ", ")}'
            if below else f'{path}: holds no .mcap file: give a bag recorded with storage mcap')
    described = path / METADATA
    information = parse_metadata(read_regular_text(described, BagError), str(described))
    storage = _word(information, 'storage_identifier') or 'mcap'
    if storage != 'mcap':
        raise _other_storage(path, storage)
    files = tuple(dict.fromkeys(_locate(path, name) for name in _names(information)))
    of_bag = _with_information(path, files or tuple(files_there), information)
    # A player of rosbag2 leaves the plain file beside the compressed one.
    listed = {file.name.removesuffix('.zstd') for file in of_bag.files}
    return replace(of_bag, unlisted=tuple(
        file.name for file in files_there if file.name.removesuffix('.zstd') not in listed))


def _with_information(path: Path, files: tuple[Path, ...],
                      information: Mapping[str, Any]) -> BagDirectory:
    if not files:
        raise BagError(f'{path}: holds no .mcap file: give a bag recorded with storage mcap')
    mode = _word(information, 'compression_mode').lower()
    compression = _word(information, 'compression_format').lower()
    if mode == 'message' and compression != 'zstd':
        raise BagError(
            f'{path}: messages are compressed with {compression!r}, which is not supported: '
            'convert the bag with "ros2 bag convert"')
    start, count = information.get('starting_time'), information.get('message_count')
    start = start.get('nanoseconds_since_epoch') if isinstance(start, dict) else None
    return BagDirectory(path, files, custom_data_of(information),
                        start if isinstance(start, int) and 0 <= start < 1 << 63 else None,
                        count if isinstance(count, int) else None,
                        compression if mode == 'message' else '', True)


def parse_metadata(text: str, where: str) -> dict[str, Any]:
    """The part of a rosbag2 metadata text that describes the bag; BagError if there is none."""
    try:
        document = parse_yaml(text)
    except YamlRefused as problem:
        raise BagError(f'{where}: {problem.reason.partition(": ")[0]}: copy the bag again, or '
                       'remove this file') from problem
    except yaml.YAMLError as problem:
        raise BagError(
            f'{where}: is not YAML: copy the bag again, or remove this file') from problem
    information = document.get(INFORMATION, document) if isinstance(document, dict) else None
    if isinstance(information, dict):
        return information
    raise BagError(f'{where}: does not describe a bag: copy the bag again, or remove this file')


def _locate(folder: Path, name: str) -> Path:
    """A file of the bag, also if metadata.yaml names its former folder; none outside the bag."""
    steps = Path(name).parts
    inside = not Path(name).is_absolute() and '..' not in steps
    for candidate in (folder / name,) * inside + (folder / Path(name).name,):
        if candidate.name.endswith(SUFFIXES) and candidate.is_file():
            return candidate
    raise BagError(
        f'{folder}: {METADATA} names {Path(name).name}, which is missing: copy the whole bag')


def _names(information: Mapping[str, Any]) -> list[str]:
    value = information.get('relative_file_paths')
    return [name for name in value if isinstance(name, str)] if isinstance(value, list) else []


def _word(information: Mapping[str, Any], key: str) -> str:
    value = information.get(key)
    return value if isinstance(value, str) else ''


def custom_data_of(information: Mapping[str, Any]) -> dict[str, str]:
    """The plain values of custom_data as text; other values are left out."""
    mapping = information.get('custom_data')
    return {} if not isinstance(mapping, dict) else {
        key: str(value) for key, value in mapping.items()
        if isinstance(value, (str, int, float)) and isinstance(key, str)}


def find_metadata(custom_data: Mapping[str, str], in_file: Mapping[str, str],
                  recorder: Mapping[str, str]) -> TestMetadata:
    """The test metadata on which the places of a bag agree.

    `custom_data` of metadata.yaml and `in_file`, the MCAP record `saddlering.test`, have the same
    weight: either is enough, and both must agree. `recorder`, the custom_data that rosbag2 itself
    writes into the MCAP file, fills gaps: a reindexing removes custom_data from metadata.yaml.
    """
    first, second, third = (
        {key: text.strip() for key, text in place.items() if text.strip()}
        for place in (custom_data, in_file, recorder))
    conflicts = {
        key: f'{key} is {first[key]!r} in metadata.yaml and {second[key]!r} in the MCAP record '
             f'{record.METADATA_RECORD}: correct one{OVERRULE.get(key, "")}'
        for key in (*KEYS, *DETAILS) if key in first and key in second
        and not record.same_text(key, first[key], second[key])}
    values = {key: text for key, text in {**third, **second, **first}.items()
              if key not in conflicts}
    faults = []
    test, elevation = values.get('test', ''), values.get('elevation_deg', '')
    kind = test.lower() if test.lower() in record.KINDS else None
    if test and kind is None:
        faults.append(f"test is {test!r}, which is not a kind of test: give test='static' or "
                      "test='dynamic'")
    low, high = record.LOWEST_ELEVATION, record.HIGHEST_ELEVATION
    degrees = record.finite_number(elevation)
    if degrees is not None and not low <= degrees <= high:
        degrees = None
    if elevation and degrees is None:
        faults.append(f'elevation_deg is {elevation!r}, which is not an elevation from {low:g} to '
                      f'{high:g} degrees: give elevation_deg=DEG')
    details = {key: values[key] for key in DETAILS if key in values}
    return TestMetadata(kind, degrees, values.get('rig', ''), values.get('run', ''), details,
                        tuple(conflicts.values()), tuple(faults))
