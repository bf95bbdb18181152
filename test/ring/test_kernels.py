"""Claims about the compiled kernels: powers, layout, sources."""

from pathlib import Path

import numba as nb
import numpy as np
import pytest
from sources import imported

from saddlering_ros.ring import kernels
from saddlering_ros.ring.kernels import contact, layout


@nb.njit
def powers(base: np.ndarray, exponent: float) -> np.ndarray:
    result = np.empty_like(base)
    for j in range(base.size):
        result[j] = contact.power(base[j], exponent)
    return result


@pytest.mark.parametrize('exponent', [0.0, 1 / 9, 0.5, 1.0, 1.5, 7.0, -0.7])
def test_the_vectorised_power_is_the_libraries_power_to_1e_12(exponent: float) -> None:
    base = np.concatenate([np.geomspace(1e-30, 1e3, 4001), 2.0 ** np.arange(-60, 5),
                           np.nextafter(np.sqrt(0.5), [0.0, 1.0])])
    assert powers(base, exponent) == pytest.approx(base**exponent, rel=1e-12)


def test_places_of_the_layout_do_not_overlap_their_arrays_ends() -> None:
    assert layout.FRACTION + 1 == layout.ZERO_LOAD
    assert layout.BRACKET_Z + 2 == layout.MEASURED_LOAD + layout.LOAD_STATES == layout.FRICTION_Z
    assert layout.FRICTION_Z + 6 == layout.Q
    assert layout.LAST_FORCE + 3 == layout.LAST_STIFFNESS
    assert layout.LAST_DAMPING + 5 == layout.LAGGED
    assert layout.LAGGED_TWICE + 4 == layout.STATE_SIZE
    assert layout.DAMPING + 5 == layout.FORCE
    assert layout.MOTION + 3 == layout.TOUCHING
    assert layout.TOUCHING + 3 == layout.LOAD_BACKUP
    assert layout.LOAD_BACKUP + layout.LOAD_STATES == layout.BACKUP


def test_kernels_import_from_their_own_folder_only() -> None:
    """The compiled code is kept by the files of this folder, so they must be all its sources."""
    own = 'saddlering_ros.ring.kernels'
    for file in sorted(Path(kernels.__file__).parent.glob('*.py')):
        for module, name in imported(file):
            compiler = (module, name, file.name) == ('saddlering_ros', 'compiled', 'layout.py')
            assert compiler or 'saddlering' not in module or module.startswith(own), file.name
