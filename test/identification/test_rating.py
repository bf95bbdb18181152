"""Claims about the ISO/TS 18571 rating."""

import numpy as np
import pytest

from saddlering_ros.identification.figures import rate

TIME = np.linspace(0.0, 1.0, 300)
HUMP = np.sin(np.pi * TIME) ** 2


def test_the_same_signal_is_rated_one():
    assert rate(HUMP, HUMP).overall == pytest.approx(1.0)


def test_a_late_signal_loses_phase_and_keeps_magnitude():
    late = np.interp(TIME - 0.05, TIME, HUMP)
    rating = rate(HUMP, late)
    assert rating.phase == pytest.approx(1.0 - 0.05 / 0.2, abs=0.02)
    assert rating.magnitude > 0.95


def test_a_gain_loses_magnitude_and_keeps_phase():
    rating = rate(HUMP, 1.2 * HUMP)
    assert rating.phase == pytest.approx(1.0)
    assert rate(HUMP, 1.5 * HUMP).magnitude < rating.magnitude < 0.9


def test_inside_the_inner_corridor_nothing_is_lost():
    assert rate(HUMP, HUMP + 0.04).corridor == 1.0


def test_outside_the_outer_corridor_everything_is():
    assert rate(HUMP, HUMP + 0.6).corridor == 0.0


def test_scores_stay_between_zero_and_one():
    random = np.random.default_rng(0)
    rating = rate(HUMP, random.normal(size=300))
    scores = (rating.corridor, rating.phase, rating.magnitude, rating.slope, rating.overall)
    assert all(0.0 <= score <= 1.0 for score in scores)


def test_long_signals_are_rated_as_short_ones():
    long = np.linspace(0.0, 1.0, 5000)
    rating = rate(np.sin(np.pi * long) ** 2, 1.1 * np.sin(np.pi * long) ** 2)
    assert rating.overall == pytest.approx(rate(HUMP, 1.1 * HUMP).overall, abs=0.02)
