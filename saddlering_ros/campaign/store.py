"""The store of a campaign: a folder with one result file per session, tables and status.

Results are written whole and are named by the key of their task. Any number of workers may
therefore write into one store, and an interrupted campaign continues with the missing results.
"""

from dataclasses import asdict, dataclass, field
import hashlib
import json
from pathlib import Path
from typing import Any

from saddlering_ros.errors import counted, SaddleringError
from saddlering_ros.files import write_text

RESULTS, REPORTS, STATUS = 'results', 'reports', 'status.json'
HASH = 'sha256'
"""Key of the hash over all else that a result file holds."""


@dataclass
class Status:
    """How far a campaign is: times [s since 1970], and how many of its sessions have a result.

    failed: of those done; computed: in this run; faults: failures of our own, not of the bags;
    altered: result files that were damaged or changed, and were computed again.
    """

    total: int
    done: int = 0
    failed: int = 0
    started: float = 0.0
    updated: float = 0.0
    slots: int = 0
    computed: int = 0
    running: bool = True
    faults: int = 0
    altered: list[str] = field(default_factory=list)

    def add(self, document: dict[str, Any], *, new: bool) -> None:
        self.done += 1
        self.computed += new
        if document['status'] == 'failed':
            self.failed += 1
            self.faults += document.get('kind') != 'refused'

    def __str__(self) -> str:
        parts = [f'{self.done} of {counted(self.total, "session")}', f'{self.failed} failed']
        passed = self.updated - self.started
        if passed > 0.0 and self.computed:
            parts.append(f'{3600.0 * self.computed / passed:.0f} an hour')
            if self.done < self.total:
                left = (self.total - self.done) * passed / self.computed
                parts.append(f'{left / 60.0:.0f} min left')
        return ', '.join(parts)


@dataclass(frozen=True)
class Store:
    """A store at `folder`."""

    folder: Path

    @property
    def reports(self) -> Path:
        return self.folder / REPORTS

    def prepare(self) -> None:
        """Make the folders; CampaignError where that is impossible."""
        try:
            for name in (RESULTS, REPORTS):
                (self.folder / name).mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise CampaignError(f'{self.folder}: cannot be made ({problem.strerror}): choose '
                                'another --out') from problem

    def place_of(self, key: str) -> Path:
        return self.folder / RESULTS / f'{key}.json'

    def has_result(self, key: str, attempt: int = 0) -> bool:
        """Whether a whole result of this or a later attempt is there."""
        result = self.read_result(key)
        return result is not None and int(result.get('attempt', 0)) >= attempt

    def read_result(self, key: str) -> dict[str, Any] | None:
        """The result of a task; None where there is none, or only a damaged or altered file."""
        try:
            document = json.loads(self.place_of(key).read_text(encoding='utf-8'))
        except (OSError, ValueError):
            return None
        if not isinstance(document, dict) or document.get('key') != key:
            return None
        return document if document.pop(HASH, '') == _hash_of(document) else None

    def write_result(self, document: dict[str, Any]) -> None:
        """Keep a result, whole or not at all, with the hash of its content."""
        content = json.loads(json.dumps(document))
        whole = {**content, HASH: _hash_of(content)}
        write_text(self.place_of(document['key']), json.dumps(whole) + '\n', CampaignError)

    def write_status(self, status: Status) -> None:
        write_text(self.folder / STATUS, json.dumps(asdict(status)) + '\n', CampaignError)

    def read_status(self) -> Status:
        """How far the campaign is; CampaignError where there is no campaign."""
        try:
            return Status(**json.loads((self.folder / STATUS).read_text(encoding='utf-8')))
        except (OSError, ValueError, TypeError) as problem:
            raise CampaignError(f'{self.folder}: holds no campaign: give the --out of a '
                                'campaign') from problem


def _hash_of(document: dict[str, Any]) -> str:
    """SHA-256 of a result as JSON with sorted keys."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


class CampaignError(SaddleringError):
    """A folder, a manifest or a store that a campaign cannot use."""


class CampaignInterruptedError(CampaignError):
    """The executor is gone or was stopped; computed results are in the store."""
