"""Claims about errors that residuals share: taken out, residuals are independent."""

import numpy as np
import pytest
from scipy.linalg import cholesky

from saddlering_ros.estimation.whitening import SharedErrors

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
