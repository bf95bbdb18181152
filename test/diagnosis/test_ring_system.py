"""Claims on the ring as the engine sees it: where searches start, how sensitivities are taken."""

from dataclasses import replace
from pathlib import Path

from few_effects import few_effects
import numpy as np
import pytest
from shared_verdicts import shared_diagnose

from saddlering_ros import diagnose, diagnosis
from saddlering_ros.bags.reader import read_run
from saddlering_ros.diagnosis.records import build_record
from saddlering_ros.diagnosis.ring_system import engine_effects, RingSystem
from saddlering_ros.discrepancy import Point
from saddlering_ros.effects import catalogue, EffectError, extension_of
from saddlering_ros.effects.extension import RingExtension
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.record.record import Record
from saddlering_ros.rig import default_rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import probe_batch


@pytest.fixture(scope='module')
def run(campaign):
    return build_record(
        default_rig(), read_run(*campaign(runs=['static_50'])), held_out=False).run


def test_no_block_of_a_long_dynamic_run_lies_across_a_gap_of_its_data(campaign):
    record = read_run(*campaign(runs=['dynamic_50']))
    # 300 times slower, so that a block has 4 s, and the gap is 3 s in the middle of one.
    slow = replace(record, stamps=300 * record.stamps, time=300.0 * record.time, spikes=None,
                   used=None, published=None, probe_marks=None, load_marks=None)
    centre = build_record(default_rig(), slow, held_out=False).run.time[250]
    kept = abs(slow.time - centre) > 1.4
    cut = replace(slow, stamps=slow.stamps[kept], time=slow.time[kept], load=slow.load[kept],
                  gaps=slow.gaps[:, kept])
    grid = build_record(default_rig(), cut, held_out=False).run.payload
    steps = [np.diff(grid.time[first:last]).max(initial=0.0)
             for first, last in zip(grid.first, grid.last, strict=True)]
    assert np.diff(grid.time).max() > 2.5
    assert max(steps) < 2.5


def without_noise(record: Record) -> np.ndarray:
    """A load of the same kind as that of a test, without noise."""
    if record.test == 'dynamic':
        corners = record.time[-1] * np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
        level = TONNE * np.array([0.5, 0.5, 25.0, 25.0, 0.5, 0.5])
        return np.interp(record.time, corners, level)
    held = plateaus(record)
    spans = list(zip(held.hold_start, held.hold_stop, strict=True))
    level = [np.median(record.load[start:stop]) for start, stop in spans]
    return np.interp(np.arange(record.time.size), np.ravel(spans), np.repeat(level, 2))


def error_of_blocks(record: Record) -> float:
    """Largest error [m] of the simulated blocks of a ring that settles slowly."""
    rig = default_rig()
    slow = replace(TRUE_TO_SCALE, K1=1e8, D1=5.6e6, D2=3.9e6).to_array()
    run = build_record(rig, record, held_out=False).run
    fine = probe_batch(rig, [(slow, RingExtension())], record.elevation, record.time, record.load,
                       run.payload.zero_load, max_step=2e-4)[0]
    truth = [fine[:, abs(record.time - centre) < 0.5 * width].mean(axis=1)
             for centre, width in zip(run.time, run.width, strict=True)]
    error = RingSystem(rig).predict_many(run, [Point(slow)])[0] - np.transpose(truth)
    return float(np.abs(error - error.mean(axis=1, keepdims=True)).max())


@pytest.mark.parametrize(('name', 'most'), [('static_50', 1e-7), ('dynamic_50_fast', 2e-7)])
def test_blocks_of_a_ring_that_settles_slowly_are_means_of_a_fine_simulation(campaign, name, most):
    record = read_run(*campaign(runs=[name]))
    assert error_of_blocks(replace(record, load=without_noise(record))) < most


