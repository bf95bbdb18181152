"""Files in /dev/shm of killed nodes: found by their unlocked lock files, and removed."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path
import time

FOLDER = Path('/dev/shm')
PREFIX = 'fastrtps_'
PORT_PREFIX = 'fastrtps_port'
LOCK_SUFFIX = '_el'
YOUNG = 2.0
"""Files younger than this [s] may belong to a process that has not locked them yet."""


def sweep(folder: Path = FOLDER) -> int:
    """Remove the segments of Fast DDS that no living process holds; how many.

    Fast DDS keeps a lock on `<name>_el` for as long as the owner of `<name>` lives; the lock ends
    with the process, however it ends. Each segment left behind costs half a megabyte of memory.
    Ports are left alone: Fast DDS itself makes a dead one anew when it is next used.
    """
    removed = 0
    with contextlib.suppress(OSError):
        for lock in sorted(folder.glob(f'{PREFIX}*{LOCK_SUFFIX}')):
            if not lock.name.startswith(PORT_PREFIX):
                removed += _remove_if_dead(lock)
    return removed


def _remove_if_dead(lock: Path) -> int:
    try:
        if time.time() - lock.stat().st_mtime < YOUNG:
            return 0
        handle = os.open(lock, os.O_RDONLY)
    except OSError:
        return 0
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        name = lock.name.removesuffix(LOCK_SUFFIX)
        for path in (lock.with_name(name), lock):
            with contextlib.suppress(OSError):
                path.unlink()
        return 1
    except OSError:
        return 0
    finally:
        os.close(handle)
