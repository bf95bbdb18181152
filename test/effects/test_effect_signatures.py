"""Claims about what each effect does to a simulated record: where it shows, and in what shape."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

from made_once import MadeOnce
import numpy as np
from numpy.typing import NDArray
import pytest
from scipy.signal import lsim

from saddlering_ros.diagnosis.next_test import with_swapped_probes
from saddlering_ros.discrepancy.problem.system import Point
from saddlering_ros.effects import catalogue, extension_of, NO_EXTENSION, RingEffect, Variant
from saddlering_ros.effects.base import worn_arc
from saddlering_ros.rig import (
    CHANNELS,
    default_rig,
    FULL_SCALE_LOAD,
    PARAMETER_NAMES,
    ParameterSet,
    probes_to_displacement,
    Rig,
    TONNE,
    TRUE_TO_SCALE,
)
from saddlering_ros.ring.simulator import probe_batch, simulate, static_batch

Floats = NDArray[np.float64]

RIG = default_rig()
CONTACT = TRUE_TO_SCALE.to_array()
DEGREE = np.pi / 180.0
PUSHED, PULLED = 50.0 * DEGREE, 230.0 * DEGREE
RATE = 100.0

STEPS = np.concatenate([np.arange(0.5, 25.1, 3.5), np.arange(21.5, 0.0, -3.5)]) * TONNE


def stairs(levels: Floats, hold: float = 0.5, rise: float = 0.1) -> tuple[Floats, Floats]:
    """A record (time, load) that holds each level and rises to the next."""
    corners, loads = [0.0, hold], [levels[0], levels[0]]
    for level in levels[1:]:
        corners += [corners[-1] + rise, corners[-1] + rise + hold]
        loads += [level, level]
    time = np.arange(0.0, corners[-1], 1.0 / RATE)
    return time, np.interp(time, corners, loads)


def ramp(rise: float = 0.6) -> tuple[Floats, Floats]:
    """A record (time, load) from preload to full scale and back within `rise` seconds each."""
    corners = np.cumsum([0.0, 0.5, rise, 0.5, rise, 0.8])
    loads = np.array([RIG.preload, RIG.preload, FULL_SCALE_LOAD, FULL_SCALE_LOAD, RIG.preload,
                      RIG.preload])
    time = np.arange(0.0, corners[-1], 1.0 / RATE)
    return time, np.interp(time, corners, loads)


def channels(probes: Floats) -> Floats:
    """Channels (4, N) in the order of CHANNELS from probe increments (4, N)."""
    displacement = probes_to_displacement(RIG.probes, probes)
    return np.array([getattr(displacement, name) for name in CHANNELS])


def simulated(effects: Mapping[str, Mapping[str, float]], record: tuple[Floats, Floats],
              elevation: float = PUSHED, contact: Floats = CONTACT,
              rig: Rig = RIG) -> dict[str, Floats]:
    """Channels by name of one record under effects."""
    candidates = [(contact, extension_of(effects))]
    probes = probe_batch(rig, candidates, elevation, *record, max_step=5e-3)[0]
    return dict(zip(CHANNELS, channels(probes), strict=True))


def guesses(one: RingEffect, variant: Variant) -> list[dict[str, float]]:
    """The effect at its typical size, from each of its first guesses."""
    typical = {p.name: p.scale for p in one.parameters if p.amplitude}
    return [{**one.complete(variant.values), **typical, **start} for start in one.starts or ({},)]


CASES = [(one, variant) for one in catalogue().values() for variant in one.variants]
NAMES = [f'{one.id}-{variant.label}' for one, variant in CASES]


@pytest.fixture(scope='module')
def all_changes(made_once: MadeOnce) -> Floats:
    """What `measured_changes` gives, computed once for all workers."""
    folder = made_once.folder('signatures', lambda folder: np.save(folder / 'changes.npy',
                                                                   measured_changes()))
    return np.asarray(np.load(folder / 'changes.npy'))


def measured_changes() -> Floats:
    """Largest change (3, cases, 4) by each case: neutral, typical and at the ends of its bounds.

    In shares of the channel's range (parity: of delta_x), over a static and a dynamic record of
    the ring pushed, and a static one of the ring pulled (other rollers, other ends of the probes).
    """
    extensions, places = [NO_EXTENSION], []
    for number, (one, variant) in enumerate(CASES):
        neutral = one.complete({
            **variant.values, **{p.name: p.neutral for p in one.parameters if p.amplitude}})
        ends = [
            {**neutral, **{p.name: getattr(p, end) for p in one.parameters if p.amplitude}}
            for end in ('low', 'high')]
        for kind, group in enumerate(([neutral], guesses(one, variant), ends)):
            for values in group:
                extensions.append(one.extend(NO_EXTENSION, one.complete(values)))
                places.append((kind, number))
    changes = np.zeros((3, len(CASES), len(CHANNELS)))
    static = stairs(STEPS, hold=0.1, rise=0.2)
    for elevation, record in ((PUSHED, static), (PUSHED, ramp()), (PULLED, static)):
        probes = probe_batch(RIG, [(CONTACT, extension) for extension in extensions],
                             elevation, *record)
        plain = channels(probes[0])
        extent = np.ptp(plain, axis=1)
        extent[CHANNELS.index('parity')] = extent[CHANNELS.index('delta_x')]
        for (kind, number), changed in zip(places, probes[1:], strict=True):
            size = np.abs(channels(changed) - plain).max(axis=1) / extent
            changes[kind, number] = np.maximum(changes[kind, number], size)
    return changes


@pytest.mark.parametrize('case', range(len(CASES)), ids=NAMES)
def test_a_neutral_effect_changes_nothing(all_changes: Floats, case: int) -> None:
    assert np.all(all_changes[0, case] == 0.0)


@pytest.mark.parametrize('case', range(len(CASES)), ids=NAMES)
def test_an_effect_shows_in_the_channels_it_states_and_in_no_other(all_changes, case) -> None:
    one, variant = CASES[case]
    for name, change in zip(CHANNELS, all_changes[1, case], strict=True):
        if name in (variant.channels or one.channels):
            assert change > 1e-4, f'{name} does not show it'
        else:
            assert change < 1e-6, f'{name} shows it'


@pytest.mark.parametrize('case', range(len(CASES)), ids=NAMES)
def test_the_simulation_stays_sane_up_to_the_bounds(all_changes: Floats, case: int) -> None:
    assert np.all(np.isfinite(all_changes[2, case]))
    assert np.all(all_changes[2, case] < 10.0)


def branches(channel: Floats, load: Floats) -> tuple[Floats, Floats]:
    """A channel at common loads going up and coming down, (25,) each."""
    top = int(np.argmax(load))
    wanted = np.linspace(0.1, 0.9, 25) * FULL_SCALE_LOAD
    return (np.interp(wanted, load[:top + 1], channel[:top + 1]),
            np.interp(wanted, load[:top - 1:-1], channel[:top - 1:-1]))


def loop(channel: Floats, load: Floats) -> float:
    """Mean height of the loop, down minus up, as a share of the channel's range."""
    up, down = branches(channel, load)
    return float(np.mean(down - up) / np.ptp(channel))


