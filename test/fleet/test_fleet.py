"""Statistics over many sessions: false discoveries, unlike rings, drifts, rigs, remaining life."""

from dataclasses import replace
import json
import math
from textwrap import fill

import numpy as np
import pytest

from saddlering_ros.fleet import statistics
from saddlering_ros.fleet.attention import (
    fleet_document,
    fleet_page,
    history_chart,
    judge_fleet,
    limits_from_text,
    MAX_TITLE,
)
from saddlering_ros.fleet.history import follow, remaining_life, scales_alike, TimeSeries, YEAR
from saddlering_ros.fleet.statistics import benjamini_hochberg, e_value, figures_of, FleetError
from saddlering_ros.pages.html import pictures_of

ERROR = np.array([0.012, 0.004, 0.03, 0.012, 0.004, 0.03])
SPREAD = np.array([0.06, 0.006, 0.1, 0.06, 0.006, 0.1])
MEAN = np.array([17.4, 1.11, 14.9, 17.4, 1.11, 14.9])


def sessions_of(ring, change, *, rig='rig-a', count=8, seed=0, p_value=1.0):
    """Sessions of one ring whose coordinates change by `change` (6,) from one to the next."""
    chance = np.random.default_rng([seed, *ring.encode()])
    mean = MEAN + SPREAD * chance.standard_normal(6)
    return [
        statistics.SessionFigures(
            f'{ring}-{number}', f'{ring} {number}', ring, rig, (56.0 + 0.5 * number) * YEAR,
            500.0 * number, False, 'named' if p_value < 0.01 else 'none', p_value,
            mean + number * np.asarray(change) + ERROR * chance.standard_normal(6),
            np.diag(ERROR**2), {})
        for number in range(count)]


def fleet_of(changes, **options):
    return judge_fleet([session for ring, change in changes.items()
                        for session in sessions_of(ring, change)], **options)


