"""The bags under a folder, their sessions, and the manifest in which a person corrects both.

A session is the tests of one ring on one rig within a short time. The store keeps the manifest,
a line a bag, as manifest.parquet and as manifest.csv; an edited CSV overrides the grouping.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
import csv
from dataclasses import dataclass, replace
from datetime import datetime, timezone
import io
import math
import os
from pathlib import Path

from mcap.reader import SeekingReader

from saddlering_ros.bags import folder as bags
from saddlering_ros.campaign.store import CampaignError
from saddlering_ros.errors import BagError, plain_number
from saddlering_ros.files import whole_file, write_csv
from saddlering_ros.plain_yaml import read_regular_text
from saddlering_ros.quantities import own_names
from saddlering_ros.record.record import METADATA_RECORD

FIT, HOLD_OUT, SKIP = 'fit', 'hold_out', 'skip'
ROLES = (FIT, HOLD_OUT, SKIP)

COLUMNS = (
    'bag', 'session', 'ring', 'bench', 'date', 'test', 'elevation_deg', 'role', 'service_hours',
    'maintenance', 'base', 'note', 'sha256')
YES = ('1', 'true', 'yes')
CORRECTED = b'corrected'
"""Key in manifest.parquet of a grouping that a person has made."""

MAX_MANIFEST = 64 << 20
"""Size of the largest manifest that is read [bytes]."""


@dataclass(frozen=True)
class FoundBag:
    """One bag as found, with its use in a session; its readings have not been read.

    path: the rosbag2 directory or the bare file; sha256: of its files; time [s since 1970] of the
    test, None if unknown; metadata: the test metadata (docs/bags.md), text to text; problem: why
    the bag cannot be used ('' if it can); role: fit, hold_out or skip; note: the reason.
    """

    path: Path
    sha256: str = ''
    time: float | None = None
    metadata: tuple[tuple[str, str], ...] = ()
    problem: str = ''
    role: str = FIT
    note: str = ''

    def fact(self, name: str) -> str:
        """One entry of the test metadata, '' if the bag does not state it."""
        return dict(self.metadata).get(name, '').strip()

    def says(self, name: str) -> bool:
        """Whether the bag states yes to this."""
        return self.fact(name).lower() in YES

    @property
    def ring(self) -> str:
        """Which ring was tested: `ring` of the metadata, else `rig`, else the folder.

        With its path, because folders of several rings may have the same name, such as a date.
        """
        return self.fact('ring') or self.fact('rig') or str(self.path.parent)

    @property
    def bench(self) -> str:
        """Which test rig did it: `bench` of the metadata, else the rig file's hash, else ''."""
        return self.fact('bench') or self.fact('rig_hash')[:12]


@dataclass(frozen=True)
class Session:
    """Tests of one ring that are judged together.

    time [s since 1970] of the first test, None if unknown; maintenance: whether the ring was
    serviced since the session before; is_base: whether it is a base measurement, with which the
    later sessions of the ring are compared.
    """

    name: str
    ring: str
    bench: str
    time: float | None
    bags: tuple[FoundBag, ...]
    service_hours: float | None = None
    maintenance: bool = False
    is_base: bool = False

    @property
    def date(self) -> str:
        return _date(self.time)[:10]

    @property
    def tests(self) -> str:
        """Its tests in words, without those that are skipped."""
        return ', '.join(sorted(
            f'{bag.fact("test") or "?"} {bag.fact("elevation_deg") or "?"}'
            + (' (held out)' if role == HOLD_OUT else '')
            for role in (FIT, HOLD_OUT) for bag in self.of_role(role)))

    def of_role(self, role: str) -> list[FoundBag]:
        return [bag for bag in self.bags if bag.role == role]

    @property
    def problem(self) -> str:
        """Why the session cannot be judged, '' if it can."""
        faults = [bag.problem for bag in self.bags if bag.problem]
        if faults or self.of_role(FIT):
            return faults[0] if faults else ''
        return f'{self.name}: no bag is left to fit: change a role in the manifest'


