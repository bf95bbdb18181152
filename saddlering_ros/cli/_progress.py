"""Progress of a command on stderr, if that is a terminal: stage, bar, share, time left."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from saddlering_ros.bags.scan import OnShare
    from saddlering_ros.progress import Progress


class Bar:
    """One line per stage on a terminal; no output elsewhere."""

    def __enter__(self) -> Bar:
        import sys

        self._progress: Any = None
        self._tasks: dict[str, Any] = {}
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                Progress,
                TaskProgressColumn,
                TextColumn,
                TimeElapsedColumn,
                TimeRemainingColumn,
            )

            self._progress = Progress(
                TextColumn('{task.description}', markup=False), BarColumn(), TaskProgressColumn(),
                TimeElapsedColumn(), TextColumn('left'), TimeRemainingColumn(),
                console=Console(stderr=True), transient=True)
            self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        if self._progress is not None:
            self._progress.stop()

    def tell(self, progress: Progress) -> None:
        """Show the progress of a computation; an identification gets a line for each stage."""
        if progress.task == 'identify':
            self.show(progress.stage, progress.share, progress.detail)
        else:
            self.show(progress.task, progress.share, progress.stage)

    def reading(self, path: Path | str) -> OnShare:
        """Callback that shows the share of a bag that was read."""
        from saddlering_ros.bags.directory import announced

        words = announced(path)
        return lambda share: self.show(f'read {Path(path).name}', share, words)

    def show(self, task: str, share: float, words: str = '') -> None:
        """Show the share of a task that is done (0 to 1); `words` describe its present step."""
        if self._progress is None:
            return
        if task not in self._tasks:
            self._tasks[task] = self._progress.add_task(task, total=1.0)
        self._progress.update(self._tasks[task], completed=share,
                              description=f'{task}  {words}' if words else task)
