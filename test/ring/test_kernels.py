"""Claims about the compiled kernels: powers, layout, caching."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
import subprocess
import sys

import numba as nb
import numpy as np
import pytest

from saddlering_ros.ring import kernels, layout


@nb.njit
def powers(base: np.ndarray, exponent: float) -> np.ndarray:
    result = np.empty_like(base)
    for j in range(base.size):
        result[j] = kernels.power(base[j], exponent)
    return result


@pytest.mark.parametrize('exponent', [0.0, 1 / 9, 0.5, 1.0, 1.5, 7.0, -0.7])
def test_the_vectorised_power_is_the_libraries_power_to_1e_12(exponent: float) -> None:
    base = np.concatenate([np.geomspace(1e-30, 1e3, 4001), 2.0 ** np.arange(-60, 5),
                           np.nextafter(np.sqrt(0.5), [0.0, 1.0])])
    assert powers(base, exponent) == pytest.approx(base**exponent, rel=1e-12)


def test_kernels_kept_by_numba_cannot_outlive_a_change_of_layout() -> None:
    places = sorted((name, value) for name, value in vars(layout).items()
                    if name.isupper() and isinstance(value, int))
    digest = hashlib.sha256(repr(places).encode()).hexdigest()[:12]
    assert digest == kernels.LAYOUT, f'layout.py changed: set kernels.LAYOUT to {digest!r}'


def test_places_of_the_layout_do_not_overlap_their_arrays_ends() -> None:
    assert layout.CLIP_HIGH + 4 == layout.COSINE
    assert layout.SINE + 1 == layout.UPPER_STIFFNESS
    assert layout.MIDDLE_STIFFNESS + 1 == layout.LAG_SECOND
    assert layout.LAG_SECOND + 4 == layout.RESONANCE_SHARE
    assert layout.OPENING_SPREAD + 1 == layout.MODEL_SIZE
    assert layout.LAGGED_TWICE + 4 == layout.LAST_FORCE
    assert layout.LAST_DAMPING + 5 == layout.STATE_SIZE
    assert layout.MOTION + 3 == layout.TOUCHING
    assert layout.TOUCHING + 3 == layout.BACKUP


def _can_cache(**environment: str) -> str:
    code = ('from saddlering_ros.ring import caching\n'
            'from numba.core import caching as places\n'
            'places.InTreeCacheLocator.from_function = classmethod(lambda *_: None)\n'
            'print(caching.can_cache())')
    root = str(Path(__file__).resolve().parents[2])
    run = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True,
                         env={**os.environ, 'PYTHONPATH': root, **environment})
    return run.stdout.strip()


def test_where_the_package_is_read_only_kernels_go_to_the_users_cache(tmp_path: Path) -> None:
    assert _can_cache(XDG_CACHE_HOME=str(tmp_path), HOME=str(tmp_path)) == 'True'


def test_where_nothing_can_be_written_kernels_are_compiled_without_a_cache() -> None:
    assert _can_cache(XDG_CACHE_HOME='/proc/none', HOME='/proc/none') == 'False'
