"""Claims about identification from whole runs: both methods, open parameters, bad input."""

from dataclasses import replace
import json
import pickle

import identification_records
from identification_records import dynamic_run, observe, record, RIG, staircase, static_run
import numpy as np
import pytest

from saddlering_ros.doubts import Finding
from saddlering_ros.estimation.least_squares import SearchSpace
from saddlering_ros.identification import methods, uncertainty
from saddlering_ros.identification import objective as objectives
from saddlering_ros.identification.methods import identify, MISFIT_ADVICE
from saddlering_ros.identification.objective import average_branches, predict, WeightedObjective
from saddlering_ros.identification.result import identification_text
from saddlering_ros.identification.ring_errors import errors_of_ring
from saddlering_ros.identification.settings import (
    IdentificationError,
    IdentificationSettings,
    SwarmSettings,
)
from saddlering_ros.identification.uncertainty import assess, joint_axes, reason_open
from saddlering_ros.record.record import Record
from saddlering_ros.rig import PARAMETER_NAMES, TONNE, TRUE_TO_SCALE

SHORT_SWARM = SwarmSettings(particles=10, iterations=10)


@pytest.fixture(scope='module')
def four_runs():
    """Static and dynamic runs at 50 and 70 degrees of the true-to-scale ring."""
    return [
        static_run(50.0, memory=0.5, seed=1), dynamic_run(50.0, seconds=4.0, memory=0.5, seed=2),
        static_run(70.0, memory=0.5, seed=3), dynamic_run(70.0, seconds=4.0, memory=0.5, seed=4)]


@pytest.fixture(scope='module')
def found(four_runs):
    return identify(four_runs, RIG, IdentificationSettings(seed=5))


def test_the_truth_lies_within_four_standard_errors(found):
    off = (found.parameters.contact.to_array() - TRUE_TO_SCALE.to_array()) / found.std
    assert np.all(np.abs(off) < 4.0)


def test_every_parameter_is_determined_by_both_tests_at_two_elevations(found):
    assert all(found.determined.values())
    assert found.status == 'identified'


def test_the_fit_is_as_good_as_the_noise(found):
    assert found.reduced_chi_square == pytest.approx(1.0, abs=0.25)


def test_two_minutes_of_cycles_fit_as_well_as_their_noise():
    # Means over 120 ms are compared. The load must not be averaged over as long beforehand.
    times = np.arange(42) * 3.0
    loads = np.where(np.arange(42) % 4 < 2, RIG.preload, 25 * TONNE)
    profile = identification_records.sampled(times, loads, 100.0)
    run = record('dynamic', profile, noise=1e-7, load_noise=40.0)
    found = identify([run], RIG, IdentificationSettings(seed=5, swarm=SHORT_SWARM))
    assert found.reduced_chi_square == pytest.approx(1.0, abs=0.25)


def test_stiffness_and_exponent_are_reported_as_one(found):
    for row, first, second in ((1, 0, 1), (2, 3, 4)):
        assert found.correlation[first, second] > 0.95
        assert found.collinearity[f'K{row},n{row}'] > 10.0


def test_the_joint_region_of_a_known_covariance_has_its_area_and_holds_95_percent():
    known = np.array([[0.05**2, 0.98 * 0.05 * 0.006], [0.98 * 0.05 * 0.006, 0.006**2]])
    axes = joint_axes(known)
    assert np.linalg.norm(axes[0]) > np.linalg.norm(axes[1])
    assert axes[0] @ axes[1] == pytest.approx(0.0, abs=1e-12)
    quantile = 5.991464547  # of chi square with two degrees of freedom, 95 %
    assert abs(np.linalg.det(axes)) == pytest.approx(quantile * np.sqrt(np.linalg.det(known)))
    drawn = np.random.default_rng(1).multivariate_normal([0.0, 0.0], known, 20_000)
    inside = np.linalg.norm(drawn @ np.linalg.inv(axes), axis=1) <= 1.0
    assert inside.mean() == pytest.approx(0.95, abs=0.005)  # three standard deviations


