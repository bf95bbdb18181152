"""Threads of the linear algebra library (BLAS) while this package computes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let BLAS use one thread until the block ends; also a decorator.

    The matrices of a fit are small: more threads wait for each other, and they take processors
    from the simulator, which uses all of them by itself.
    """
    try:
        from threadpoolctl import threadpool_limits
    except ModuleNotFoundError:  # only the speed depends on it
        yield
        return
    with threadpool_limits(limits=1, user_api='blas'):
        yield
