"""What a command prints: JSON or a summary on standard output, progress on a terminal."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import Console

    from saddlering_ros.api.results import Result
    from saddlering_ros.bags.scan import OnShare
    from saddlering_ros.progress import Progress

PIPED_WIDTH = 160  # so that no row of a table is broken in a file


def stdout_console() -> Console:
    """The console on standard output: as wide as the terminal, or wide enough in a pipe."""
    from rich.console import Console

    if sys.stdout.isatty():
        return Console(markup=False, highlight=False)
    return Console(width=PIPED_WIDTH, markup=False, highlight=False, soft_wrap=True)


def show_table(
    titles: Sequence[str], rows: Iterable[Sequence[str]], *, texts: int = 1,
) -> None:
    """Print a table; the first `texts` columns hold words, the others numbers."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for place, title in enumerate(titles):
        table.add_column(title, justify='left' if place < texts else 'right', overflow='fold')
    for row in rows:
        table.add_row(*row)
    stdout_console().print(table)


def tell_json(args: argparse.Namespace, told: Any) -> bool:
    """Write `told` to the place of --json, if given; whether this is standard output."""
    from saddlering_ros.files import write_text

    if args.json is None:
        return False
    document = json.dumps(told, indent=2)
    if args.json == '-':
        print(document, flush=True)  # some commands run for hours
        return True
    write_text(args.json, document + '\n')
    return False


def finish(args: argparse.Namespace, result: Result, *written: Path | None) -> int:
    """Write the report; print a result of the API as JSON, or as summary and files; the status."""
    pages = () if args.report is None else result.write_report(
        args.report, command=args.command_line)
    if args.json is not None and tell_json(args, result.to_json()):
        return 0
    print(result.summary())
    for path in (*written, *pages):
        if path is not None:
            print(f'written: {path}')
    return 0


class Bar:
    """One line per stage on a terminal; no output elsewhere."""

    def __enter__(self) -> Bar:
        self._progress: Any = None
        self._tasks: dict[str, Any] = {}
        if sys.stderr.isatty():
            from rich import progress
            from rich.console import Console

            self._progress = progress.Progress(
                progress.TextColumn('{task.description}', markup=False), progress.BarColumn(),
                progress.TaskProgressColumn(), progress.TimeElapsedColumn(),
                progress.TextColumn('left'), progress.TimeRemainingColumn(),
                console=Console(stderr=True), transient=True)
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
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
        return lambda share: self.show(f'read {Path(path).name}', share)

    def show(self, task: str, share: float, words: str = '') -> None:
        """Show the share of a task that is done (0 to 1); `words` describe its present step."""
        if self._progress is None:
            return
        if task not in self._tasks:
            self._tasks[task] = self._progress.add_task(task, total=1.0)
        self._progress.update(self._tasks[task], completed=share,
                              description=f'{task}  {words}' if words else task)