def test_long_blocks_of_cycles_are_means_of_a_fine_simulation(campaign):
    # Blocks of half a second. Some begin and end at one load and hold a rest between two ramps.
    record = read_run(*campaign(runs=['dynamic_50_fast']))
    stamps = record.stamps[0] + np.arange(30_000) * 10_000_000
    time = (stamps - stamps[0]) * 1e-9
    load = np.interp(time % 3.0, np.array([0.0, 0.3, 1.35, 1.65, 3.0]),
                     TONNE * np.array([0.5, 0.5, 25.0, 25.0, 0.5]))
    cycles = replace(record, stamps=stamps, time=time, load=load, gaps=np.full((4, 30_000), 1e-3),
                     spikes=None, used=None, published=None, probe_marks=None, load_marks=None)
    assert error_of_blocks(cycles) < 2e-7


@pytest.mark.parametrize('name', ['static_50', 'dynamic_50_fast'])
def test_the_noise_of_the_load_cell_does_not_move_the_friction_of_the_cylinder(campaign, name):
    rig, record = default_rig(), read_run(*campaign(runs=[name]))
    smooth = without_noise(record)
    noisy = smooth + np.random.default_rng(0).normal(0.0, 50.0, smooth.size)
    rubbing = Point(TRUE_TO_SCALE.to_array(), {'cylinder_friction': {
        'force': 3000.0, 'presliding': 2500.0, 'sharpness': 0.5}})
    changes = []
    for load in (smooth, noisy):
        run = build_record(rig, replace(record, load=load), held_out=False).run
        moved, usual = RingSystem(rig).predict_many(run, [rubbing, Point(rubbing.base)])
        changes.append(moved - usual)
    assert np.std(changes[1] - changes[0]) < 0.05 * np.std(changes[0])


@pytest.mark.parametrize('name', ['carriage_resonance', 'probe_saturation'])
def test_every_start_an_effect_holds_worth_trying_is_tried(name):
    effect = catalogue()[name]
    assert effect.starts
    for form in engine_effects(effect, default_rig()):
        assert all(any(start.items() <= item.items() for item in form.starts)
                   for start in effect.starts)


@pytest.mark.parametrize(('name', 'size', 'power'), [
    ('radial_friction', 'force', 1), ('load_offset', 'offset', 1),
    ('radial_compliance', 'compliance', -1), ('axial_clearance', 'change', 0)])
def test_sizes_that_are_searched_follow_the_full_scale_of_the_rig(name, size, power):
    usual, large = (engine_effects(catalogue()[name], replace(
        default_rig(), full_scale_load=factor * default_rig().full_scale_load))[0]
                    for factor in (1.0, 16.0))
    for bound in ('low', 'high'):
        at = getattr(usual.parameters[size], bound) * 16.0**power
        assert getattr(large.parameters[size], bound) == pytest.approx(at)


def test_a_parameter_file_of_a_large_rig_may_hold_large_forces():
    effects, rig = {'radial_friction': {'force': 150e3}}, default_rig()
    large = replace(rig, full_scale_load=16.0 * rig.full_scale_load)
    assert extension_of(effects, large).radial_friction.limit == 150e3
    with pytest.raises(EffectError, match='give a number from 0 to 80000 N'):
        extension_of(effects, rig)


def test_stiffness_and_exponent_are_told_apart_by_their_slopes_not_by_the_bend_of_a_step(run):
    rig = default_rig()
    system = RingSystem(rig)
    values = TRUE_TO_SCALE.to_array()

    def slopes(scale: float) -> np.ndarray:
        columns = []
        for index in (0, 1):
            item = system.base_parameters[index]
            moved = values.copy()
            moved[index] = item.from_unit(item.to_unit(values[index]) + scale * item.step)
            more, usual = system.predict_many(run, [Point(moved), Point(values)])
            change = more - usual
            columns.append(
                ((change - change.mean(axis=1, keepdims=True)) / (scale * item.step)).ravel())
        return np.column_stack(columns)

    fine, finer = slopes(1.0), slopes(0.2)
    _, _, vectors = np.linalg.svd(finer, full_matrices=False)
    weak = finer @ vectors[1]
    assert np.linalg.norm(fine @ vectors[1] - weak) < 0.1 * np.linalg.norm(weak)