def slow_cycle(seconds: float = 20.0) -> tuple[Floats, Floats]:
    time = np.arange(0.0, seconds, seconds / 600.0)
    return time, np.interp(time, [0.0, 0.5 * seconds, seconds],
                           [RIG.preload, FULL_SCALE_LOAD, RIG.preload])


def added(effects: Mapping[str, Mapping[str, float]], record: tuple[Floats, Floats],
          channel: str, elevation: float = PUSHED) -> Floats:
    """What effects add to a channel along a record."""
    return (simulated(effects, record, elevation)[channel]
            - simulated({}, record, elevation)[channel])


def loop_heights(effects: Mapping[str, Mapping[str, float]], *seconds: float) -> list[float]:
    """How much effects raise the loop of delta_x in cycles of these lengths [s]."""
    heights = []
    for length in seconds:
        record = slow_cycle(length)
        with_it, without = (simulated(f, record)['delta_x'] for f in (effects, {}))
        heights.append(loop(with_it, record[1]) - loop(without, record[1]))
    return heights


def test_radial_friction_opens_the_same_loop_at_any_slow_rate() -> None:
    fast, slow = loop_heights({'radial_friction': {'force': 8e3}}, 40.0, 160.0)
    assert fast > 0.01
    assert slow == pytest.approx(fast, rel=0.02)


def test_film_creep_opens_a_loop_that_depends_on_the_rate() -> None:
    fast, slow = loop_heights({'film_creep': {'share': 0.1, 'time': 5.0}}, 20.0, 400.0)
    assert fast > 3.0 * abs(slow)


def test_cylinder_friction_is_a_lower_load_going_up_and_a_higher_one_coming_down() -> None:
    record = slow_cycle()
    friction = {'cylinder_friction': {'force': 3e3, 'presliding': 500.0}}
    for name in ('delta_x', 'gamma'):
        up, down = branches(added(friction, record, name), record[1])
        assert np.all(up < 0.0)
        assert np.all(down > 0.0)