STILL = np.zeros(6)
WEAR = np.array([-0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
LOAD_CELL = np.array([-0.03, 0.0, -0.03, -0.03, 0.0, -0.03])


def test_ten_false_alarms_in_a_thousand_clean_sessions_do_not_stand():
    p_values = np.random.default_rng(1).uniform(size=1000)
    assert (p_values < 0.01).sum() > 3
    assert not benjamini_hochberg(p_values).any()
    assert benjamini_hochberg([*p_values, 1e-8])[-1]


def test_an_e_value_of_a_sound_ring_is_at_most_one_in_the_mean():
    p_values = np.random.default_rng(2).uniform(size=200_000)
    assert np.mean([e_value([value]) for value in p_values]) == pytest.approx(1.0, abs=0.03)
    assert e_value([1e-4, 1e-4]) == pytest.approx(e_value([1e-4])**2)


def test_a_change_since_the_base_measurement_is_a_reason_for_attention():
    *earlier, last = sessions_of('SR-1', STILL)
    changed = figures_of(
        {'name': '', 'ring': 'SR-1', 'bench': '', 'time': last.time, 'service_hours': None,
         'maintenance': False},
        {'key': '', 'change': {'verdict': 'named', 'headline': 'Changed: play.'}}, 1.0)
    ring, = judge_fleet([*earlier, replace(last, change=changed.change)]).rings
    assert ring.reasons == ('Changed: play',)
    assert ring.concern >= 1.0


def test_a_finding_and_a_drift_show_the_titles_of_a_cause_and_its_alternatives():
    cause = {'effect': 'radial_friction',
             'titles': ['Dry friction in the radial row', 'Settling in the first cycle'],
             'parameters': {'force': {'value': 5e3, 'std': 50.0}}}
    found = figures_of(
        {'name': '', 'ring': 'SR-1', 'bench': '', 'time': 0.0, 'service_hours': None,
         'maintenance': False},
        {'key': '', 'verdict': {'verdict': 'named', 'causes': [cause]}}, 1e-9)
    sessions = [replace(session, p_value=1e-9, titles=found.titles,
                        causes={'radial_friction': (1e3 + 500.0 * number, 50.0)})
                for number, session in enumerate(sessions_of('SR-1', STILL))]
    ring, = judge_fleet(sessions).rings
    words = 'dry friction in the radial row or settling in the first cycle'
    assert ring.reasons == (f'finding: {words}', f'drifts: {words}')
    assert fill(words, MAX_TITLE) in [panel.title for panel in history_chart(ring).panels]


def test_restricted_likelihood_finds_the_spread_of_rings():
    chance = np.random.default_rng(3)
    between = np.array([[4.0, 1.0], [1.0, 2.0]]) * 1e-2
    own = np.broadcast_to(np.diag([1e-2, 5e-3]), (300, 2, 2))
    means = chance.multivariate_normal([1.0, 2.0], between + own[0], 300)
    found = statistics.fit_population(means, own)
    assert np.allclose(found.between, between, atol=0.006)
    assert np.allclose(found.mean, [1.0, 2.0], atol=0.05)


def test_the_one_ring_unlike_its_sisters_is_found_with_its_coordinate():
    chance = np.random.default_rng(4)
    means = MEAN + SPREAD * chance.standard_normal((30, 6))
    means[7, 2] += 0.8
    own = np.broadcast_to(np.diag(ERROR**2), (30, 6, 6))
    found, _ = statistics.unlike_sisters(means, own)
    assert [index for index, item in enumerate(found) if item.stands] == [7]
    assert int(np.argmax(np.abs(found[7].z_scores))) == 2


def test_a_wearing_ring_drifts_and_its_sisters_do_not():
    fleet = fleet_of({**{f'SR-{number}': STILL for number in range(6)}, 'SR-worn': WEAR})
    drifting, = [item for item in fleet.rings if item.drift is not None]
    assert drifting.ring == 'SR-worn'
    assert drifting.drift.group == ('stiffness_1',)
    assert drifting is fleet.rings[0]


def test_a_history_without_service_hours_is_drawn_over_calendar_years():
    sessions = [replace(session, service_hours=math.nan) for session in sessions_of('SR-1', STILL)]
    panel = history_chart(judge_fleet(sessions).rings[0]).panels[0]
    assert panel.x_label == 'year'
    assert panel.title == 'stiffness 1 / %'
    assert np.nanmin(panel.series[-1].x) == pytest.approx(2026.0)


def test_service_hours_that_fall_with_time_are_no_clock():
    sessions = sessions_of('SR-1', WEAR)
    set_back = [*sessions[:7], replace(sessions[7], service_hours=350.0)]
    ring, = judge_fleet(set_back).rings
    assert ring.history.clock == 'years'
    assert ring.history.of['stiffness_1'].slope < 0.0
    same_day = [replace(one, time=sessions[0].time) for one in reversed(sessions)]
    assert judge_fleet(same_day).rings[0].history.clock == 'service_hours'


def test_the_size_of_a_cause_has_a_history_of_its_own():
    sessions = [
        replace(session, causes={'radial_friction': (1e3 + 500.0 * number, 50.0)})
        for number, session in enumerate(sessions_of('SR-1', STILL))]
    ring, = judge_fleet(sessions).rings
    history = ring.history.of['radial_friction']
    assert history.slope * 500.0 == pytest.approx(500.0, rel=0.05)
    assert ring.drift.group == ('radial_friction',)


def test_one_session_does_not_drift():
    fleet = judge_fleet(sessions_of('SR-1', STILL, count=1))
    assert [item.reasons for item in fleet.rings] == [()]


def test_a_drift_of_everything_alike_may_be_the_load_cell():
    fleet = fleet_of({**{f'SR-{number}': STILL for number in range(6)}, 'SR-gain': LOAD_CELL})
    drift = next(item.drift for item in fleet.rings if item.drift is not None)
    assert drift.group == ('contact_stiffness', 'load_gain')
    assert 'dead weight' in drift.next_test


def test_rings_of_one_rig_that_drift_together_are_the_fault_of_the_rig():
    sessions = [session for number in range(6)
                for session in sessions_of(f'SR-{number}', LOAD_CELL, rig='bad')]
    sessions += [session for number in range(6, 12)
                 for session in sessions_of(f'SR-{number}', STILL, rig='good')]
    fleet = judge_fleet(sessions)
    assert [item.owner for item in fleet.rigs] == ['bad']
    assert not [item.ring for item in fleet.rings if item.drift is not None]


def test_the_drift_of_a_rig_a_year_is_not_that_of_a_ring_an_hour():
    sessions = [replace(session, service_hours=math.nan) for number in range(5)
                for session in sessions_of(f'SR-{number}', LOAD_CELL)]
    fleet = judge_fleet([*sessions, *sessions_of('SR-hours', STILL)])
    assert [(item.owner, item.clock) for item in fleet.rigs] == [('rig-a', 'years')]
    assert not [item.ring for item in fleet.rings if item.drift is not None]


def test_scaled_coordinates_that_differ_are_no_load_cell():
    slopes = {'stiffness_1': (-1.0, 0.1), 'damping_1': (-1.0, 0.1), 'stiffness_2': (0.0, 0.1)}
    assert not scales_alike(slopes)


def test_maintenance_breaks_a_history():
    time = np.arange(10.0)
    value = np.where(time < 5, 0.0, 1.0) + 0.01 * np.random.default_rng(5).standard_normal(10)
    renewed = time == 5
    broken = follow(TimeSeries(time, value, np.full(10, 0.01), renewed))
    assert broken.drift_p_value > 0.01
    assert abs(broken.surprises[np.isfinite(broken.surprises)]).max() < 4.0


def test_remaining_life_is_silent_without_a_significant_drift():
    time = np.arange(10.0)
    still = follow(TimeSeries(time, 0.01 * np.random.default_rng(6).standard_normal(10),
                              np.full(10, 0.01), np.zeros(10, dtype=bool)))
    assert remaining_life(still, -1.0) is None
    falling = follow(TimeSeries(time, still.series.value - 0.05 * time, np.full(10, 0.01),
                                np.zeros(10, dtype=bool)))
    life = remaining_life(falling, -1.0)
    assert life.low < 11.0 < life.high
    assert remaining_life(falling, 1.0) is None  # away from the limit


def test_remaining_life_holds_its_interval():
    held, count = 0, 0
    for seed in range(60):
        value = -0.05 * np.arange(8.0) + 0.012 * np.random.default_rng(seed).standard_normal(8)
        history = follow(TimeSeries(np.arange(8.0), value, np.full(8, 0.012), np.zeros(8, bool)))
        life = remaining_life(history, -0.6)
        if life is not None:
            count += 1
            held += life.low <= 5.0 <= life.high
    assert count > 40
    assert held / count > 0.8


def test_stiffness_at_the_reference_penetration_is_known_better_than_k():
    values = np.array([1.29e8, 1.11, 3e6, 1.29e8, 1.11, 3e6])
    std_k, std_n = 0.1 * values[0], 0.0092
    covariance = np.diag([std_k**2, std_n**2, 9e10] * 2)
    covariance[0, 1] = covariance[1, 0] = covariance[3, 4] = covariance[4, 3] = 0.98*std_k*std_n
    value, found = statistics.to_coordinates(values, covariance)
    assert value[0] == pytest.approx(math.log(1.29e8) + 0.11 * math.log(2e-5))
    assert math.sqrt(found[0, 0]) < 0.3 * std_k / values[0]


def test_limits_that_cannot_be_used_are_one_line():
    assert limits_from_text(['K1=6e7']) == {'K1': 6e7}
    for text, words in (('k=3', 'give one of K1'), ('K1=x', 'is not a number'),
                        ('K1=1_0', 'is not a number'),
                        ('K1=-1', 'above 0')):
        with pytest.raises(FleetError, match=words):
            limits_from_text([text])


def test_document_and_page_name_who_needs_a_person(no_pictures):
    fleet = fleet_of({**{f'SR-{number}': STILL for number in range(5)}, 'SR-worn': WEAR},
                     limits={'K1': 1e7})
    document = json.loads(json.dumps(fleet_document(fleet), allow_nan=False))
    assert document['rings'][0]['reasons'] == ['drifts: stiffness of the axial rows']
    assert document['rings'][0]['remaining_life']['K1']['median'] > 0.0
    worn = fleet.rings[0]
    exponent = np.mean([item.value[1] for item in worn.sessions])
    life = remaining_life(worn.history.of['stiffness_1'], math.log(1e7 * 2e-5**(exponent - 1.0)))
    assert vars(worn.life['K1']) == pytest.approx(vars(life))
    page = fleet_page(fleet, [('SR-9 2026-01-01', 'no unloading branch')])
    assert 'SR-worn' in page
    assert 'no unloading branch' in page
    assert 'history_SR-worn' in pictures_of(page)


def test_a_failed_session_has_no_values():
    task = {'name': 'a', 'ring': 'a', 'bench': '', 'time': None, 'service_hours': None,
            'maintenance': False}
    figures = figures_of(task, {'key': 'k', 'status': 'failed'}, 1.0)
    assert np.isnan(figures.value).all()
