"""Claims about Allan variances over many rows at once."""

from __future__ import annotations

import numpy as np
import pytest

from saddlering_ros.estimation.statistics import allan_variances_of, RowTotals, running_total


@pytest.mark.parametrize('count', [1, 3, 8])
def test_rows_together_have_the_allan_variances_of_each_row_by_itself(count: int) -> None:
    random = np.random.default_rng(0)
    rows = [5.0 + random.standard_normal(size) for size in (40, 2, 17, 16, 300)]
    numbers = [row.size // count - 1 for row in rows]
    alone = [float(allan_variances_of(running_total(row)[None], count)[0])
             for row, number in zip(rows, numbers, strict=True) if number > 0]
    kept = [number for number in numbers if number > 0]
    weighted, differences = RowTotals(rows).weighted_variance(count)
    assert differences == sum(kept)
    assert weighted == pytest.approx(np.dot(kept, alone))


def test_rows_that_are_too_short_have_no_differences() -> None:
    assert RowTotals([np.ones(3), np.ones(2)]).weighted_variance(2) == (0.0, 0)
