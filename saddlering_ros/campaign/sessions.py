"""Bags grouped into sessions: the tests of one ring on one rig within a short time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
import math

from saddlering_ros.campaign.discovery import FoundBag

FIT, HOLD_OUT, SKIP = 'fit', 'hold_out', 'skip'
ROLES = (FIT, HOLD_OUT, SKIP)


@dataclass(frozen=True)
class Grouping:
    """How bags become sessions.

    gap [s]: a longer time without a test begins another session; hold_out: elevation [degrees]
    whose tests are held out where a session has other elevations too, None for none.
    """

    gap: float = 24 * 3600.0
    hold_out: float | None = None


@dataclass(frozen=True)
class Member:
    """One bag in a session, and its use: fit, hold_out or skip; note: the reason."""

    bag: FoundBag
    role: str = FIT
    note: str = ''


@dataclass(frozen=True)
class Session:
    """Tests of one ring that are judged together.

    time [s since 1970] of the first test, None if unknown; maintenance: whether the ring was
    serviced since the session before.
    """

    name: str
    ring: str
    bench: str
    time: float | None
    members: tuple[Member, ...]
    service_hours: float | None = None
    maintenance: bool = False

    @property
    def date(self) -> str:
        """Day of the first test, '' if unknown."""
        if self.time is None:
            return ''
        return datetime.fromtimestamp(self.time, timezone.utc).strftime('%Y-%m-%d')

    def of_role(self, role: str) -> list[FoundBag]:
        """Bags that are used for this."""
        return [member.bag for member in self.members if member.role == role]

    @property
    def problem(self) -> str:
        """Why the session cannot be judged, '' if it can."""
        faults = [member.bag.problem for member in self.members if member.bag.problem]
        if faults:
            return faults[0]
        if not self.of_role(FIT):
            return f'{self.name}: no bag is left to fit: change a role in the manifest'
        return ''


def group_sessions(bags: Sequence[FoundBag], grouping: Grouping | None = None) -> list[Session]:
    """Sessions of `bags`, ordered by ring and time; a second copy of a recording is skipped."""
    grouping = grouping or Grouping()
    groups: dict[tuple[str, str], list[Member]] = {}
    seen: dict[str, FoundBag] = {}
    for bag in bags:
        first = seen.get(bag.sha256) if bag.sha256 else None
        member = Member(bag)
        if first is not None:
            member = Member(bag, SKIP, f'same recording as {first.path}')
        else:
            seen[bag.sha256] = bag
        key = (str(bag.path), 'unreadable') if bag.problem else (bag.ring, bag.bench)
        groups.setdefault(key, []).append(member)
    sessions = []
    for (ring, bench), members in sorted(groups.items()):
        for part in _parts_by_time(members, grouping.gap):
            sessions.append(_session(ring, bench, part, grouping))
    return _named_apart(sessions)


def _parts_by_time(members: Sequence[Member], gap: float) -> list[list[Member]]:
    ordered = sorted(members, key=lambda item: (item.bag.time or -math.inf, str(item.bag.path)))
    parts: list[list[Member]] = []
    for member in ordered:
        last = parts[-1][-1].bag.time if parts else None
        now = member.bag.time
        near = parts and (last is None) == (now is None) and (
            last is None or now is None or now - last <= gap)
        if near:
            parts[-1].append(member)
        else:
            parts.append([member])
    return parts


def _session(ring: str, bench: str, members: list[Member], grouping: Grouping) -> Session:
    elevations = {member.bag.fact('elevation_deg') for member in members if member.role == FIT}
    apart = [text for text in elevations if _is_elevation(text, grouping.hold_out)]
    if apart and len(elevations) > len(apart):
        members = [
            replace(member, role=HOLD_OUT)
            if member.role == FIT and member.bag.fact('elevation_deg') in apart else member
            for member in members
        ]
    first = members[0].bag
    if bench == 'unreadable':
        ring, bench = first.ring, ''
    hours = [item.bag.service_hours for item in members if item.bag.service_hours is not None]
    serviced = any(item.bag.fact('maintenance').lower() in ('1', 'true', 'yes')
                   for item in members)
    session = Session('', ring, bench, first.time, tuple(members), min(hours, default=None),
                      serviced)
    return replace(session, name=f'{ring} {session.date}'.strip())


def _is_elevation(text: str, wanted: float | None) -> bool:
    try:
        return wanted is not None and math.isclose(float(text), wanted, abs_tol=1e-6)
    except ValueError:
        return False


def _named_apart(sessions: Sequence[Session]) -> list[Session]:
    count: dict[str, int] = {}
    answer = []
    for session in sessions:
        number = count[session.name] = count.get(session.name, 0) + 1
        name = session.name if number == 1 else f'{session.name} ({number})'
        answer.append(replace(session, name=name))
    return answer
