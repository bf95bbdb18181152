"""A ring whose catalogue has a few effects, for tests of what these do to each other.

A diagnosis costs about as much as the number of effects that it tries.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from unittest import mock

from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Effect


@contextmanager
def few_effects(*names: str) -> Iterator[None]:
    """Let every ring that is made meanwhile have these effects alone."""
    every = RingSystem.__dict__['effects'].func

    def chosen(system: RingSystem) -> tuple[Effect, ...]:
        return tuple(one for one in every(system) if one.id in names)

    effects = cached_property(chosen)
    effects.__set_name__(RingSystem, 'effects')
    with mock.patch.object(RingSystem, 'effects', effects):
        yield