def test_the_joint_region_ends_at_the_bounds():
    entry = {'half_axes': [[3.0, 0.3], [0.0, 0.1]],
             'bounds': {'K1': [1e8, 2e8], 'n1': [1.0, 1.15]}}
    stiffness, exponent = uncertainty.joint_outline(1.3e8, 1.1, entry)
    assert (stiffness.min(), stiffness.max()) == pytest.approx((1e8, 2e8))
    assert (exponent.min(), exponent.max()) == pytest.approx((1.0, 1.15))


def test_the_joint_regions_of_a_result_are_those_of_its_covariance(found):
    document = found.to_json()
    assert set(document['joint']) == {'K1,n1', 'K2,n2'}
    for row, first in ((1, 0), (2, 3)):
        axes = np.array(document['joint'][f'K{row},n{row}']['half_axes'])
        values = document['parameters'][f'K{row}']['value'], 1.0
        covariance = found.covariance[first:first + 2, first:first + 2] / np.outer(values, values)
        assert axes.T @ axes == pytest.approx(5.991464547 * covariance)


def test_another_seed_ends_at_the_same_bottom(four_runs, found):
    other = identify(four_runs, RIG, IdentificationSettings(seed=99, swarm=SHORT_SWARM))
    assert other.objective == pytest.approx(found.objective, rel=1e-7)


def test_the_result_is_plain_json_and_plain_text(found):
    document = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert set(document['parameters']) == set(PARAMETER_NAMES)
    text = identification_text(found)
    assert 'reduced chi square' in text
    assert f'= {np.sqrt(found.reduced_chi_square):.2f} times the noise' in text
    assert 'Palmgren' in text


def test_the_result_can_be_sent_between_processes(found):
    again = pickle.loads(pickle.dumps(found))
    assert again.parameters.contact == found.parameters.contact


def test_a_static_run_does_not_pin_damping_nor_one_elevation_the_exponent(four_runs):
    static_only = identify(four_runs[:1], RIG, IdentificationSettings(swarm=SHORT_SWARM))
    open_names = [name for name, known in static_only.determined.items() if not known]
    assert open_names == ['K1', 'n1', 'D1', 'n2', 'D2']
    document = static_only.to_json()
    assert document['parameters']['D1']['std'] is None
    assert document['parameters']['n1']['interval'] is None
    assert 'dynamic run' in static_only.reasons['D1']
    assert 'another elevation' in static_only.reasons['n1']
    assert 'not determined by these data' in identification_text(static_only)


def test_dynamic_runs_alone_identify_too(four_runs):
    dynamic = identify(four_runs[1::2], RIG, IdentificationSettings(seed=3))
    off = dynamic.parameters.contact.to_array() / TRUE_TO_SCALE.to_array() - 1.0
    assert np.all(np.abs(off) < 0.05)


def test_any_corner_of_the_box_is_recovered():
    random = np.random.default_rng(11)
    contact = identification_records.drawn_contact(random)
    runs = [
        record('static', staircase(hold=5.0), elevation=50.0, contact=contact, seed=1),
        dynamic_run(70.0, seconds=4.0, contact=contact, seed=2)]
    result = identify(runs, RIG, IdentificationSettings(seed=1))
    simulated = predict(RIG, result.parameters.contact.to_array()[None], observe(
        runs, RIG, fit_rate=50.0)[0])[0]
    true = predict(RIG, contact.to_array()[None], observe(runs, RIG, fit_rate=50.0)[0])[0]
    assert np.abs(simulated - true).max() < 1e-7


def test_the_papers_method_takes_two_steps_of_its_own_size(four_runs):
    stages = []
    result = identify(
        four_runs[:2], RIG, IdentificationSettings(method='paper'),
        on_progress=lambda progress: stages.append((progress.stage, progress.search.iteration)))
    assert result.evaluations == 2 * 20 * 50
    assert stages[0] == ('static step', 1)
    assert [*filter(lambda at: at[0] != 'intervals', stages)][-1] == ('dynamic step', 50)
    assert result.objective < 0.02


