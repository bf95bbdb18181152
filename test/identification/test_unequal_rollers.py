"""Claims about the intervals on rings of unequal rollers, as every real ring is."""

from dataclasses import replace

from identification_records import dynamic_run, observe, static_run
import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.examiner import draw_truth
from saddlering_ros.api.results import IdentificationResult
from saddlering_ros.bags.reader import read_run
from saddlering_ros.effects.extension import NO_EXTENSION, RowGeometry
from saddlering_ros.effects.raceway_waves import RacewayWaves
from saddlering_ros.identification.methods import identify
from saddlering_ros.identification.objective import WeightedObjective
from saddlering_ros.identification.result import identification_text, parameter_words
from saddlering_ros.identification.ring_errors import roller_effects, waves_of
from saddlering_ros.identification.settings import IdentificationSettings, SwarmSettings
from saddlering_ros.identification.uncertainty import MAX_SOUND
from saddlering_ros.identification.validation import validate
from saddlering_ros.quantities import WIDTH_95
from saddlering_ros.report.chapters import identified
from saddlering_ros.report.reports import write_validation_report
from saddlering_ros.rig import default_rig, Instruments, PARAMETER_NAMES, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import probe_batch

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


def test_even_raceways_show_no_waves(found):
    assert found.waves.rms == 0.0
    assert found.reasons == found.reasons_even
    assert not any('raceway_waves' in shares for shares in found.budget.values())


def test_noise_alone_shows_no_waves():
    """With a misfit of 0.98 times the noise, waves explained 100 % of what was beyond it."""
    for seed in range(20):
        random = np.random.default_rng(seed)
        residual, waves = random.standard_normal(2000), random.standard_normal((24, 2000))
        assert waves_of(residual, np.zeros((1, 2000)), waves / 10.0, 2000).rms == 0.0


def runs_with(effects, **options):
    tests = (static_run, 50.0), (dynamic_run, 50.0), (static_run, 70.0)
    return [make(elevation=degrees, effects=effects, seed=number, **options)
            for number, (make, degrees) in enumerate(tests)]


@pytest.mark.parametrize('phases', [(0.3, 0.3, 0.4), (0.5, 0.0, 0.2)])
def test_rollers_at_any_place_are_no_waves(phases):
    """Waves of 0.9 and 1.2 um were said to explain the misfit."""
    rows = [RowGeometry(phase=phase) for phase in phases]
    moved = replace(NO_EXTENSION, upper_row=rows[0], lower_row=rows[1], radial_row=rows[2])
    runs = []
    for run in runs_with({}, noise=1e-7):
        there, usual = probe_batch(RIG, [(TRUE_TO_SCALE.to_array(), one) for one in (
            moved, NO_EXTENSION)], run.elevation, run.time, run.load)
        assert 5e-9 < np.abs(there - usual).max() < 5e-7
        runs.append(replace(run, gaps=run.gaps + there - usual))
    found = identify(runs, RIG, SHORT)
    assert found.waves.rms == 0.0
    assert found.std[0] < 0.1 * TRUE_TO_SCALE.K1


def wavy_runs(seed):
    """Runs of a ring whose raceways wave by 4 um rms."""
    drawn = 1.5e-6 * np.random.default_rng(seed).standard_normal(len(RacewayWaves.parameters))
    return runs_with({RacewayWaves.id: {
        one.name: size for one, size in zip(RacewayWaves.parameters, drawn, strict=True)}})


def errors_of(law):
    """Errors (6,) of ln K, n, ln D, and those over the stated deviations."""
    off = law.contact.to_array() - TRUE_TO_SCALE.to_array()
    return (off / np.where(np.arange(6) % 3 == 1, 1.0, TRUE_TO_SCALE.to_array()),
            off / np.sqrt(np.diag(law.covariance)))


@pytest.fixture(name='wavy', scope='module')
def wavy_fixture():
    return [identify(wavy_runs(seed), RIG, SHORT) for seed in range(1, 4)]


def test_the_law_beside_errors_is_that_of_the_contacts(wavy):
    """Errors of ln K were 0.36 in the rms on even raceways."""
    off, over_stated = np.array([errors_of(found.beside_errors) for found in wavy]).swapaxes(0, 1)
    assert all(all(found.beside_errors.determined.values()) for found in wavy)
    assert np.sqrt(np.mean(off[:, [0, 3]] ** 2)) < 0.05
    assert np.sqrt(np.mean(over_stated**2)) < 1.5
    assert 'K1, n1, D1, K2, n2, D2 are determined beside errors of the ring' in wavy[0].status


def test_a_certificate_takes_the_place_of_a_usual_error(wavy):
    """The error of a certificate was counted twice, beside the usual one: 10 % more of K1."""
    rig = replace(RIG, instruments=Instruments(load_gain=0.005))  # as large as the usual one
    certified = identify(wavy_runs(1), rig, SHORT).beside_errors
    assert certified.std == pytest.approx(wavy[0].beside_errors.std, rel=0.06)  # as the draws


