"""Claims on the tails of distributions: those of scipy.stats, which takes a second to import."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from sources import imported

from saddlering_ros.estimation.process import fisher_chance, fisher_limit, fisher_share_below
from saddlering_ros.quantities import WIDTH_95

ROOT = Path(__file__).resolve().parents[2] / 'saddlering_ros'
RATIOS = np.array([-1.0, 0.0, 0.5, 2.0, 50.0, np.inf])


@pytest.mark.parametrize(('between', 'within'), [(1, 30), (7, 2.5), (200, 4000)])
def test_the_tails_of_ratios_are_those_of_scipy(between, within):
    same = stats.f(between, within)
    assert np.array_equal(fisher_chance(RATIOS, between, within), same.sf(RATIOS))
    assert np.array_equal(fisher_share_below(RATIOS, between, within), same.cdf(RATIOS))
    for chance in (0.05, 1e-6):
        assert fisher_limit(chance, between, within) == same.isf(chance)


def test_an_interval_of_95_percent_is_as_wide_as_that_of_scipy():
    assert stats.norm.ppf(0.975) == WIDTH_95


@pytest.mark.parametrize('layer', ['estimation', 'identification', 'discrepancy', 'diagnosis',
                                   'report', 'monitoring', 'ring'])
def test_no_command_waits_for_the_import_of_all_distributions(layer):
    dear = {'scipy.stats', 'scipy.signal'}
    found = {f'{path.name}: {name}' for path in (ROOT / layer).rglob('*.py')
             for module, name in imported(path) if dear & {module, f'{module}.{name}'}}
    assert not found
