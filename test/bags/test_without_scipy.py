"""Claims about what is computed without SciPy, so that `info` starts fast: equal to SciPy's."""

import numpy as np
import pytest
from scipy.ndimage import median_filter

from saddlering_ros.record.quality import _away_from_neighbours


@pytest.mark.parametrize('size', [10, 11, 5003])
def test_the_distance_from_the_running_median_is_scipys_to_the_last_bit(size: int) -> None:
    values = np.random.default_rng(size).standard_normal(size).round(2)
    expected = np.abs(values - median_filter(values, 5, mode='nearest'))
    assert np.array_equal(_away_from_neighbours(values), expected)
