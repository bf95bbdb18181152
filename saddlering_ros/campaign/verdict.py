"""The verdict of one session as a plain document, computed by a worker."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

from saddlering_ros.campaign.sessions import FIT, HOLD_OUT
from saddlering_ros.campaign.task import SessionTask


@lru_cache(maxsize=1)
def prepare() -> None:
    """Load the program and its compiled kernels once, before children are forked."""
    from saddlering_ros import diagnosis  # noqa: F401
    from saddlering_ros.ring.warm import warm

    warm()


def session_verdict(task: SessionTask) -> dict[str, Any]:
    """Diagnose the session; the JSON of interfaces.md, the covariance and a report beside it."""
    from saddlering_ros.diagnosis import diagnose_bags
    from saddlering_ros.rig import load_rig

    bags = {role: [bag.path for bag in task.bags if bag.role == role] for role in (FIT, HOLD_OUT)}
    rig = load_rig(task.rig or None)
    verdict = diagnose_bags(bags[FIT], bags[HOLD_OUT], rig, seed=task.seed)
    report = ''
    if task.reports and verdict.verdict != 'none':
        from saddlering_ros.report import write_diagnosis_report

        place = Path(task.reports) / f'{task.key}.html'
        write_diagnosis_report(verdict, place)
        report = f'{place.parent.name}/{place.name}'
    return {
        'verdict': verdict.to_json(),
        'covariance': verdict.contact_law.covariance.tolist(),
        'report': report,
    }
