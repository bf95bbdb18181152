"""What the tests of a run share on the disk, made once by whichever worker asks first."""

from collections.abc import Callable
import fcntl
import os
from pathlib import Path
import shutil

import pytest


class MadeOnce:
    """Folders by name, below one that all workers of a run of the tests have in common."""

    def __init__(self, factory: pytest.TempPathFactory) -> None:
        own = factory.getbasetemp()
        self._root = (own.parent if 'PYTEST_XDIST_WORKER' in os.environ else own) / 'made_once'
        self._root.mkdir(exist_ok=True)

    def folder(self, name: str, make: Callable[[Path], object]) -> Path:
        """The folder `name` (a relative path); `make` fills it the first time.

        Nobody sees it half full.
        """
        whole, partial = self._root / name, self._root / f'{name}.partial'
        whole.parent.mkdir(parents=True, exist_ok=True)
        with (self._root / f'{name}.lock').open('w') as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not whole.exists():
                shutil.rmtree(partial, ignore_errors=True)
                partial.mkdir()
                make(partial)
                partial.rename(whole)
        return whole
