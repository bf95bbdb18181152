"""Output of the demo: timed steps, with a bar on a terminal and lines in a pipe."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Any


class Console:
    """The steps of the demo, printed one after another."""

    def __init__(self, steps: int) -> None:
        self._steps, self._step = steps, 0
        self._began = time.monotonic()
        self._progress: Any = None
        self._task: Any = None
        self._said = ''

    def __enter__(self) -> Console:
        if sys.stderr.isatty():
            from rich.console import Console as RichConsole
            from rich.progress import Progress

            self._progress = Progress(console=RichConsole(stderr=True), transient=True)
            self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        if self._progress is not None:
            self._progress.stop()

    @property
    def seconds(self) -> float:
        """Since the start."""
        return time.monotonic() - self._began

    def step(self, words: str) -> None:
        """Go on to the next step."""
        self._step += 1
        self.say(f'[{self._step}/{self._steps}] {words}')

    def say(self, words: str) -> None:
        """One line on standard output."""
        self._end_task()
        if self._progress is not None and sys.stdout.isatty():
            self._progress.console.file.flush()
        print(f'{self.seconds:5.1f} s  {words}', flush=True)

    def show(self, share: float, words: str) -> None:
        """How far the present step is; on a terminal only."""
        if self._progress is None:
            return
        if self._task is None:
            self._task = self._progress.add_task('', total=1.0)
        self._progress.update(self._task, completed=share, description=words)

    def stage(self, stage: str, share: float, words: str) -> None:
        """How far a stage is: a bar on a terminal; in a pipe one line when it begins."""
        if self._progress is not None:
            self.show(share, f'{stage}  {words}')
        elif stage != self._said:
            self._said = stage
            print(f'{self.seconds:5.1f} s        {stage}', flush=True)

    def _end_task(self) -> None:
        self._said = ''
        if self._task is not None:
            self._progress.remove_task(self._task)
            self._progress.refresh()
            self._task = None
