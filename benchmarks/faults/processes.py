"""Processes of the campaign: their memory, their children, what they leave behind."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
import time

MARK = 'SADDLERING_FAULTS'


def resident(pid: int) -> int:
    """Memory of a process [bytes]."""
    with contextlib.suppress(OSError, IndexError):
        return int(Path(f'/proc/{pid}/statm').read_text().split()[1]) * os.sysconf('SC_PAGE_SIZE')
    return 0


def children_of(pid: int) -> list[int]:
    with contextlib.suppress(OSError):
        return [int(word) for task in Path(f'/proc/{pid}/task').iterdir()
                for word in (task / 'children').read_text().split()]
    return []


def lives(pid: int) -> bool:
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


def marked() -> list[str]:
    """Processes that carry this campaign's mark, but this one."""
    mark = f'{MARK}={os.environ[MARK]}'.encode()
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        with contextlib.suppress(OSError):
            if int(folder.name) != os.getpid() and mark in (folder / 'environ').read_bytes():
                found.append((folder / 'cmdline').read_bytes().replace(b'\0', b' ').decode())
    return found


def clean() -> list[str]:
    """What is left over: processes; files of dead processes that a start does not remove."""
    from saddlering_ros.ros.launcher import sweep
    deadline = time.monotonic() + 5.0
    while marked() and time.monotonic() < deadline:
        time.sleep(0.1)
    faults = [f'still running: {line}' for line in marked()]
    time.sleep(2.1)  # younger files may belong to a process that has not locked them yet
    sweep()
    if sweep():
        faults.append('files of dead processes come back in /dev/shm')
    return faults