def test_the_change_by_a_newton_is_a_slope_on_a_small_rig_too(run):
    small = replace(default_rig(), full_scale_load=0.01 * default_rig().full_scale_load)
    grid = run.payload
    weak = replace(grid, load=0.01 * grid.load, zero_load=0.01 * grid.zero_load)
    system, point = RingSystem(small), Point(TRUE_TO_SCALE.to_array())
    less, more = (
        system.predict_many(
            replace(run, payload=replace(weak, load=weak.load + change)), [point])[0]
        for change in (-0.1, 0.1))
    found = system.targets(replace(run, payload=weak), point)['hydraulic_load']
    assert np.abs(found - (more - less) / 0.2).max() < 0.02 * np.abs(found).max()


def test_neighbours_of_a_point_are_what_simulations_of_them_give(run):
    rig = default_rig()
    system, values = RingSystem(rig), TRUE_TO_SCALE.to_array()
    law = values * (1.0 + 1e-5 * np.eye(6)[0])
    friction = {'radial_friction': {'force': 2000.0, 'presliding': 3e-6}}
    rougher = {'radial_friction': {'force': 2000.1, 'presliding': 3e-6}}
    oval = {**friction, 'out_of_round': {'amplitude': 1e-9}}
    ahead = {**friction, 'probe_gain': {'gain': 1e-5, 'probe': 1}}
    group = [Point(values, friction), Point(law, friction), Point(values, rougher),
             Point(values, oval), Point(values, ahead)]
    found, oval_alone = system.neighbourhood([group, [group[0], group[3]]])(run)
    simulated = system.predict_many(run, group)
    assert np.array_equal(oval_alone, found[[0, 3]])
    assert found[0] == pytest.approx(simulated[0], abs=1e-13)
    for tangent, difference in zip(found[1:] - found[0], simulated[1:] - simulated[0],
                                   strict=True):
        assert tangent == pytest.approx(difference, abs=1e-2 * np.abs(difference).max())


@pytest.mark.slow
def test_a_small_size_of_the_other_sign_is_looked_for(campaign):
    angle = -0.004
    runs = ('static_50', 'dynamic_50', 'static_70')
    found = diagnose(campaign('elevation_error', angle, 'angle', runs)).found.diagnosis
    best = min(found.search.candidates, key=lambda item: (item.step, item.misfit))
    assert best.effects == ('elevation_error',)
    assert best.values['elevation_error']['angle'] == pytest.approx(angle, rel=0.3)


def test_bags_of_different_rigs_get_no_confident_name(campaign, made_once, tmp_path, monkeypatch):
    (tmp_path / 'bags').symlink_to(campaign('radial_friction', 8000.0, 'force')[0].parent)
    monkeypatch.chdir(tmp_path)
    first, second, held_out = (
        read_run(Path('bags') / name) for name in ('static_50', 'dynamic_50', 'static_70'))
    found = shared_diagnose(made_once)([first, second], [held_out], rig=default_rig())
    assert found.verdict == 'named'
    monkeypatch.setattr('saddlering_ros.discrepancy.diagnose', lambda *_, **__: found.diagnosis)
    apart = diagnosis.diagnose_ring([first, replace(second, rig='another rig')], [held_out],
                                    rig=default_rig())
    assert apart.diagnosis.causes
    assert apart.verdict == 'unknown'
    assert 'different rigs' in ' '.join(apart.notes)
    assert 'another rig' in str(apart.next_test)
    assert not apart.extended_parameters().effects