def test_settling_is_gone_in_a_second_cycle() -> None:
    one_cycle = np.array([RIG.preload, FULL_SCALE_LOAD, RIG.preload])
    record = stairs(np.concatenate([one_cycle, one_cycle[1:]]))
    values = {'settling': {'coordinate': 2.0, 'settling': 4e-11}}
    change = added(values, record, 'gamma')
    after_first = record[0] > 1.2
    assert change[-1] == pytest.approx(4e-11 * (FULL_SCALE_LOAD - RIG.preload), rel=1e-6)
    assert np.ptp(change[after_first]) < 1e-6 * change[-1]


def opening(spread: dict[str, float], elevation: float = PUSHED) -> tuple[Floats, Floats]:
    """Moments (N,) [N m] and what a joint opening at 8e4 N m adds to tilt (N,) [rad]."""
    record = slow_cycle()
    values = {'bolt_opening': {'compliance': 2e-10, 'moment': 8e4, **spread}}
    arm = RIG.trunnion.y * np.cos(elevation) + RIG.trunnion.x * np.sin(elevation)
    return record[1] * arm, added(values, record, 'gamma', elevation)


@pytest.mark.parametrize('elevation', [50.0 * DEGREE, 70.0 * DEGREE])
def test_a_bolted_joint_opens_at_one_moment_whatever_the_elevation(elevation: float) -> None:
    moment, change = opening({}, elevation)
    assert np.all(np.abs(change[moment < 8e4]) < 1e-12)
    expected = 2e-10 * (moment - 8e4)[moment > 8e4]
    assert change[moment > 8e4] == pytest.approx(expected, rel=1e-3, abs=1e-9)


def test_the_moment_of_the_dead_weight_helps_to_open_a_joint() -> None:
    record = slow_cycle()
    rig = replace(RIG, carriage=replace(RIG.carriage, weight_x=0.5))
    moment, _ = opening({})
    total = moment + rig.carriage.weight * 0.5
    effects = {'bolt_opening': {'compliance': 2e-10, 'moment': 8e4}}
    change = (simulated(effects, record, rig=rig)['gamma']
              - simulated({}, record, rig=rig)['gamma'])
    assert change == pytest.approx(2e-10 * np.maximum(0.0, total - 8e4), abs=1e-10)


def test_bolts_that_open_one_after_another_bend_the_tilt_as_their_mean_does() -> None:
    moment, change = opening({'spread': 3e4})
    each = 8e4 + 3e4 * (2.0 * (np.arange(2000) + 0.5) / 2000 - 1.0)
    expected = 2e-10 * np.maximum(0.0, moment[:, None] - each).mean(axis=1)
    assert moment.max() > 1.2e5
    assert change == pytest.approx(expected - expected[0], abs=1e-11)
    assert np.all(change[moment < 5e4] == pytest.approx(0.0, abs=1e-15))


def test_a_joint_without_a_spread_opens_sharply_and_is_where_a_small_spread_leads() -> None:
    moment, sharp = opening({})
    assert sharp == pytest.approx(2e-10 * np.maximum(0.0, moment - 8e4), abs=1e-11)
    assert np.array_equal(opening({'spread': 0.0})[1], sharp)
    assert opening({'spread': 1.0})[1] == pytest.approx(sharp, abs=2e-10 * 0.25)


def test_a_joint_that_opens_at_its_lowest_moment_can_be_a_compliance_of_the_tilt() -> None:
    """It was named for one that was not listed, with the moment at this bound."""
    _, lowest, spread = catalogue()['bolt_opening'].parameters
    moment, change = opening({'moment': lowest.low, 'spread': spread.high})
    line = np.polyval(np.polyfit(moment, change, 1), moment)
    assert np.var(change - line) < 0.01 * np.var(change)
    assert lowest.limiting_case == (lowest.low,)


@pytest.mark.parametrize(('effect_id', 'channel', 'drive'), [
    ('radial_compliance', 'delta_x', np.cos(PUSHED)),
    ('axial_compliance', 'delta_y', -np.sin(PUSHED)),
    ('tilt_compliance', 'gamma',
     RIG.trunnion.y * np.cos(PUSHED) + RIG.trunnion.x * np.sin(PUSHED)),
    ('ring_ovalisation', 'parity', np.cos(PUSHED))])
def test_a_series_spring_adds_a_straight_line_without_a_loop(effect_id, channel, drive) -> None:
    time, load = ramp()
    change = added({effect_id: {'compliance': 5e-11}}, (time, load), channel)
    assert change == pytest.approx(5e-11 * drive * (load - load[0]), rel=1e-3, abs=1e-10)