def test_the_papers_objective_leaves_delta_y_out_unless_asked(four_runs):
    assert IdentificationSettings(method='paper').channels == (0, 2)
    assert IdentificationSettings(method='paper', use_delta_y=True).channels == (0, 1, 2)
    assert IdentificationSettings().channels == (0, 1, 2)


def test_branches_are_averaged_for_the_paper_only(four_runs):
    both = observe(four_runs[:1], RIG, fit_rate=50.0)[0]
    averaged = average_branches(both, RIG.limits.level_step)
    assert len(both.load) == 51
    assert len(averaged.load) == 26
    up = both.displacement[0, 10]
    down = both.displacement[0, 40]
    assert averaged.displacement[0, 10] == pytest.approx((up + down) / 2.0)


def test_a_turning_point_is_read_on_the_way_up(four_runs):
    one = replace(observe(four_runs[:1], RIG, fit_rate=50.0)[0], time=np.arange(3.0),
                  load=np.full(3, 1e5), displacement=np.tile([1.0, 2.0, 6.0], (3, 1)),
                  branch=np.array([0, 1, -1]), standard_error=np.ones((3, 3)))
    averaged = average_branches(one, RIG.limits.level_step)
    assert averaged.displacement == pytest.approx(np.full((3, 1), (1.5 + 6.0) / 2.0))


def test_the_papers_objective_is_the_normalised_mean_square(four_runs):
    one = observe(four_runs[:1], RIG, fit_rate=50.0)[0]
    contact = TRUE_TO_SCALE.to_array()[None]
    simulated = predict(RIG, contact, one)[0]
    by_hand = sum(
        np.mean((simulated[c] - one.displacement[c]) ** 2) / np.mean(one.displacement[c] ** 2)
        for c in (0, 2))
    assert objectives.PaperObjective(RIG, [one], (0, 2))(contact)[0] == pytest.approx(by_hand)


def test_residuals_of_the_truth_are_white(four_runs):
    observations = observe(four_runs, RIG, fit_rate=50.0)
    residuals = WeightedObjective(RIG, observations, (0, 1, 2)).residuals(
        TRUE_TO_SCALE.to_array()[None]
    )[0]
    assert residuals.std() == pytest.approx(1.0, abs=0.1)
    assert abs(np.corrcoef(residuals[:-1], residuals[1:])[0, 1]) < 0.1


def test_slopes_of_the_residuals_are_those_of_differences(four_runs):
    observations = observe(four_runs[:2], RIG, fit_rate=50.0)
    objective = WeightedObjective(
        RIG, [*observations, observations[0].coarse(), observations[1].coarse()], (0, 1, 2))
    law = TRUE_TO_SCALE.to_array()
    aside = 1e-5 * np.diag(law)
    more, less = np.split(objective.residuals(np.concatenate([law + aside, law - aside])), 2)
    differences = (more - less) / (2e-5 * law[:, None])
    for own, pair in zip(objective.linearised(law).slopes(), differences, strict=True):
        assert own == pytest.approx(pair, abs=1e-4 * np.abs(pair).max())


def test_a_ring_still_settling_on_its_plateaus_is_no_misfit():
    sluggish = replace(TRUE_TO_SCALE, D2=2e7, K2=3e7)
    runs = [static_run(50.0, contact=sluggish, seed=1),
            dynamic_run(50.0, seconds=4.0, contact=sluggish, seed=2)]
    observations = observe(runs, RIG, fit_rate=50.0)
    truth = sluggish.to_array()
    settled = WeightedObjective(RIG, [one.coarse() for one in observations], (0, 1, 2))
    assert settled.mean_squares(truth)[0] > 3.0
    settling = WeightedObjective(RIG, observations, (0, 1, 2))
    assert settling.mean_squares(truth) == pytest.approx([1.0, 1.0], abs=0.3)
    assert settling.with_settled_plateaus(truth).observations[0].spans is not None


