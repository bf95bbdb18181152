"""One protocol for the progress and the cancellation of every computation, and its threads.

The API, the commands, the diagnosis of any simulator and the action jobs follow it: a computation
calls `on_progress` with a `Progress`, asks `is_cancelled` between steps, and raises `Cancelled`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
import sys
import time as clock
from typing import TYPE_CHECKING

from saddlering_ros.errors import Cancelled

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


@dataclass(frozen=True, slots=True)
class SearchStep:
    """The iteration of the identification behind a report.

    best_parameters: in SI units, in the order of the file; spread: of the swarm, 1 at its start.
    """

    iteration: int
    iterations: int
    best_objective: float
    best_parameters: tuple[float, ...]
    spread: float


@dataclass(frozen=True, slots=True)
class Progress:
    """One report of a running computation.

    task: 'read', 'displacement', 'simulate', 'identify', 'validate', 'diagnose', 'compare' or
    'plan'; stage: the present step, in words, or the bag; share: the part of the task or stage
    that is done, 0 to 1; detail: a figure to show, or ''; search: the iteration of an
    identification.
    """

    task: str
    stage: str
    share: float
    detail: str = ''
    search: SearchStep | None = None

    @property
    def words(self) -> str:
        """The present step as a phrase: 'refinement', 'read static_50'."""
        return f'{self.task} {self.stage}' if self.task in ('read', 'validate') else self.stage


def show_progress(report: Progress) -> None:
    """Show progress as one line of a notebook or a terminal: `on_progress=show_progress`."""
    done = round(20 * min(max(report.share, 0.0), 1.0))
    text = f'{report.words}: {"#" * done}{"." * (20 - done)} {report.share:.0%} {report.detail}'
    print(f'\r{text[:79]:79s}', end='\n' if report.share >= 1.0 else '', flush=True)


OnProgress = Callable[[Progress], None]
"""Called from the thread that computes, several times a second at most."""

IsCancelled = Callable[[], bool]
"""Asked between steps; once it returns True the computation raises `Cancelled`."""

TELL_EVERY, TELL_LEFT_FROM = 0.5, 5.0
"""Seconds between two reports of one stage, and after which the time left is estimated."""

LAST_SHARE, STAGE_LEFT = 0.97, 0.5
"""Share that work in a stage leads towards, and the work after which half of the way to it is
done in the first stage, in usual amounts; in a later one, what was done before it is added."""


@dataclass
class Watch:
    """The caller of one task: who gets its reports and may cancel it.

    stage, share: as reported last; began, told: times of the task and of that report [s]; worked:
    work of the task and of the stage, in the usual amount of the task; entered: share at the
    begin of the stage.
    """

    task: str
    on_progress: OnProgress | None = None
    is_cancelled: IsCancelled | None = None
    stage: str = field(default='', init=False)
    share: float = field(default=0.0, init=False)
    began: float = field(default_factory=lambda: clock.monotonic(), init=False)
    told: float = field(default=0.0, init=False)
    worked: tuple[float, float] = field(default=(0.0, 0.0), init=False)
    entered: float = field(default=0.0, init=False)

    def progress(self, stage: str, share: float) -> None:
        """Report a new stage and the share of the task that is done."""
        self.stage, self.told = stage, -TELL_EVERY
        self.advance(share)
        self.entered, self.worked = self.share, (self.worked[0], 0.0)

    def work(self, amount: float) -> None:
        """Advance by work, in the usual amount of the task, in a stage whose end is not known."""
        whole, own = (before + amount for before in self.worked)
        self.worked = whole, own
        self.advance(self.entered + (LAST_SHARE - self.entered) * own / (whole + STAGE_LEFT))

    def advance(self, share: float) -> None:
        """Report a share within the stage, with the time left, if the last report is old."""
        self.share, now = max(share, self.share), clock.monotonic()
        if self.on_progress is None or now - self.told < TELL_EVERY:
            return
        self.told, spent = now, now - self.began
        left = spent * (1.0 / self.share - 1.0) if self.share > 0.0 else 0.0
        detail = f'about {left:.2g} s left' if spent > TELL_LEFT_FROM and left > 0.0 else ''
        self.on_progress(Progress(self.task, self.stage, self.share, detail))

    def check(self) -> None:
        """Raise `Cancelled` if the caller has asked for it."""
        if self.is_cancelled is not None and self.is_cancelled():
            raise Cancelled(f'{self.task}: cancelled')


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let BLAS use one thread until the block ends; also a decorator.

    The matrices of a fit are small: more threads wait for each other, and they take processors
    from the simulator, which uses all of them by itself.
    """
    with _libraries(len(sys.modules)).limit(limits=1, user_api='blas'):
        yield


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    """Those that have threads; the search takes up to 10 ms. Another module may load another."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