def test_a_load_gain_is_a_scaling_of_stiffness_and_damping() -> None:
    record = ramp()
    scaled = CONTACT * [1.03 if name[0] in 'KD' else 1.0 for name in PARAMETER_NAMES]
    by_gain = simulated({'load_gain': {'gain': 0.03}}, record)['delta_x']
    by_contact = simulated({}, record, contact=scaled)['delta_x']
    assert np.abs(by_gain - by_contact).max() < 1e-4 * np.ptp(by_gain)


def test_one_degree_of_elevation_takes_two_percent_from_the_radial_force() -> None:
    """2.1 % of the force at 50 degrees, which to the power 0.9 is 1.9 % of the displacement."""
    record = slow_cycle()
    changed = simulated({'elevation_error': {'angle': DEGREE}}, record)['delta_x']
    turned = simulated({}, record, PUSHED + DEGREE)['delta_x']
    assert changed == pytest.approx(turned, abs=1e-15)
    plain = simulated({}, record)['delta_x']
    assert np.ptp(changed) / np.ptp(plain) - 1.0 == pytest.approx(-0.019, abs=0.002)


@pytest.mark.parametrize('skew', [0.0, 1e-3])
def test_another_clock_shifts_all_probes_alike_in_fits_and_in_nodes(skew: float) -> None:
    time, load = ramp()
    clocks = {'clock_offset': {'offset': 0.02, 'skew': skew}}
    late, plain = simulated(clocks, (time, load)), simulated({}, (time, load))
    of_node = channels(simulate(RIG, ParameterSet(TRUE_TO_SCALE, clocks), PUSHED, time, load,
                                5e-3).probes)
    for name, by_node in zip(('delta_x', 'delta_y', 'gamma'), of_node, strict=False):
        shifted = np.interp(time - 0.02 - skew * time, time, plain[name])
        assert late[name] == pytest.approx(shifted, abs=1e-12)
        assert by_node == pytest.approx(shifted, abs=1e-12)


def test_a_lagging_probe_follows_a_ramp_one_time_constant_late() -> None:
    record = slow_cycle(4.0)
    late = simulated({'probe_lag': {'time': 0.05}}, record)['delta_x']
    plain = simulated({}, record)['delta_x']
    before_top = (record[0] > 1.0) & (record[0] < 1.9)
    expected = np.interp(record[0] - 0.05, record[0], plain)
    assert late[before_top] == pytest.approx(expected[before_top], abs=2e-8)


def test_two_stages_of_a_lag_answer_a_step_as_their_formula_says() -> None:
    time = np.arange(0.0, 2.0, 1e-3)
    load = np.where(time < 0.5, RIG.preload, 1e5)
    lag = {'time': 0.2, 'second': 0.5, 'probe': 1.0}
    late, plain = simulated({'probe_lag': lag}, (time, load)), simulated({}, (time, load))
    seen, true = (item['delta_x'] + item['parity'] for item in (late, plain))
    _, expected, _ = lsim(([1.0], [0.01, 0.2, 1.0]), true, time)
    assert seen == pytest.approx(expected, abs=2e-3 * true[-1])
    once = simulated({'probe_lag': lag | {'second': 0.0}}, (time, load))
    assert np.abs(seen - once['delta_x'] - once['parity']).max() > 0.05 * true[-1]


def test_drift_goes_on_at_rest() -> None:
    time = np.arange(0.0, 10.0, 0.1)
    values = {'probe_drift': {'probe': 1.0, 'rate': 1e-8}}
    rest = simulated(values, (time, np.full(time.size, RIG.preload)))
    assert rest['delta_x'] == pytest.approx(0.5e-8 * time, abs=1e-13)


def test_opposite_probes_that_drift_with_opposite_signs_look_like_motion() -> None:
    time = np.arange(0.0, 10.0, 0.1)
    values = {'probe_drift': {'probe': 13.0, 'rate': 1e-8, 'sum': 4e-9}}
    rest = simulated(values, (time, np.full(time.size, RIG.preload)))
    assert rest['delta_x'] == pytest.approx(0.8e-8 * time, abs=1e-13)
    assert np.abs(rest['parity']) == pytest.approx(0.2e-8 * time, abs=1e-13)
    swapped = with_swapped_probes(Point(np.zeros(6), values)).effects
    moved = simulated(swapped, (time, np.full(time.size, RIG.preload)))
    assert moved['delta_x'] == pytest.approx(-rest['delta_x'], abs=1e-13)
    assert moved['parity'] == pytest.approx(rest['parity'], abs=1e-13)