def test_plateaus_that_come_to_rest_count_as_equilibria_with_the_same_residuals():
    truth = TRUE_TO_SCALE.to_array()
    observations = observe([static_run(50.0, seed=1)], RIG, fit_rate=50.0)
    moving = WeightedObjective(RIG, observations, (0, 1, 2))
    at_rest = moving.with_settled_plateaus(truth)
    assert at_rest.observations[0].spans is None
    for law in (truth, truth * [1.02, 1.0, 1.1, 0.98, 1.0, 1.1]):
        alike = at_rest.residuals(law[None])[0]
        assert alike == pytest.approx(moving.residuals(law[None])[0], abs=0.05)


def test_cancelling_returns_what_there_is(four_runs):
    seen = []
    result = identify(
        four_runs, RIG, on_progress=seen.append, is_cancelled=lambda: len(seen) >= 3)
    assert result.cancelled
    assert len(seen) == 3
    assert np.all(np.isfinite(result.parameters.contact.to_array()))


def test_the_descents_and_the_errors_of_the_ring_report_that_they_go_on(four_runs):
    """Five minutes of cycles were followed by up to 9 s of silence."""
    seen = []
    identify(four_runs[:2], RIG, on_progress=seen.append)
    stages = [report.stage for report in seen]
    assert stages.count('refinement') >= 6
    assert stages.count('intervals') >= 2
    assert seen[-1].share == 1.0, 'a shown line of progress is not ended'


def test_what_depends_on_a_parameter_at_its_bound_is_open_too(four_runs):
    settings = IdentificationSettings(bounds={'n2': (1.0, 1.08)}, swarm=SHORT_SWARM)
    result = identify(four_runs, RIG, settings)
    assert result.at_bound['n2']
    assert 'K2 depends on n2, which is at its bound' in result.reasons['K2']
    assert set(result.reasons) == {'K2', 'n2'}
    assert not result.determined['n2']
    assert 'bound' in result.reasons['n2']


def test_a_rig_unlike_the_model_widens_the_intervals(four_runs, found):
    middle = replace(RIG.radial_row, clearance=200e-6)
    wrong = identify(
        four_runs, replace(RIG, radial_row=middle), IdentificationSettings(swarm=SHORT_SWARM))
    assert wrong.reduced_chi_square > 2.0
    assert 'widened' in wrong.status
    wider, usual = (item.parameters.source.covariance for item in (wrong, found))
    assert wider[3, 3] > usual[3, 3]


@pytest.mark.filterwarnings('error::RuntimeWarning')
@pytest.mark.parametrize(('row', 'column', 'factor'), [
    (slice(None), 2, 1e-12), (7, slice(None), 1e6)], ids=['no reading', 'one reading'])
def test_a_stiffness_that_no_or_one_reading_determines_has_no_interval_and_no_overflow(
        row, column, factor):
    objective = WeightedObjective(RIG, observe([static_run(50.0)], RIG, fit_rate=50.0), (0, 1, 2))
    space = SearchSpace.of(RIG.bounds, methods.STATIC_NAMES, TRUE_TO_SCALE, ('K1', 'K2'))
    best = objectives.stay_at(objective, space, TRUE_TO_SCALE)
    jacobian = best.jacobian.copy()
    jacobian[row, column] *= factor
    lone = replace(best, jacobian=jacobian)
    trust = assess(objective, space, lone, errors_of_ring(objective, lone), RIG.bounds, '')
    assert trust.intervals['K2'] is None
    assert ('one reading alone' in trust.reasons['K2']) == (row == 7)


def half_of(run, *, second=False):
    """A run that ends at its highest load, or begins there."""
    top = int(np.argmax(run.load)) + (300 if run.test == 'static' and not second else 0)
    half = slice(top, None) if second else slice(top)
    return replace(run, time=run.time[half], load=run.load[half], stamps=run.stamps[half],
                   gaps=run.gaps[:, half])


def still():
    """A static run of one plateau."""
    time = np.arange(0.0, 20.0, 0.01)
    return record('static', (time, np.full(time.size, 10.0 * TONNE)))


