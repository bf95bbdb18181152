"""One protocol for the progress and the cancellation of every computation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from saddlering_ros.errors import Cancelled

__all__ = ['Cancelled', 'IsCancelled', 'OnProgress', 'Progress', 'check']


@dataclass(frozen=True, slots=True)
class Progress:
    """One report of a running computation.

    task: 'read', 'identify', 'validate' or 'diagnose'; stage: the present step, in words; share:
    the part of the task or stage that is done, 0 to 1; detail: a figure to show, or ''.
    """

    task: str
    stage: str
    share: float
    detail: str = ''


OnProgress = Callable[[Progress], None]
"""Called from the thread that computes, several times a second at most."""

IsCancelled = Callable[[], bool]
"""Asked between steps; once it returns True the computation raises `Cancelled`."""


def check(is_cancelled: IsCancelled | None, task: str, partial: object = None) -> None:
    """Raise `Cancelled` if the caller has asked for it."""
    if is_cancelled is not None and is_cancelled():
        raise Cancelled(f'{task}: cancelled', partial)