def test_a_newton_more_at_the_ring_moves_it_from_the_zero_that_was_taken(run) -> None:
    """As the file of a law on the load does: its addition is none at the zero of a run."""
    system = RingSystem(default_rig())
    point = Point(TRUE_TO_SCALE.to_array())
    drive, grid = run.inputs['load'], run.payload
    swell = 400.0 * np.sin(np.pi * drive / default_rig().full_scale_load)
    loads = grid.load + 400.0 * np.sin(np.pi * grid.load / default_rig().full_scale_load)
    changed = replace(run, payload=replace(grid, load=loads))
    moved = system.predict_many(changed, [point])[0] - system.predict_many(run, [point])[0]
    expected = system.targets(run, point)['hydraulic_load'] * swell
    assert moved == pytest.approx(expected, abs=0.05 * np.abs(expected).max())


def test_blocks_of_a_hold_follow_each_other_without_a_gap(run):
    within = np.diff(run.hold) == 0.0
    reach = 0.5 * (run.width[1:] + run.width[:-1])
    assert np.count_nonzero(within) > 50
    assert np.diff(run.time)[within] == pytest.approx(reach[within], rel=0.03)


def test_every_declared_start_lies_within_the_bounds_of_a_small_ring():
    rig = default_rig()
    small = replace(rig, full_scale_load=0.4 * rig.full_scale_load,
                    axial_rows=replace(rig.axial_rows, pitch_radius=0.4))
    for effect in catalogue().values():
        for form in engine_effects(effect, small):
            for start in form.starts:
                seen = [form.parameters[name].low <= value <= form.parameters[name].high
                        for name, value in start.items() if name in form.parameters]
                assert seen, 'a start of none of the parameters'
                assert all(seen), start


def test_a_dimension_of_the_rig_file_is_a_cause_like_any_other(run):
    rig = default_rig()
    system, base = RingSystem(rig), TRUE_TO_SCALE.to_array()
    wider = replace(rig, probes=replace(rig.probes, axial_span=rig.probes.axial_span + 0.05))
    plain, stiffer = Point(base), Point(1.0001 * base)
    span = Point(base, {'rig_axial_span': {'change': 0.05}})
    reversed_sign = Point(base, {'rig_polarity': {'reversal': 1.0, 'probe': 4.0}})
    usual = system.predict_many(run, [plain])[0]
    expected = RingSystem(wider).predict_many(run, [plain])[0]
    seen = system.predict_many(run, [plain, span, reversed_sign])
    np.testing.assert_allclose(seen[:2], [usual, expected], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(seen[2], usual * np.array([1.0, 1.0, 1.0, -1.0])[:, None])
    group = [span, Point(1.0001 * base, span.effects), stiffer]
    near = system.neighbourhood([group])(run)[0]
    own = RingSystem(wider).neighbourhood([[plain, stiffer]])(run)[0]
    np.testing.assert_allclose(near[:2], own, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(near[2:], system.predict_many(run, [stiffer]), atol=1e-12)


def test_a_dimension_does_not_move_the_bounds_of_an_effect(run):
    rig = default_rig()
    effect = catalogue()['bolt_opening']
    highest = {item.name: item.high for item in effect.parameters_on(rig)}
    smaller = Point(TRUE_TO_SCALE.to_array(), {
        'bolt_opening': highest, 'rig_axial_radius': {'change': -0.05}})
    assert np.isfinite(RingSystem(rig).predict_many(run, [smaller])).all()


def test_a_wrong_span_in_the_rig_file_is_named_by_its_entry(campaign):
    rig = default_rig()
    narrow = replace(rig, probes=replace(rig.probes, axial_span=1.1))
    bags = [bag for bag in campaign() if bag.name.startswith('static')]
    with few_effects('probe_gain', 'probe_bracket', 'ring_ovalisation', 'load_gain', 'moment_arm',
                     'tilt_compliance', 'film_creep'):
        found = diagnosis.diagnose_ring([read_run(bag) for bag in bags], rig=narrow)
    assert 'rig_axial_span' in {name for cause in found.diagnosis.causes for name in cause.group}
    assert found.verdict != 'unknown'
    assert found.next_test is not None
    assert found.next_test.startswith('First compare the rig file')
    assert 'rig.probes.axial_span' in found.next_test
    assert 'rig_axial_span' not in found.extended_parameters().effects
