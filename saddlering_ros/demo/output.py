"""Output files of the demo: report, pictures, numbers and parameter files, all or none."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import signal
import threading
from typing import Any

from saddlering_ros.demo import figures
from saddlering_ros.demo.errors import DemoError
from saddlering_ros.demo.page import demo_page
from saddlering_ros.demo.story import DemoOutcome
from saddlering_ros.files import temporary_folder
from saddlering_ros.pages.html import pictures_of
from saddlering_ros.rig import write_parameters


def check_folder(folder: Path) -> None:
    """DemoError if the folder cannot be written; checked before the work."""
    if folder.exists() and not folder.is_dir():
        raise DemoError(f'{folder}: is not a folder: choose another place (--out)')
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not os.access(there, os.W_OK | os.X_OK):
        raise DemoError(f'{there}: cannot be written to: choose another place (--out)')


def write_all(outcome: DemoOutcome, folder: Path, command: str) -> list[Path]:
    """Write everything beside `folder` first, then move it in, at one go; the paths.

    `command` is the command line that makes the report again.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        with temporary_folder(folder.parent, f'.{folder.name}.') as staging:
            _fill(staging, outcome, command)
            files = sorted(staging.iterdir())
            with _uninterrupted():
                folder.mkdir(exist_ok=True)
                for file in files:
                    file.replace(folder / file.name)
        return [folder / file.name for file in files]
    except OSError as problem:
        raise DemoError(f'{folder}: cannot be written ({problem.strerror}): choose another place '
                        '(--out)') from problem


def _fill(staging: Path, outcome: DemoOutcome, command: str) -> None:
    page = demo_page(outcome, command)
    (staging / 'report.html').write_text(page, encoding='utf-8')
    for name, data in pictures_of(page).items():
        (staging / f'{name}.png').write_bytes(data)
    numbers = json.dumps(numbers_of(outcome), indent=2)
    (staging / 'numbers.json').write_text(numbers + '\n', encoding='utf-8')
    write_parameters(staging / 'parameters_identified.yaml', outcome.identified)
    write_parameters(staging / 'parameters_extended.yaml', outcome.extended)


def numbers_of(outcome: DemoOutcome) -> dict[str, Any]:
    """All numbers of the demo, for a program."""
    return {
        'bags': {'identify': [run.path.name for run in outcome.plan.identify],
                 'verify': [run.path.name for run in outcome.plan.verify]},
        'identification': outcome.identification,
        'verdict': outcome.verdict,
        'live': {
            'replays': [vars(item) for item in outcome.replays],
            'runs': figures.misfit_table(outcome.curves),
            'gain': outcome.gain,
        },
        'seconds': outcome.seconds,
    }


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ctrl-C waits until the files are in place."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, signals)
