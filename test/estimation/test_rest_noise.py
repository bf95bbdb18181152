"""Claims on noise learnt from stretches at rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from saddlering_ros.discrepancy import RestSegment
from saddlering_ros.estimation.noise import measure_noise
from saddlering_ros.estimation.process import EstimationError

STEP = 0.01


def segments(
    random: np.random.Generator, count: int, white: float, slow: float, tau: float
) -> list[RestSegment]:
    keep = np.exp(-STEP / tau)
    drive = random.normal(size=count * 400) * slow * np.sqrt(1.0 - keep**2)
    noise = lfilter([1.0], [1.0, -keep], drive) + random.normal(size=count * 400) * white
    return [RestSegment(part[None, :], STEP) for part in np.array_split(noise, count)]


def test_white_noise_averages_as_white_noise() -> None:
    random = np.random.default_rng(1)
    noise = measure_noise(segments(random, 30, 2.0, 0.0, 1.0), 1)[0]
    assert noise.deviation(1.0) == pytest.approx(2.0 * np.sqrt(STEP), rel=0.1)


def test_slow_noise_is_not_taken_for_white() -> None:
    random = np.random.default_rng(2)
    noise = measure_noise(segments(random, 60, 1.0, 1.0, 1.0), 1)[0]
    assert noise.deviation(2.0) > 0.5


def test_the_covariance_is_one_of_noise() -> None:
    random = np.random.default_rng(3)
    noise = measure_noise(segments(random, 30, 1.0, 1.0, 0.5), 1)[0]
    time = np.arange(50) * 0.5
    covariance = noise.covariance(time, np.full(50, 0.5))
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_no_rest_is_said_in_one_line() -> None:
    with pytest.raises(EstimationError, match='no stretch at rest'):
        measure_noise([], 1)
