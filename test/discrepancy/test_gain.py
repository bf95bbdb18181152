"""A claim on the misfit reduction: it keeps its sign, however much worse an extension predicts."""

from __future__ import annotations

import numpy as np
import pytest

from saddlering_ros.discrepancy.problem.fits import ratio


@pytest.mark.parametrize(
    ('before', 'after', 'gain'),
    [(4.0, 1.0, 0.5), (1.0, 1.0, 0.0), (1.0, 4.0, -1.0), (1.0, 400.0, -19.0), (0.0, 0.0, 0.0),
     (0.0, 1.0, -np.inf)],
)
def test_a_misfit_that_grows_is_a_negative_reduction(
    before: float, after: float, gain: float
) -> None:
    assert ratio(before, after) == pytest.approx(gain)
