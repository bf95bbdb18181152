"""Claims about the watch that sees nothing: it notices, names what is missing, and forgives."""

import numpy as np
import pytest

from saddlering_ros.monitoring.stream import LATE, NO_CHANNEL, NO_LOAD, NO_RESIDUAL, SEEN, Sight

KNOWN, UNKNOWN = np.zeros((3, 1)), np.full((3, 1), np.nan)
RATE = 500


def stamp(seconds: float) -> np.ndarray:
    return np.array([1_700_000_000_000_000_000 + round(1e9 * seconds)])


def watched(until: float, *, load: float = np.inf, residual: float = np.inf, delay: float = 0.01,
            channels: np.ndarray = KNOWN, speed: float = 1.0) -> Sight:
    """Streams of RATE; load and residual stop at these times, the residual comes `delay` late."""
    sight = Sight()
    for row in range(round(until * RATE)):
        now = row / RATE
        if now < load:
            sight.hear_load(stamp(speed * now), now)
        if delay <= now < residual and now - delay < load:
            sight.hear_residual(stamp(speed * (now - delay)), channels, now)
    return sight


def test_nothing_is_seen_before_a_load_comes() -> None:
    assert Sight().lacks(0.0) == NO_LOAD


def test_a_residual_that_follows_its_load_is_seen() -> None:
    assert watched(2.0).lacks(2.0) == SEEN


@pytest.mark.parametrize(('given', 'lacks'), [
    ({'residual': 1.0}, NO_RESIDUAL), ({'load': 1.0}, NO_LOAD), ({'delay': 0.4}, LATE),
    ({'channels': UNKNOWN}, NO_CHANNEL)])
def test_what_is_missing_is_named_within_a_quarter_of_a_second(given, lacks) -> None:
    assert watched(1.25, **given).lacks(1.25) == lacks


def test_stamps_that_jump_back_and_leave_no_residual_are_noticed() -> None:
    sight = watched(1.0)
    for row in range(125):
        sight.hear_load(stamp(-50.0 + row / RATE), 1.0 + row / RATE)
    assert sight.lacks(1.25) == NO_RESIDUAL


def test_a_slow_load_is_given_three_of_its_periods() -> None:
    sight = Sight()
    for now in np.arange(0.0, 20.0, 0.5):
        sight.hear_load(stamp(now), now)
        sight.hear_residual(stamp(now), KNOWN, now + 0.02)
    assert sight.lacks(20.0) == SEEN
    assert sight.lacks(21.5) == NO_LOAD


def test_a_replay_that_stands_or_waits_for_its_nodes_is_not_silent() -> None:
    sight = watched(1.0)
    sight.hear_replay(0.0, 2.0)
    assert sight.lacks(3.0) == SEEN
    sight.hear_load(stamp(2.8), 3.0)  # the next step of a lockstep: its residual is to come
    assert sight.lacks(3.1) == SEEN
    sight.hear_load(stamp(4.0), 3.2)
    assert sight.lacks(3.2) == LATE
    assert sight.lacks(9.0) == NO_LOAD, 'the replay has ended without a word'


def test_a_fast_replay_is_judged_by_its_own_time() -> None:
    sight = watched(1.0, delay=0.1, speed=10.0)
    assert sight.lacks(1.0) == LATE
    sight.hear_replay(10.0, 1.0)
    assert sight.lacks(1.0) == SEEN
