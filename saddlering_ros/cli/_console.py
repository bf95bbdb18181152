"""The console on standard output: as wide as the terminal, or wide enough when piped."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

PIPED_WIDTH = 160


def stdout_console() -> Console:
    """A console that prints plain text of a fixed width into pipes and files."""
    import sys

    from rich.console import Console

    if sys.stdout.isatty():
        return Console(markup=False, highlight=False)
    return Console(width=PIPED_WIDTH, markup=False, highlight=False, soft_wrap=True)
