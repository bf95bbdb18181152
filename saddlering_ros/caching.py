"""Where compiled kernels are kept: beside the source, else in the user's cache, else nowhere.

numba takes the first of NUMBA_CACHE_DIR, the package's __pycache__ and the user's cache folder
that it can write to, and refuses a cached function where there is none (a read-only installation
without a home): there the kernels are compiled anew in each process.
"""

import numba as nb


def _nothing() -> None:
    """Asked after, never called."""


def can_cache() -> bool:
    """Whether numba finds a place to keep what is compiled from this folder."""
    try:
        nb.njit(cache=True)(_nothing)
    except RuntimeError:
        return False
    return True


CACHE = can_cache()
"""What the kernels give numba as `cache`."""
