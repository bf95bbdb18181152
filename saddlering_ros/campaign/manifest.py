"""The manifest: a table with one line per bag that gives its session and its role.

The store keeps it as manifest.parquet and as manifest.csv; an edited CSV overrides the grouping.
"""

from __future__ import annotations

from collections.abc import Sequence
import csv
from dataclasses import dataclass
from datetime import datetime, timezone
import io
from pathlib import Path
from typing import Any

from saddlering_ros.campaign.discovery import FoundBag
from saddlering_ros.campaign.errors import CampaignError
from saddlering_ros.campaign.sessions import FIT, HOLD_OUT, Member, ROLES, Session
from saddlering_ros.files import whole_file, write_text
from saddlering_ros.plain_yaml import read_regular_text

COLUMNS = (
    'bag', 'session', 'ring', 'bench', 'date', 'test', 'elevation_deg', 'role', 'service_hours',
    'maintenance', 'note', 'sha256',
)
YES = ('1', 'true', 'yes')


MAX_MANIFEST = 64 << 20
"""Size of the largest manifest that is read [bytes]."""


@dataclass(frozen=True)
class ManifestLine:
    """One line of the table as text; a person may change `session` and `role`."""

    values: dict[str, str]

    def __getitem__(self, name: str) -> str:
        return self.values.get(name, '').strip()


def manifest_rows(sessions: Sequence[Session]) -> list[dict[str, str]]:
    """The table of `sessions`, a row a bag."""
    return [
        {
            'bag': str(member.bag.path), 'session': session.name, 'ring': session.ring,
            'bench': session.bench, 'date': _date(member.bag.time),
            'test': member.bag.fact('test'), 'elevation_deg': member.bag.fact('elevation_deg'),
            'role': member.role,
            'service_hours': '' if session.service_hours is None else f'{session.service_hours:g}',
            'maintenance': 'yes' if session.maintenance else '',
            'note': member.bag.problem or member.note, 'sha256': member.bag.sha256,
        }
        for session in sessions for member in session.members
    ]


def write_manifest(folder: Path, sessions: Sequence[Session]) -> None:
    """manifest.parquet and manifest.csv in `folder`, each whole or not at all."""
    import pyarrow
    import pyarrow.parquet

    rows = manifest_rows(sessions)
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator='\n')
    writer.writeheader()
    writer.writerows(rows)
    write_text(folder / 'manifest.csv', text.getvalue(), CampaignError)
    schema = pyarrow.schema([(name, pyarrow.string()) for name in COLUMNS])
    table = pyarrow.Table.from_pylist(rows, schema=schema)
    with whole_file(folder / 'manifest.parquet', CampaignError) as temporary:
        pyarrow.parquet.write_table(table, temporary)


def read_manifest(path: Path, bags: Sequence[FoundBag]) -> list[Session]:
    """Sessions as the CSV at `path` groups `bags`; bags that it does not name are left out.

    CampaignError names the line that cannot be used.
    """
    known = {str(bag.path): bag for bag in bags}
    known |= {str(bag.path.resolve()): bag for bag in bags}
    groups: dict[str, list[tuple[Member, ManifestLine]]] = {}
    for number, line in enumerate(_lines(path), start=2):
        where = f'{path}: line {number}'
        bag = known.get(line['bag']) or known.get(str(Path(line['bag']).resolve()))
        if bag is None:
            raise CampaignError(f'{where}: {line["bag"] or "no bag"} is not under the folder: '
                                'correct the path or remove the line')
        role = line['role'] or FIT
        if role not in ROLES:
            raise CampaignError(f'{where}: role is {role!r}: give {", ".join(ROLES)}')
        if not line['session']:
            raise CampaignError(f'{where}: session is empty: give the name of a session')
        groups.setdefault(line['session'], []).append((Member(bag, role, line['note']), line))
    return [_session(path, name, lines) for name, lines in groups.items()]


def _lines(path: Path) -> list[ManifestLine]:
    text = read_regular_text(path, CampaignError, MAX_MANIFEST)
    reader = csv.DictReader(io.StringIO(text.removeprefix('\ufeff')))
    missing = [name for name in ('bag', 'session') if name not in (reader.fieldnames or [])]
    if missing:
        raise CampaignError(f'{path}: has no column {missing[0]!r}: its columns are '
                            f'{", ".join(COLUMNS)}')
    return [ManifestLine({key: value or '' for key, value in row.items() if key})
            for row in reader]


def _session(path: Path, name: str, lines: list[tuple[Member, ManifestLine]]) -> Session:
    members = tuple(member for member, _ in lines)
    first = lines[0][1]
    rings = {line['ring'] for _, line in lines if line['ring']}
    if len(rings) > 1:
        raise CampaignError(f'{path}: session {name!r} has bags of the rings '
                            f'{", ".join(sorted(rings))}: give each ring a session of its own')
    times = [member.bag.time for member in members if member.bag.time is not None]
    time = _time(path, first['date']) if first['date'] else min(times, default=None)
    return Session(
        name, first['ring'] or members[0].bag.ring, first['bench'] or members[0].bag.bench, time,
        members, _hours(path, first['service_hours']),
        any(line['maintenance'].lower() in YES for _, line in lines))


def _hours(path: Path, text: str) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        raise CampaignError(f'{path}: service_hours is {text!r}: give hours as a number') from None


def _time(path: Path, text: str) -> float:
    try:
        date = datetime.fromisoformat(text.replace('Z', '+00:00'))
    except ValueError:
        raise CampaignError(f'{path}: date is {text!r}: give it as 2026-11-20 or '
                            '2026-11-20T08:00:00Z') from None
    return date.replace(tzinfo=date.tzinfo or timezone.utc).timestamp()


def _date(time: float | None) -> str:
    if time is None:
        return ''
    return datetime.fromtimestamp(time, timezone.utc).isoformat(timespec='seconds')


def session_table(sessions: Sequence[Session]) -> list[dict[str, Any]]:
    """Table shown before a campaign starts, a row a session."""
    return [
        {
            'session': session.name, 'ring': session.ring, 'rig': session.bench,
            'date': session.date,
            'tests': ', '.join(sorted(
                bag.test + (' (held out)' if role == HOLD_OUT else '')
                for role in (FIT, HOLD_OUT) for bag in session.of_role(role))),
            'note': session.problem or '; '.join(
                f'{member.bag.path.name}: {member.note}'
                for member in session.members if member.note),
        }
        for session in sessions
    ]
