"""A task: one session to be diagnosed, as plain data for any process on any machine.

A task is a pure function of its bags, its rig, its settings and the program. Its key is the hash
of these, and its seed comes from the key, so that a result is the same wherever it is computed.
`run` is the job of a worker process (`jobs.worker`): the verdict, or the reason why there is none.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
import hashlib
import json
from pathlib import Path
from pkgutil import resolve_name
import resource
from typing import Any

from saddlering_ros.api.inputs import origins
from saddlering_ros.bags.folder import open_directory
from saddlering_ros.campaign.sessions import base_of, FIT, HOLD_OUT, Session
from saddlering_ros.errors import ReportError, SaddleringError
from saddlering_ros.files import sha256_of_file, versions_in_use
from saddlering_ros.progress import IsCancelled, OnProgress
from saddlering_ros.rig import default_rig, Rig

BASE = 'base'
"""Role of a bag of the base measurement with which a session is compared."""

VERDICT = 'saddlering_ros.campaign.task:session_verdict'
"""The function that judges a session; benchmarks and tests put another in its place."""

SECONDS, MEMORY = 1800.0, 6 << 30
"""Usual limits of a session: wall time [s] and address space [bytes]."""


@dataclass(frozen=True)
class TaskBag:
    """One bag of a task: its place, the hash of its files, and its use."""

    path: str
    sha256: str
    role: str


@dataclass(frozen=True)
class SessionTask:
    """One session to be judged; everything but `key` and `seed` is given.

    rig: path of the rig file ('' for the shipped rig), rig_sha256: of its bytes; effects: hashes
    of the user's own effect files; reports: folder for a page of every session that needs a person
    ('' for none); problem: why the session cannot be judged; attempt: how often it was tried
    before; program: versions by which the key was made; seconds, memory: longest wall time [s] and
    largest address space [bytes] of its process.
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
    effects: tuple[str, ...] = ()
    compute: str = VERDICT
    reports: str = ''
    problem: str = ''
    attempt: int = 0
    program: Mapping[str, str] = field(default_factory=dict)
    seconds: float = SECONDS
    memory: int = MEMORY

    @property
    def seed(self) -> int:
        return int(self.key[:8], 16) & 0x7FFFFFFF

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def tasks_of(sessions: Sequence[Session], rig: Path | None = None, *, compute: str = VERDICT,
             reports: Path | None = None, seconds: float = SECONDS,
             memory: int = MEMORY) -> list[SessionTask]:
    """A task a session; sessions of the same recordings, rig and settings have the same key."""
    rig_sha256 = sha256_of_file(rig) if rig is not None else ''
    effects, program = _own_effects(), versions_in_use()
    tasks: dict[str, SessionTask] = {}
    for session in sessions:
        base = base_of(session, sessions)
        by_role = {FIT: session.of_role(FIT), HOLD_OUT: session.of_role(HOLD_OUT),
                   BASE: [] if base is None else base.of_role(FIT)}
        bags = tuple(TaskBag(str(bag.path.resolve()), bag.sha256, role)
                     for role, some in by_role.items() for bag in some)
        # The inputs of the result: contents and roles, not places or limits.
        identity = {
            'bags': sorted((bag.sha256 or bag.path, bag.role) for bag in bags),
            'rig': rig_sha256, 'effects': list(effects), 'compute': compute, 'program': program,
            'problem': session.problem}
        key = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:32]
        tasks.setdefault(key, SessionTask(
            key, session.name, session.ring, session.bench, session.time, session.service_hours,
            session.maintenance, bags, '' if rig is None else str(rig.resolve()), rig_sha256,
            effects, compute, '' if reports is None else str(reports.resolve()), session.problem,
            program=program, seconds=seconds, memory=memory))
    return list(tasks.values())


def _own_effects() -> tuple[str, ...]:
    """Hashes of the user's own effect files that this process uses."""
    return tuple(sorted(origin.sha256 for origin in origins()))


def run(task: SessionTask, on_progress: OnProgress,
        is_cancelled: IsCancelled) -> dict[str, Any]:
    """Judge the session of a task within its memory; a failure is an answer too."""
    try:
        compute = resolve_name(task.compute)
        # Allow `memory` bytes of address space beyond those mapped already.
        mapped = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (mapped + task.memory, hard))
        answer = {'status': 'done', **compute(task)}
    except SaddleringError as problem:
        # The remedy is that of a campaign, which has no argument to trust another rig.
        answer = failure('refused', str(problem).replace('rig=FILE', '--rig FILE').replace(
            ', or trust_rig=True to continue with this rig', ''))
    except MemoryError:
        answer = failure('memory', f'{task.name}: needs more than {task.memory >> 20} MB: '
                                   'give a larger --memory-limit, and --retry')
    except Exception as problem:
        answer = failure('failed', f'{type(problem).__name__}: {problem}')
    changed = _changed(task)
    return failure('changed', f'{changed}: run the campaign again') if changed else answer


def _changed(task: SessionTask) -> str:
    """Which input is not the one that the key of the task names any more; '' if all are."""
    here = versions_in_use()
    others = [f'{name} {here.get(name, "none")} for {version}'
              for name, version in task.program.items() if here.get(name) != version]
    if others:
        return f'this worker runs other versions than the campaign ({", ".join(others)})'
    if _own_effects() != task.effects:
        return 'the effect files of SADDLERING_EFFECTS are not those of the campaign'
    try:
        if task.rig and sha256_of_file(task.rig) != task.rig_sha256:
            return f'{task.rig} has changed since the campaign began'
        for bag in task.bags:
            if bag.sha256 and open_directory(bag.path).sha256() != bag.sha256:
                return f'{bag.path} has changed since the campaign found it'
    except (OSError, SaddleringError) as problem:
        return str(problem)
    return ''


def failure(kind: str, reason: object) -> dict[str, Any]:
    """Entry of a result that has no verdict; the reason is put on one line."""
    return {'status': 'failed', 'kind': kind, 'reason': ' '.join(str(reason).split())}


def session_verdict(task: SessionTask) -> dict[str, Any]:
    """Diagnose the session: the JSON of docs/diagnosis.md, a covariance and a report beside it."""
    from saddlering_ros import diagnose, load_rig

    bags = {role: [bag.path for bag in task.bags if bag.role == role]
            for role in (FIT, HOLD_OUT, BASE)}
    # The key names no rig file: the worker's environment must name none either.
    rig = load_rig(task.rig) if task.rig else default_rig()
    result = diagnose(bags[FIT], hold_out=bags[HOLD_OUT], rig=rig, seed=task.seed)
    report = ''
    if task.reports and result.verdict != 'none':
        place = Path(task.reports) / f'{task.key}.html'
        try:
            result.write_report(place)
        except ReportError as problem:
            return failure('unwritten', f'{problem}: run the campaign again')
        report = f'{place.parent.name}/{place.name}'
    covariance = result.parameters.source.covariance
    return {
        'verdict': result.document,
        'covariance': None if covariance is None else covariance.tolist(),
        'report': report,
        'change': None if not bags[BASE] else change_since(
            bags[BASE], [*bags[FIT], *bags[HOLD_OUT]], rig, task.seed)}


def change_since(base: Sequence[str], bags: Sequence[str], rig: Rig, seed: int) -> dict[str, Any]:
    """The verdict on the change since the base measurement; a refusal does not end the session."""
    from saddlering_ros import compare

    try:
        return compare(base, bags, rig=rig, seed=seed).to_json()
    except SaddleringError as problem:
        return {'verdict': None, 'headline': ' '.join(str(problem).split()), 'causes': []}