@pytest.mark.parametrize(('runs', 'settings', 'said'), [
    (list, {}, 'no runs'),
    (lambda: [static_run(50.0, top=4)], {}, r'no load exceeds 5\.0 t, a fifth'),
    (lambda: [still()], {}, 'too few|one plateau'),
    (lambda: [half_of(static_run(50.0))], {}, 'no unloading branch'),
    (lambda: [half_of(dynamic_run(50.0))], {}, 'no unloading branch'),
    (lambda: [half_of(static_run(50.0), second=True)], {}, 'no loading branch'),
    (lambda: [half_of(dynamic_run(50.0), second=True)], {}, 'no loading branch'),
    (lambda: [replace(half_of(static_run(50.0)), notes=[Finding('a: cut off', is_cut=True), 'b'])],
     {}, r'unloading branch .*\(a: cut off\): record'),
    (lambda: [replace(static_run(50.0), elevation=np.nan)], {}, 'elevation'),
    (lambda: [dynamic_run(50.0)], {'method': 'paper'}, 'needs a static run'),
    (lambda: [static_run(50.0)], {'bounds': {'K1': (1e9, 2e7)}}, 'K1'),
    (lambda: [static_run(50.0), dynamic_run(50.0)], {'bounds': {'K1': (1e3, 1e15)}},
     r'^the bounds of K1 reach too far: .* at K1=\d.*: give narrower ones .*2e\+07 to 1e\+09$')])
def test_runs_and_bounds_that_give_no_law_are_refused_in_one_line(runs, settings, said):
    with pytest.raises(IdentificationError, match=said) as caught:
        identify(runs(), RIG, IdentificationSettings(**settings))
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('method', ['default', 'paper'])
def test_an_objective_that_is_not_a_number_is_refused(four_runs, method, monkeypatch):
    def broken(rig, contacts, observation):
        return np.full((len(contacts), 3, len(observation.load)), np.nan)

    monkeypatch.setattr('saddlering_ros.identification.objective.predict', broken)
    with pytest.raises(IdentificationError, match='not a number') as caught:
        identify(four_runs, RIG, IdentificationSettings(method=method))
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    'wrong', [{'method': 'best'}, {'bounds': {'K3': (1.0, 2.0)}}, {'fit_rate': 0.0}])
def test_settings_that_mean_nothing_are_refused(wrong):
    with pytest.raises(IdentificationError):
        IdentificationSettings(**wrong)


def clipped(run, limit):
    """The run as probes with a span up to `limit` [m] record it, and the rig that has them."""
    rig = replace(RIG, probes=replace(RIG.probes, max_range=limit))
    return replace(run, gaps=np.minimum(run.gaps, limit)), rig


def test_what_a_probe_at_the_end_of_its_span_reads_is_left_out(four_runs):
    limit = 1e-3 + 0.8 * (np.nanmax([run.gaps for run in four_runs[0:1]]) - 1e-3)
    pairs = [clipped(run, limit) for run in four_runs[:2]]
    found = identify([run for run, _ in pairs], pairs[0][1],
                     IdentificationSettings(swarm=SHORT_SWARM))
    assert sum('limit of its span' in note for note in found.notes) >= 2
    off = found.parameters.contact.to_array() - TRUE_TO_SCALE.to_array()
    assert np.all(np.abs(off / np.sqrt(np.diag(found.covariance))) < 4.0)
    assert found.reduced_chi_square == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize('probe', range(4))
def test_a_plateau_that_a_probe_has_no_readings_of_is_left_out(four_runs, probe):
    """Without one of the axial probes the objective was not a number, and the run was refused."""
    run, gaps = four_runs[0], four_runs[0].gaps.copy()
    missing = (run.time > 0.4 * run.time[-1]) & (run.time < 0.4 * run.time[-1] + 8.0)
    gaps[probe, missing] = np.nan
    found = identify([replace(run, gaps=gaps), four_runs[1]], RIG,
                     IdentificationSettings(swarm=SHORT_SWARM))
    off = found.parameters.contact.to_array() - TRUE_TO_SCALE.to_array()
    assert np.all(np.abs(off / np.sqrt(np.diag(found.covariance))) < 4.0)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(('number', 'limit'), [(0, 1.0005e-3), (1, 1.0005e-3), (1, 0.9e-3)])
