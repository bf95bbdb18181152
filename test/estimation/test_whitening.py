"""Claims about whitening: correlated errors in, independent ones of unit variance out."""

import numpy as np
import pytest
from scipy.linalg import cholesky, toeplitz

from saddlering_ros.estimation.noise import ChannelNoise
from saddlering_ros.estimation.whitening import SharedErrors, Whitening

NOISE = ChannelNoise(0.02, 4e-14, np.array([0.1, 4.0]), np.array([2e-14, 1e-14]))
COMMON = 5e-14


def covariance_after(whitening, covariance):
    """Covariance of whitened errors whose own covariance is given."""
    rows = whitening.apply(cholesky(covariance, lower=True).T)
    return rows.T @ rows


def test_a_process_and_the_error_of_the_zero_come_out_independent():
    covariance = toeplitz(NOISE.autocovariance(300)) + COMMON
    white = covariance_after(Whitening.of_process(NOISE, 300, COMMON), covariance)
    assert np.diag(white) == pytest.approx(1.0, abs=0.02)
    assert np.abs(white - np.diag(np.diag(white))).max() < 0.02


def test_readings_of_any_covariance_come_out_independent():
    covariance = NOISE.covariance_of_means(5.0 * np.arange(20), [100] * 20)
    white = covariance_after(Whitening.of_covariance(covariance, COMMON), covariance + COMMON)
    assert white == pytest.approx(np.eye(20), abs=1e-9)


def test_white_noise_is_only_scaled():
    noise = ChannelNoise(0.02, 4e-14, np.zeros(0), np.zeros(0))
    values = np.random.default_rng(0).normal(size=(2, 50))
    assert Whitening.of_process(noise, 50, 0.0).apply(values) == pytest.approx(values / 2e-7)


def test_residuals_that_share_errors_come_out_independent():
    answers = np.random.default_rng(1).normal(size=(6, 30)) * np.geomspace(0.1, 30.0, 6)[:, None]
    rows = cholesky(np.eye(30) + answers.T @ answers, lower=True).T
    white = SharedErrors.of(answers).apply(rows)
    assert white.T @ white == pytest.approx(np.eye(30), abs=1e-9)


def test_shared_errors_are_estimated_by_what_the_residuals_say_of_them():
    random = np.random.default_rng(2)
    answers = random.normal(size=(4, 200))
    residuals = random.normal(size=200)
    expected = np.linalg.solve(np.eye(4) + answers @ answers.T, answers @ residuals)
    assert SharedErrors.of(answers).estimate(residuals) == pytest.approx(expected)
