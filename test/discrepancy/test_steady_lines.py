"""Claims on steady lines in stretches at rest."""

import numpy as np
import pytest
from scipy.signal import lfilter

from saddlering_ros.discrepancy import RestSegment
from saddlering_ros.discrepancy.verdict.steady_lines import find_line, line_gain

STEP = 1e-3


def stretches(seed: int, frequency: float = 0.0, amplitude: float = 0.0,
              channel: int = 1) -> list[RestSegment]:
    """Four stretches of about a second, two channels of white and slow noise, rms near 1."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(4):
        count = int(random.integers(800, 1500))
        slow = lfilter([1.0], [1.0, -0.99], 0.05 * random.normal(size=(2, count)))
        values = random.normal(size=(2, count)) + slow
        phase = 2.0 * np.pi * (frequency * STEP * np.arange(count) + random.random())
        values[channel] += amplitude * np.sin(phase)
        found.append(RestSegment(values, STEP))
    return found


def test_noise_of_any_smooth_spectrum_shows_no_line() -> None:
    assert all(find_line(stretches(seed), 1e-3)[0] is None for seed in range(20))


@pytest.mark.parametrize('frequency', [16.7, 50.0, 60.3, 180.0])
def test_a_line_is_found_and_measured_where_it_is(frequency: float) -> None:
    line = find_line(stretches(3, frequency, 0.5), 1e-3)[0]
    assert line is not None
    assert line.frequency == pytest.approx(frequency, abs=0.1)
    assert line.amplitude[1] == pytest.approx(0.5, abs=4.0 * line.deviation[1])
    assert list(line.own) == [False, True]


@pytest.mark.parametrize(('times', 'least', 'most'), [(2.0, 10, 10), (0.5, 0, 5)])
def test_a_line_of_twice_the_limit_is_always_found_and_one_of_half_seldom(times, least, most):
    amplitude = times * find_line(stretches(0), 1e-3)[1]
    found = [find_line(stretches(seed, 50.0, amplitude), 1e-3)[0] for seed in range(10)]
    assert least <= sum(line is not None for line in found) <= most


def test_a_slow_swing_is_left_to_others() -> None:
    assert find_line(stretches(4, 3.0, 2.0), 1e-3)[0] is None


@pytest.mark.filterwarnings('error')
def test_a_channel_that_stands_still_is_not_searched_and_hides_no_line() -> None:
    found = [find_line([RestSegment(np.vstack([item.values, np.full(item.values.shape[1], 0.7)]),
                                    item.step) for item in stretches(3, 50.0, size)], 1e-3)
             for size in (0.5, 0.0)]
    assert found[0][0].frequency == pytest.approx(50.0, abs=0.1)
    assert found[0][0].own.tolist() == [False, True, False]
    assert found[1] == find_line(stretches(3), 1e-3)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('still', [np.full(1000, 0.7), np.linspace(0.0, 1.0, 1000)])
def test_values_without_noise_show_no_line_and_no_limit(still: np.ndarray) -> None:
    assert find_line([RestSegment(still[None], 0.01)], 0.01) == (None, np.inf)


def test_stretches_too_short_for_a_spectrum_show_nothing() -> None:
    short = [RestSegment(item.values[:, :50], STEP) for item in stretches(5, 50.0, 5.0)]
    assert find_line(short, 1e-3) == (None, np.inf)


def test_the_gain_is_what_the_line_leaves_less_whatever_its_phase() -> None:
    kept, other = stretches(6, 50.0, 1.0), stretches(7, 50.0, 1.0)
    line = find_line(kept, 1e-3)[0]
    assert line is not None
    expected = 1.0 - np.sqrt(1.13 / (1.13 + 0.5))
    assert line_gain(other, line.frequency, line.amplitude * line.own) == pytest.approx(
        expected, abs=0.05)