def test_text_json_table_and_report_state_the_law_beside_errors(wavy):
    found, beside = wavy[0], wavy[0].beside_errors
    document, shown = found.to_json(), parameter_words('K1', beside.entries['K1'])
    assert f'    {shown}' in identification_text(found).splitlines()
    in_json = document['beside_errors']['parameters']
    assert in_json['K1']['interval'] == list(beside.intervals['K1'])
    assert document['beside_errors']['noise_factor'] == beside.noise_factor < MAX_SOUND
    assert document['parameters']['K1']['value'] == found.parameters.contact.K1
    table = IdentificationResult((), RIG, (), found).table('beside_errors')
    assert table['value'] == [entry['value'] for entry in in_json.values()]
    assert 'Beside small errors of the ring' in identified(document)
    for said in identification_text(found), identified(document):
        assert 'parameters above' not in said  # two sets of parameters are above


def test_a_page_does_not_call_sound_what_identify_does_not(tmp_path):
    """Errors of a sound ring move each channel by more than a misfit that none explains."""
    [static] = runs_with({'radial_friction': {'force': 400.0}})[:1]
    found = identify([static], RIG, SHORT)
    validation = validate([static], RIG, found.parameters)
    page = tmp_path / 'page.html'
    write_validation_report(page, validation, [static], RIG, found.to_json())
    assert found.sound_factor > MAX_SOUND
    said = page.read_text()
    assert 'These parameters predict every channel' not in said
    assert f'The misfit is {found.sound_factor:.2f} times what noise and small errors' in said


def test_small_errors_of_the_rig_do_not_bend_the_law_beside_them():
    """Friction and creep act on D: D2 was 22 % wrong, six stated deviations."""
    found = identify(runs_with({
        'radial_friction': {'force': 400.0}, 'cylinder_friction': {'force': 250.0},
        'film_creep': {'share': 0.004, 'time': 6.0}, 'probe_drift': {'probe': 2.0, 'rate': 2e-9},
    }), RIG, SHORT)
    assert found.sound_factor > MAX_SOUND
    alone, beside = (errors_of(law)[1] for law in (found, found.beside_errors))
    assert np.abs(alone).max() > 4.0
    assert np.abs(beside).max() < 2.5


def test_no_law_beside_errors_is_stated_where_they_do_not_explain_the_misfit():
    found = identify(runs_with({'load_offset': {'offset': 1500.0}}), RIG, SHORT)
    assert found.waves.rms > 0.0
    assert found.beside_errors is None
    assert 'no law within the bounds explains the misfit' in found.status


def test_no_law_beside_errors_is_stated_with_a_parity_that_they_do_not_explain():
    """The gain of one radial probe is half of one of delta_x, which K2 and n2 imitate."""
    found = identify(runs_with({'cylinder_friction': {'force': 400.0},
                                'probe_gain': {'probe': 1.0, 'gain': 0.1}}), RIG, SHORT)
    assert found.sound_factor > MAX_SOUND
    assert found.beside_errors is None


def test_no_law_beside_errors_is_stated_with_a_parameter_at_its_bound():
    """K1 and K2 of a rig whose D2 lay beyond its bound were six stated deviations off."""
    settings = replace(SHORT, bounds={'D2': (1e5, 2e6)})  # below the true one
    found = identify(runs_with({'cylinder_friction': {'force': 400.0}}), RIG, settings)
    assert found.at_bound['D2']
    assert not found.determined['D2']
    assert 'bound' in found.reasons['D2']
    assert found.beside_errors is None


def test_a_search_that_is_cancelled_beside_errors_keeps_the_law_without_them():
    """Draws of errors take seconds a run: reports and the cancel come between them."""
    stages = []
    found = identify(wavy_runs(1), RIG, SHORT, on_progress=lambda at: stages.append(at.stage),
                     is_cancelled=lambda: stages.count('beside errors') == 2)
    assert found.cancelled
    assert found.beside_errors is None
    assert found.status.startswith('cancelled: the law without errors of the ring')
    assert 'raceways that wave by' in found.status
    assert found.chi_square > 0.0


def test_intervals_allow_for_waves_of_the_size_that_the_misfit_shows(wavy):
    errors, of_waves = [], []
    for found in wavy:
        errors.append(errors_of(found)[1])
        of_waves.append([found.budget[name]['raceway_waves'] for name in PARAMETER_NAMES])
        assert 1.5e-6 < found.waves.rms < 1.5e-5
        assert 'raceways that wave by' in found.status
        assert 'because the misfit exceeds the noise' in found.reasons['K1']
        assert 'K1' not in found.reasons_even
    # K and n of both rows; their errors were five times what was stated.
    law, rest = np.array(errors)[:, [0, 1, 3, 4]], 1.0 - np.array(of_waves)[:, [0, 1, 3, 4]]
    assert np.sqrt(np.mean(law**2)) < 1.5
    assert np.sqrt(np.mean(law**2 / rest)) > 4.0


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
    return objective.whiten(roller_effects(objective, contact)).T


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