def test_a_run_with_probes_at_their_limit_throughout_is_refused(four_runs, number, limit):
    run, rig = clipped(four_runs[number], limit)
    with pytest.raises(IdentificationError, match='limit of their span') as caught:
        identify([run], rig)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('logarithmic', 'low'), [(False, 2e7), (True, np.log(2e7))])
def test_the_papers_swarm_searches_stiffness_on_the_scale_asked_for(
        four_runs, monkeypatch, logarithmic, low):
    boxes = []
    search = methods.minimise
    monkeypatch.setattr(methods, 'minimise', lambda objective, *box, **options: (
        boxes.append(box), search(objective, *box, **options))[1])
    identify(four_runs[:1], RIG, IdentificationSettings(
        method='paper', swarm=SHORT_SWARM, logarithmic_stiffness=logarithmic))
    stiffness, exponent = boxes[0][0][:2]
    assert stiffness == pytest.approx(low)
    assert exponent == pytest.approx(1.0)


def test_a_lag_that_readings_show_widens_the_interval_of_the_damping(monkeypatch):
    runs = [static_run(50.0), dynamic_run(50.0)]
    found = identify(runs, RIG)
    monkeypatch.setattr(Record, 'doubtful_lag', 5e-3)
    wider = identify(runs, RIG)
    shift = abs(found.systematic['delay'][2]) * 5.0 * found.parameters.contact.D1
    assert wider.std[2] == pytest.approx(np.hypot(found.std[2], shift), rel=1e-3)
    assert wider.std[2] > 3.0 * found.std[2]


def test_a_misfit_that_is_less_than_noise_can_leave_is_told(found):
    """K1 was 9 % too small without a word: the load was averaged over seconds, and so came late.

    The ramps that the probes showed while the load stood still were taken for noise.
    """
    static, dynamic = static_run(top=8, seed=1), dynamic_run(seed=2, seconds=4.0)
    late = replace(static, gaps=np.pad(static.gaps[:, 100:], ((0, 0), (0, 100)), mode='edge'))
    answer = identify([late, dynamic], RIG)
    assert uncertainty.TOO_QUIET.format(answer.sound_factor) in answer.status
    assert answer.contact.K1 < 0.95 * TRUE_TO_SCALE.K1
    assert answer.beside_errors is None
    assert 'stands still' not in found.status


def test_noise_and_imperfection_together_leave_a_stiffness_of_one_elevation_open():
    half = uncertainty.MAX_HALF_WIDTH['K']
    worst = (0.9 * half, '5 µm of clearance')
    noise = [0.1 * half] * 3
    assert reason_open('K1', [0.0] * 3, *worst, 1, '') is None
    assert 'curvature only: 5 µm of clearance' in reason_open('K1', noise, *worst, 1, '')
    assert reason_open('K1', noise, *worst, 2, '') is None


def test_a_misfit_that_leaves_a_parameter_open_is_named_with_its_remedy():
    wide, narrow = 0.5, 0.05
    beside = (0.0, '', 2, MISFIT_ADVICE['paper'])
    assert reason_open('K2', [wide, narrow, narrow], *beside) == (
        'K2 is known only within a factor 2.66 (95 %), because the misfit exceeds the noise: use '
        'the default method, which fits closer, or look for the cause with diagnose')
    assert 'add more or longer runs' in reason_open('K2', [wide, wide, wide], *beside)
    assert reason_open('K2', [narrow, narrow, narrow], *beside) is None


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_what_the_papers_swarm_publishes_holds_the_truth(four_runs, seed):
    # A swarm ends on the valley of K and n, far from its bottom and from the truth.
    found = identify(four_runs, RIG, IdentificationSettings(method='paper', seed=seed))
    wrong = [
        name for name, interval in found.intervals.items() if interval is not None
        and not interval[0] <= getattr(TRUE_TO_SCALE, name) <= interval[1]]
    assert not wrong
    assert found.determined['D1']
    assert found.determined['D2']
    assert all('use the default method' in reason for reason in found.reasons.values())
