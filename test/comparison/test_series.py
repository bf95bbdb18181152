"""Claims about the evidence of a series of sessions, on drawn readings."""

import numpy as np

from saddlering_ros.comparison.series import CHANGED, evidence_of, SessionSums

READINGS, ERRORS, KINDS = 12, 3, 4
LEVEL = 0.05


def drawn(random, sessions, kind=0, size=0.0, first=99):
    """Sums of a series whose ring changes by `size` spreads with the session `first`."""
    errors = random.standard_normal((sessions, READINGS, ERRORS))
    shapes = random.standard_normal((sessions, READINGS, KINDS))
    own = random.standard_normal(ERRORS)
    sums = []
    for number in range(sessions):
        residual = errors[number] @ own + random.standard_normal(READINGS)
        residual += (number >= first) * size * shapes[number, :, kind]
        sums.append(SessionSums.of(errors[number], shapes[number], residual))
    return sums


def test_an_unchanged_ring_reaches_a_level_no_more_often_than_it_says_at_any_session():
    random = np.random.default_rng(27)
    highest = []
    for _ in range(400):
        base, *later = drawn(random, 13)
        highest.append(evidence_of(base, later).e_values.max())
    # 20 of 400 are allowed in the mean; 30 are 2.3 deviations more.
    assert np.sum(np.array(highest) >= 1.0 / LEVEL) <= 30
    assert np.sum(np.array(highest) >= CHANGED) <= 9


def test_a_change_is_found_with_its_kind_its_first_session_and_its_size():
    random = np.random.default_rng(28)
    right, off = 0, []
    for _ in range(60):
        base, *later = drawn(random, 9, kind=2, size=1.5, first=5)
        found = evidence_of(base, later)
        assert found.e_values[-1] > CHANGED
        right += found.kind == 2 and np.argmax(found.moment) == 4
        off.append((found.sizes[4:].mean() - 1.5) / (found.deviations[4:].mean() / 2.0))
    assert right >= 54
    assert abs(np.mean(off)) < 0.5


def test_looking_once_more_does_not_change_what_was_seen_before():
    base, *later = drawn(np.random.default_rng(29), 8, kind=1, size=1.0, first=3)
    whole = evidence_of(base, later).e_values
    assert np.allclose(evidence_of(base, later[:4]).e_values, whole[:4])