def test_a_saturated_probe_stands_still_and_is_right_below_its_limit() -> None:
    values = {'probe_saturation': {'probe': 1.0, 'side': 1.0, 'limit': 6e-5}}
    changed, plain = simulated(values, slow_cycle()), simulated({}, slow_cycle())
    first = changed['delta_x'] + changed['parity']
    assert first == pytest.approx(np.minimum(plain['delta_x'], 6e-5), abs=1e-15)


def test_ringing_after_a_corner_has_the_period_of_the_resonance() -> None:
    time, load = ramp(rise=0.2)
    values = {'carriage_resonance': {'period': 0.08, 'damping': 0.02}}
    change = added(values, (time, load), 'delta_x')
    held = (time > 0.75) & (time < 1.15)
    ringing = change[held] - np.polyval(np.polyfit(time[held], change[held], 1), time[held])
    ups = [a for a, b in pairwise(range(ringing.size)) if ringing[a] < 0.0 <= ringing[b]]
    assert np.diff(ups).mean() / RATE == pytest.approx(0.08, rel=0.05)


def test_a_mode_of_a_part_of_the_motion_rings_by_that_part() -> None:
    record = ramp(rise=0.2)
    mode = {'period': 0.08, 'damping': 0.02}
    whole, part = (added({'carriage_resonance': mode | {'share': share}}, record, 'gamma')
                   for share in (1.0, 0.3))
    assert part == pytest.approx(0.3 * whole, abs=1e-12)
    assert np.abs(whole).max() > 1e-6


def test_growing_damping_is_gone_once_the_load_has_been_held() -> None:
    levels = np.array([RIG.preload, 0.5 * FULL_SCALE_LOAD, FULL_SCALE_LOAD])
    ramped, held = (np.abs(added({'damping_law': {'share': 1.0}}, record, 'delta_x'))
                    for record in (ramp(), stairs(levels, hold=2.0)))
    assert held[-1] < 1e-4 * ramped.max()


def test_a_worn_arc_matters_only_in_the_load_zone() -> None:
    record = slow_cycle()
    plain = np.ptp(simulated({}, record)['delta_x'])
    rear, front = (
        np.ptp(simulated({'worn_sector_radial': {'wear': 0.3, 'centre': centre, 'edge': 0.1}},
                         record)['delta_x'])
        for centre in (0.0, np.pi))
    assert rear > 1.02 * plain
    assert front == pytest.approx(plain, rel=1e-6)


def test_a_worn_arc_can_end_as_softly_as_a_cosine() -> None:
    angle = np.linspace(-np.pi, np.pi, 721)
    off = np.minimum(np.abs(angle) / 0.5, 2.0)
    cosine = 0.5 + 0.5 * np.cos(0.5 * np.pi * off)
    values = {'wear': 0.3, 'centre': 0.0, 'half_width': 0.5, 'edge': 0.275, 'kind': 0.0}
    assert np.abs(worn_arc(values).profile(angle) - cosine).max() < 0.05


def test_a_gain_of_one_radial_probe_shows_half_in_the_parity() -> None:
    record = slow_cycle()
    plain = simulated({}, record)
    one = simulated({'probe_gain': {'probe': 1.0, 'gain': 0.02}}, record)
    assert one['parity'] == pytest.approx(0.01 * plain['delta_x'], abs=1e-15)


def test_axial_friction_carries_a_part_of_the_weight_while_the_ring_goes_down() -> None:
    """Sliding friction is a constant force, as that of a ring that is lighter by it."""
    force = 6e3
    seal = {'tilt_friction': {'coordinate': 1.0, 'moment': force, 'presliding': 1e-6,
                              'sharpness': 1.0}}
    extension = extension_of(seal)
    time = np.arange(0.0, 60.0, 0.05)
    load = np.interp(time, [0.0, 30.0, 60.0], [RIG.preload, FULL_SCALE_LOAD, FULL_SCALE_LOAD])
    moved = channels(probe_batch(RIG, [(CONTACT, extension)], PUSHED, time, load)[0])[1:3, -1]
    lighter = replace(RIG, carriage=replace(RIG.carriage, weight=RIG.carriage.weight - force))
    at_full = static_batch(lighter, CONTACT[None], PUSHED, [FULL_SCALE_LOAD])[0][1:, 0]
    at_zero = static_batch(RIG, CONTACT[None], PUSHED, [RIG.preload])[0][1:, 0]
    assert moved == pytest.approx(at_full - at_zero, abs=2e-9)