def base_of(session: Session, sessions: Sequence[Session]) -> Session | None:
    """The last base measurement of the ring before a session that is none itself."""
    if session.is_base or session.time is None:
        return None
    earlier = [(other.time, number) for number, other in enumerate(sessions)
               if other.is_base and other.ring == session.ring and not other.problem
               and other.time is not None and other.time < session.time]
    return sessions[max(earlier)[1]] if earlier else None


def find_bags(folder: Path | str,
              on_progress: Callable[[int], None] = lambda count: None) -> list[FoundBag]:
    """Every bag under `folder` at any depth, in order of path; links to folders are not followed.

    A folder with metadata.yaml, or with .mcap files of one split recording, is one bag; any other
    .mcap file is a bag of its own. CampaignError where there is no such folder.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise CampaignError(f'{folder}: is not a folder: give the folder that holds the bags')
    found = []
    for here, folders, names in os.walk(folder):
        folders.sort()
        place = Path(here)
        recordings = sorted(name for name in names if name.endswith(bags.SUFFIXES))
        # rosbag2 names the parts of a split recording after their folder: name_0, name_1, ...
        is_split = len(recordings) > 1 and {file.partition('.mcap')[0] for file in recordings} == {
            f'{place.name}_{number}' for number in range(len(recordings))}
        if bags.METADATA in names:
            folders.clear()
        for path in ([place] if is_split or bags.METADATA in names else
                     [place / name for name in recordings]):
            found.append(_look_at(path))
            on_progress(len(found))
    return found


def _look_at(path: Path) -> FoundBag:
    """The bag at `path` by its summaries alone, no message is read; a fault is its `problem`."""
    try:
        directory = bags.open_directory(path)
        metadata, start = dict(directory.custom_data), directory.start
        for file in () if metadata and start is not None else directory.files:
            # One of six unrelated types of damage; reading the bag will report it.
            with suppress(Exception), bags.plain_file(file) as plain, plain.open('rb') as stream:
                reader = SeekingReader(stream)
                for record in reader.iter_metadata():
                    if record.name == METADATA_RECORD:
                        metadata = {**record.metadata, **metadata}
                summary = reader.get_summary()
                if start is None and summary is not None and summary.statistics is not None:
                    start = summary.statistics.message_start_time
        time, notes = None if start is None else start / 1e9, []
        date, hours = (metadata.get(key, '').strip() for key in ('date', 'service_hours'))
        try:
            time = _seconds(date) if date else time
        except ValueError:
            notes.append(f'date is {date!r}, and the first stamp counts: write it as 2026-11-20')
        try:
            _hours(hours or '0')
        except ValueError:
            notes.append(f'service_hours is {hours!r}, and is left out: give hours as a number')
        return FoundBag(path, directory.sha256(), time, tuple(sorted(metadata.items())),
                        note='; '.join(notes))
    except BagError as fault:
        return FoundBag(path, problem=str(fault))
    except OSError as fault:
        return FoundBag(path, problem=f'{path}: cannot be read ({fault.strerror}): check the path')


def group_sessions(bags: Sequence[FoundBag], gap: float = 24 * 3600.0,
                   hold_out: float | None = None) -> list[Session]:
    """Sessions of `bags`, ordered by ring and time; a second copy of a recording is skipped.

    gap [s]: a longer time without a test begins another session; hold_out: elevation [degrees]
    whose tests are held out where a session has other elevations too, None for none.
    """
    groups: dict[tuple[str, str], list[FoundBag]] = {}
    seen: dict[str, FoundBag] = {}
    for bag in bags:
        first = seen.setdefault(bag.sha256, bag) if bag.sha256 else bag
        says_nothing = bag.problem or not (bag.metadata or bag.time)
        key = (str(bag.path), 'unreadable') if says_nothing else (bag.ring, bag.bench)
        groups.setdefault(key, []).append(bag if first is bag else replace(
            bag, role=SKIP, note=f'same recording as {first.path}'))
    parts: list[list[FoundBag]] = []
    for _, tests in sorted(groups.items()):
        last: float | None = None
        tests.sort(key=lambda bag: (bag.time or -math.inf, str(bag.path)))
        for place, bag in enumerate(tests):
            now = bag.time
            near = now == last if now is None or last is None else now - last <= gap
            if place and near:
                parts[-1].append(bag)
            else:
                parts.append([bag])
            last = now
    sessions = [_session(tests, hold_out) for tests in parts]
    return [replace(session, name=name) for session, name in zip(
        sessions, own_names(session.name for session in sessions), strict=True)]


def _session(bags: list[FoundBag], hold_out: float | None) -> Session:
    fitted = {bag.fact('elevation_deg') for bag in bags if bag.role == FIT}
    apart, wanted = set[str](), math.nan if hold_out is None else hold_out
    for text in fitted:
        with suppress(ValueError):
            if math.isclose(plain_number(text), wanted, abs_tol=1e-6):
                apart.add(text)
    if fitted - apart:
        bags = [replace(bag, role=HOLD_OUT)
                if bag.role == FIT and bag.fact('elevation_deg') in apart else bag for bag in bags]
    first, hours = bags[0], []
    for bag in bags:
        with suppress(ValueError):
            hours.append(_hours(bag.fact('service_hours')))
    return Session(
        f'{first.ring} {_date(first.time)[:10]}'.strip(), first.ring,
        '' if first.problem else first.bench, first.time, tuple(bags), min(hours, default=None),
        any(bag.says('maintenance') for bag in bags), any(bag.says('base') for bag in bags))


def write_manifest(folder: Path, sessions: Sequence[Session], given: Path | None = None) -> None:
    """manifest.parquet and manifest.csv in `folder`, each whole or not at all.

    given: the manifest that made these sessions. Without one, CampaignError where manifest.csv
    holds corrections, which would be lost.
    """
    import pyarrow
    import pyarrow.parquet

    place = folder / 'manifest.csv'
    with suppress(OSError, pyarrow.ArrowInvalid):
        before = pyarrow.parquet.read_table(folder / 'manifest.parquet')
        text = io.StringIO(place.read_text(encoding='utf-8', errors='replace'), newline='')
        if given is None and (CORRECTED in (before.schema.metadata or {})
                              or list(csv.DictReader(text)) != before.to_pylist()):
            raise CampaignError(f'{place}: holds corrections: give --manifest {place}, or remove '
                                'the file to group the bags anew')
    rows = [(
        str(bag.path), session.name, session.ring, session.bench, _date(bag.time),
        bag.fact('test'), bag.fact('elevation_deg'), bag.role,
        '' if session.service_hours is None else f'{session.service_hours:g}',
        'yes' if session.maintenance else '', 'yes' if session.is_base else '',
        bag.problem or bag.note, bag.sha256) for session in sessions for bag in session.bags]
    columns = dict(zip(COLUMNS, zip(*rows, strict=True) if rows else [()] * len(COLUMNS),
                       strict=True))
    write_csv(place, columns, CampaignError)
    schema = pyarrow.schema([(name, pyarrow.string()) for name in COLUMNS],
                            {} if given is None else {CORRECTED: b'yes'})
    with whole_file(folder / 'manifest.parquet', CampaignError) as temporary:
        pyarrow.parquet.write_table(pyarrow.table(columns, schema=schema), temporary)


def read_manifest(path: Path, bags: Sequence[FoundBag]) -> list[Session]:
    """Sessions as the CSV at `path` groups `bags`; bags that it does not name are left out.

    A person may change `session` and `role`. CampaignError names the line that cannot be used.
    """
    by_path = {str(place): bag for bag in bags for place in (bag.path, bag.path.resolve())}
    text = read_regular_text(path, CampaignError, MAX_MANIFEST)
    delimiter = ';' if ';' in text.partition('\n')[0] else ','  # as some spreadsheets write it
    reader = csv.DictReader(io.StringIO(text.removeprefix('\ufeff')), delimiter=delimiter,
                            strict=True)
    try:
        rows, fields = list(reader), reader.fieldnames or []
    except csv.Error as problem:
        raise CampaignError(f'{path}: line {reader.line_num + 1}: is no table ({problem}): '
                            'correct its quotation marks') from problem
    missing = [name for name in ('bag', 'session') if name not in fields]
    if missing:
        raise CampaignError(f'{path}: has no column {missing[0]!r}: its columns are '
                            f'{", ".join(COLUMNS)}')
    groups: dict[str, tuple[list[FoundBag], list[dict[str, str]]]] = {}
    for number, row in enumerate(rows, start=2):
        line = {name: (row[name] or '').strip() for name in COLUMNS if name in row}
        where = f'{path}: line {number}'
        bag = by_path.get(line['bag']) or by_path.get(str(Path(line['bag']).resolve()))
        if bag is None:
            raise CampaignError(f'{where}: {line["bag"] or "no bag"} is not under the folder: '
                                'correct the path or remove the line')
        role = line.get('role') or FIT
        if role not in ROLES:
            raise CampaignError(f'{where}: role is {role!r}: give {", ".join(ROLES)}')
        if not line['session']:
            raise CampaignError(f'{where}: session is empty: give the name of a session')
        used, lines = groups.setdefault(line['session'], ([], []))
        used.append(replace(bag, role=role, note=line.get('note', bag.note)))
        lines.append(line)
    return [_session_of_lines(path, name, *group) for name, group in groups.items()]


def _session_of_lines(path: Path, name: str, bags: Sequence[FoundBag],
                      lines: Sequence[Mapping[str, str]]) -> Session:
    first, own = lines[0], _session(list(bags), None)  # own: by the metadata
    for column, words in (('ring', 'give each ring a session of its own'),
                          ('service_hours', 'give a session one')):
        stated = sorted({line.get(column, '') for line in lines} - {''})
        if len(stated) > 1:
            raise CampaignError(f'{path}: {column} of the session {name!r} is '
                                f'{" and ".join(stated)}: {words}')
    try:
        hours = _hours(stated[0]) if stated else None
    except ValueError:
        raise CampaignError(f'{path}: service_hours is {stated[0]!r}: give hours as a number'
                            ) from None
    times = [bag.time for bag in bags if bag.time is not None]
    try:
        time = _seconds(first['date']) if first.get('date') else min(times, default=None)
    except ValueError:
        raise CampaignError(f'{path}: date is {first["date"]!r}: give it as 2026-11-20 or '
                            '2026-11-20T08:00:00Z') from None
    said = {column: any(line[column].lower() in YES for line in lines)
            for column in ('maintenance', 'base') if column in first}
    return Session(
        name, first.get('ring') or bags[0].ring, first.get('bench') or bags[0].bench, time,
        tuple(bags), hours if 'service_hours' in first else own.service_hours,
        said.get('maintenance', own.maintenance), said.get('base', own.is_base))


def _seconds(text: str) -> float:
    """The time [s since 1970] of an ISO date, in UTC where it states no zone.

    ValueError for another text, and for a date that no stamp shows, as 0001-01-01 of a clock that
    was not set.
    """
    date = datetime.fromisoformat(text.replace('Z', '+00:00'))
    time = date.replace(tzinfo=date.tzinfo or timezone.utc).timestamp()
    if not 0.0 <= time < (1 << 63) / 1e9:
        raise ValueError(text)
    return time


def _hours(text: str) -> float:
    """Hours of service, 0 or more; ValueError for another text."""
    hours = plain_number(text)
    if not 0.0 <= hours < math.inf:
        raise ValueError(text)
    return hours


def _date(time: float | None) -> str:
    if time is None:
        return ''
    return datetime.fromtimestamp(time, timezone.utc).isoformat(timespec='seconds')
