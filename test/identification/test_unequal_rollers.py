"""Claims about the intervals on rings of unequal rollers, as every real ring is."""

from dataclasses import replace

from identification_records import observe
import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.examiner import draw_truth
from saddlering_ros.bags.reader import read_run
from saddlering_ros.identification.methods import identify
from saddlering_ros.identification.objective import WeightedObjective
from saddlering_ros.identification.settings import IdentificationSettings, SwarmSettings
from saddlering_ros.identification.uncertainty import MAX_SOUND, roller_effects
from saddlering_ros.quantities import WIDTH_95
from saddlering_ros.rig import default_rig, PARAMETER_NAMES

SEED = 4
RIG = default_rig()
SHORT = IdentificationSettings(swarm=SwarmSettings(particles=10, iterations=10))
FITTED = ('static_50', 'dynamic_50', 'static_70')


@pytest.fixture(name='runs', scope='module')
def runs_fixture(campaign):
    return [read_run(bag) for bag in campaign(runs=FITTED, seed=SEED)]


@pytest.fixture(name='found', scope='module')
def found_fixture(runs):
    return identify(runs, RIG, SHORT)


def off(found):
    return found.parameters.contact.to_array() - draw_truth(SEED, 'clean').contact.to_array()


def test_intervals_hold_the_truth_where_those_of_noise_alone_do_not(found):
    truth = draw_truth(SEED, 'clean').contact
    for name in PARAMETER_NAMES:
        low, high = found.intervals[name]
        assert low < getattr(truth, name) < high
    of_noise = np.sqrt(np.diag(found.parameters.source.covariance))
    assert np.abs(off(found) / of_noise).max() > WIDTH_95


def test_the_covariance_of_the_parameter_file_counts_noise_alone(found):
    """Predictions and changes of the same ring do not vary with the scatter of its rollers."""
    added = found.covariance - found.parameters.source.covariance
    correlated = added / np.sqrt(np.outer(np.diag(added), np.diag(added)))
    assert np.linalg.eigvalsh(correlated).min() > -1e-6
    assert np.diag(found.covariance) == pytest.approx(found.std**2)


def test_unequal_rollers_explain_a_misfit_that_noise_does_not(found):
    assert found.sound_factor < MAX_SOUND
    assert found.sound_factor < found.noise_factor
    assert 'times what noise' not in found.status


def test_a_lag_that_hides_in_the_damping_is_more_than_unequal_rollers_explain(runs, found):
    share = 1.0 - np.exp(-1e-3 / 0.015)  # A low-pass of 15 ms at 1000 Hz.
    late = [run if run.test == 'static' else replace(run, gaps=lfilter(
        [share], [1.0, share - 1.0], run.gaps - run.gaps[:, :1], axis=1) + run.gaps[:, :1])
        for run in runs]
    answer = identify(late, RIG, SHORT)
    assert answer.noise_factor < 2.0  # No more than the rollers of some sound rings.
    assert answer.parameters.contact.D2 > 1.1 * found.parameters.contact.D2
    assert answer.sound_factor > MAX_SOUND
    assert 'times what noise and small errors of a sound ring leave' in answer.status


def whitened_effects(objective, contact):
    """Whitened residuals (R, M) by the scatter of each roller."""
    return np.concatenate(objective.whiten(roller_effects(objective, contact)), axis=1).T


def test_the_effect_of_rollers_is_shared_by_all_runs(runs, found):
    observations = observe(runs, RIG, fit_rate=50.0)
    contact = found.parameters.contact.to_array()
    objective = WeightedObjective(RIG, observations, (0, 1, 2))
    together = whitened_effects(objective, contact)
    alone = [whitened_effects(WeightedObjective(RIG, [one], (0, 1, 2)), contact)
             for one in observations]
    assert np.allclose(together, np.concatenate(alone))
    # Mirror twins share a column: of 97 rollers 49 are on one side, of 110 rollers 56.
    assert together.shape[1] == 2 * (49 + 49 + 56) + 1
