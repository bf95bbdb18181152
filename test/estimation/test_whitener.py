"""Claims on whitening in O(N): the dense covariance is its oracle."""

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular

from saddlering_ros.estimation.process import ChannelNoise, EstimationError
from saddlering_ros.estimation.whitening import build_whitener, SharedErrors

SLOW = np.array([0.4, 0.0, 0.2, 0.7, 0.0, 1.5, 0.3, 2.0])
EVEN = np.arange(120) * 0.05
UNEVEN = np.cumsum(np.random.default_rng(1).uniform(0.02, 0.4, 120))


def dense(noise: ChannelNoise, time: np.ndarray, width: np.ndarray, hold=None) -> np.ndarray:
    return cholesky(noise.covariance(time, width, hold), lower=True)


@pytest.mark.parametrize('time', [EVEN, UNEVEN], ids=['even', 'uneven'])
@pytest.mark.parametrize('share', [1.0, 0.3], ids=['blocks that touch', 'blocks apart'])
def test_it_is_the_dense_cholesky_factor(time: np.ndarray, share: float) -> None:
    spacing = np.diff(time)
    width = share * np.minimum(np.append(spacing, np.inf), np.append(np.inf, spacing))
    noise = ChannelNoise(0.01, SLOW, 0.0, 10)
    lower = dense(noise, time, width)
    columns = np.random.default_rng(2).normal(size=(time.size, 3))
    whitener = build_whitener(noise, time, width)
    expected = solve_triangular(lower, columns, lower=True)
    assert np.allclose(whitener.whiten(columns), expected, rtol=1e-9, atol=1e-9)
    assert np.allclose(whitener.colour(columns), lower @ columns, rtol=1e-9, atol=1e-9)


def test_a_coarse_converters_level_stays_while_nothing_moves() -> None:
    hold = np.repeat(np.arange(30.0), 4)
    noise = ChannelNoise(1e-3, SLOW, 0.5, 10)
    lower = dense(noise, EVEN, np.full(120, 0.05), hold)
    whitener = build_whitener(noise, EVEN, np.full(120, 0.05), hold)
    assert np.allclose(whitener.colour(np.eye(120)), lower, atol=1e-10)


def test_missing_samples_have_no_weight_and_leave_the_rest_as_if_they_were_not_there() -> None:
    random = np.random.default_rng(3)
    present = random.random(120) > 0.3
    noise = ChannelNoise(0.01, SLOW, 0.0, 10)
    width = np.full(120, 0.02)
    values = random.normal(size=120)
    values[~present] = np.nan
    white = build_whitener(noise, UNEVEN, width, present=present).whiten(values)
    lower = dense(noise, UNEVEN[present], width[present])
    assert np.allclose(white[present], solve_triangular(lower, values[present], lower=True))
    assert not white[~present].any()


def test_whitened_noise_of_a_hundred_thousand_samples_is_white() -> None:
    time = np.arange(100_000) * 1e-3
    noise = ChannelNoise(1e-3, SLOW, 0.0, 10)
    whitener = build_whitener(noise, time, np.full(time.size, 1e-3))
    drawn = whitener.colour(np.random.default_rng(4).normal(size=time.size))
    back = whitener.whiten(drawn)
    assert back @ back / time.size == pytest.approx(1.0, abs=0.02)
    assert abs(back[1:] @ back[:-1]) / time.size < 0.02


def test_noise_since_an_instant_agrees_with_the_dense_covariance() -> None:
    noise = ChannelNoise(0.01, SLOW, 0.3, 10)
    width = np.full(120, 0.02)
    matrix = noise.covariance(np.append(-1.0, UNEVEN), np.append(0.5, width))
    expected = np.sqrt(np.diag(matrix)[1:] + matrix[0, 0] - 2.0 * matrix[0, 1:])
    assert np.allclose(noise.since(UNEVEN, width, -1.0, 0.5), expected)


def test_noise_without_any_white_part_is_refused_in_one_line() -> None:
    noise = ChannelNoise(0.0, np.zeros(8), 0.0, 10)
    with pytest.raises(EstimationError, match='some white noise'):
        build_whitener(noise, EVEN, np.full(120, 0.05))


MAKERS = [SharedErrors.of, SharedErrors.of_many]


@pytest.mark.parametrize('make', MAKERS)
def test_residuals_that_share_errors_come_out_independent(make):
    answers = np.random.default_rng(1).normal(size=(30, 6)) * np.geomspace(0.1, 30.0, 6)
    columns = cholesky(np.eye(30) + answers @ answers.T, lower=True)
    white = make(answers).apply(columns)
    assert white @ white.T == pytest.approx(np.eye(30), abs=1e-9)


@pytest.mark.parametrize('make', MAKERS)
def test_shared_errors_are_estimated_by_what_the_residuals_say_of_them(make):
    random = np.random.default_rng(2)
    answers = random.normal(size=(200, 4))
    residual = random.normal(size=200)
    expected = np.linalg.solve(np.eye(4) + answers.T @ answers, answers.T @ residual)
    assert make(answers).likely(residual) == pytest.approx(expected)


def test_an_error_far_larger_than_the_noise_takes_one_dimension():
    assert SharedErrors.of(1e6 * np.ones((50, 1))).dimensions == pytest.approx(1.0)


def test_without_errors_residuals_stay_as_they_are():
    residual = np.arange(5.0)
    assert SharedErrors.none(5).apply(residual) == pytest.approx(residual)
