"""Claims about what is computed without SciPy, so that `info` starts fast: equal to SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import median_filter
from scipy.optimize import nnls

from saddlering_ros.bags.plateaus import _two_amounts
from saddlering_ros.bags.record_quality import _running_median, MEDIAN_BLOCK


@pytest.mark.parametrize(('size', 'width'), [(10, 5), (11, 9), (MEDIAN_BLOCK + 3, 5)])
def test_the_running_median_is_scipys_to_the_last_bit(size: int, width: int) -> None:
    values = np.random.default_rng(size).standard_normal(size).round(2)
    expected = median_filter(values, width, mode='nearest')
    assert np.array_equal(_running_median(values, width), expected)


@pytest.mark.parametrize('seed', range(20))
def test_two_amounts_are_the_nonnegative_least_squares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes, target = rng.standard_normal((2, 8)), rng.standard_normal(8)
    expected, misfit = nnls(shapes.T, target)
    amounts, found = _two_amounts(shapes, target)
    assert amounts == pytest.approx(expected, abs=1e-12)
    assert found == pytest.approx(misfit, rel=1e-12)
