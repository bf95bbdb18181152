"""A task: one session to be diagnosed, as plain data for any process on any machine.

A task is a pure function of its bags, its rig, its settings and the program. Its key is the hash
of these, and its seed comes from the key, so that a result is the same wherever it is computed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import hashlib
import json
from pathlib import Path
from typing import Any

from saddlering_ros.campaign.sessions import FIT, HOLD_OUT, Session
from saddlering_ros.files import sha256_of_file, versions_in_use

VERDICT = 'saddlering_ros.campaign.verdict:session_verdict'
"""The function that judges a session; benchmarks and tests put another in its place."""


@dataclass(frozen=True)
class SessionLimits:
    """Limits of one session: wall time [s] and address space [bytes] of its process."""

    seconds: float = 1800.0
    memory: int = 6 << 30


@dataclass(frozen=True)
class TaskBag:
    """One bag of a task: its place, the hash of its files, and its use."""

    path: str
    sha256: str
    role: str


@dataclass(frozen=True)
class SessionTask:
    """One session to be judged; everything but `key` and `seed` is given.

    rig: path of the rig file ('' for the shipped rig), rig_sha256: of its bytes; reports: folder
    for a page of every session that needs a person ('' for none); problem: why the session cannot
    be judged; attempt: how often it was tried before.
    """

    key: str
    name: str
    ring: str
    bench: str
    time: float | None
    service_hours: float | None
    maintenance: bool
    bags: tuple[TaskBag, ...]
    rig: str
    rig_sha256: str
    limits: SessionLimits
    compute: str = VERDICT
    reports: str = ''
    problem: str = ''
    attempt: int = 0

    @property
    def seed(self) -> int:
        """Seed of everything that is drawn."""
        return int(self.key[:8], 16) & 0x7FFFFFFF

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self)


def task_from(document: Mapping[str, Any]) -> SessionTask:
    """The task whose plain data these are."""
    values = dict(document)
    values['bags'] = tuple(TaskBag(**bag) for bag in values['bags'])
    values['limits'] = SessionLimits(**values['limits'])
    return SessionTask(**values)


def tasks_of(
    sessions: Sequence[Session], rig: Path | None = None, limits: SessionLimits | None = None, *,
    compute: str = VERDICT, reports: Path | None = None,
) -> list[SessionTask]:
    """A task a session; sessions of the same recordings, rig and settings have the same key."""
    limits = limits or SessionLimits()
    rig_sha256 = sha256_of_file(rig) if rig is not None else ''
    tasks: dict[str, SessionTask] = {}
    for session in sessions:
        bags = tuple(
            TaskBag(str(bag.path.resolve()), bag.sha256, role)
            for role in (FIT, HOLD_OUT) for bag in session.of_role(role))
        key = _key(bags, rig_sha256, compute, session)
        tasks.setdefault(key, SessionTask(
            key=key, name=session.name, ring=session.ring, bench=session.bench, time=session.time,
            service_hours=session.service_hours, maintenance=session.maintenance, bags=bags,
            rig='' if rig is None else str(rig.resolve()), rig_sha256=rig_sha256, limits=limits,
            compute=compute, reports='' if reports is None else str(reports.resolve()),
            problem=session.problem))
    return list(tasks.values())


def _key(bags: Sequence[TaskBag], rig_sha256: str, compute: str, session: Session) -> str:
    """Hash of the inputs of the result: contents and roles, not places or limits."""
    identity = {
        'bags': sorted((bag.sha256 or bag.path, bag.role) for bag in bags),
        'rig': rig_sha256, 'compute': compute, 'program': versions_in_use(),
        'problem': session.problem,
    }
    text = json.dumps(identity, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]
