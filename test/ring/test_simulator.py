"""Claims about the fast simulator: it agrees with the reference, and live equals offline."""

import numpy as np
from pushed import pushed
import pytest
import readable_ring as reference

from saddlering_ros.effects import catalogue, NO_EXTENSION
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, ParameterSet, TONNE, TRUE_TO_SCALE
from saddlering_ros.rig.parameter_file import ContactParameters, PARAMETER_NAMES
from saddlering_ros.ring.sensitivity import FollowedMotion
from saddlering_ros.ring.simulator import (
    dynamic_batch,
    probe_batch,
    RingSimulator,
    simulate,
    SimulationError,
    static_batch,
)

RIG = default_rig()
STATIC_LOADS = np.concatenate([np.arange(1, 26), np.arange(24, 0, -1)]) * TONNE


def draw_contacts(count: int, seed: int) -> np.ndarray:
    """Contact laws (count, 6) over the whole identification box, K and D uniform in logarithm."""
    random = np.random.default_rng(seed)
    low, high = np.array([RIG.bounds[name] for name in PARAMETER_NAMES]).T
    logarithmic = np.array([name[0] != 'n' for name in PARAMETER_NAMES])
    u = random.random((count, 6))
    return np.where(logarithmic, low * (high / low) ** u, low + (high - low) * u)


def dynamic_record(seconds: float = 2.0, rate: float = 1000.0) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(0.0, seconds, 1.0 / rate)
    load = np.interp(time, [0, 0.2, 0.5 * seconds, seconds - 0.2, seconds],
                     [RIG.preload, RIG.preload, FULL_SCALE_LOAD, RIG.preload, RIG.preload])
    return time, load + np.random.default_rng(3).normal(0.0, 50.0, time.size)


@pytest.mark.parametrize('degrees', [50.0, 70.0])
def test_static_displacements_agree_with_the_304_roller_sum_over_the_box(degrees: float) -> None:
    contacts = draw_contacts(40, seed=1)
    loads = STATIC_LOADS[::6]
    fast = static_batch(RIG, contacts, np.deg2rad(degrees), loads)
    for contact, motion in zip(contacts, fast, strict=True):
        law = ContactParameters.from_array(contact)
        for load, q in zip(loads, motion.T, strict=True):
            plain = reference.static_equilibrium(RIG, law, load, np.deg2rad(degrees), start=q)
            assert q == pytest.approx(plain, abs=1e-10)


def test_dynamic_displacements_agree_with_the_304_roller_sum_over_the_box() -> None:
    time, load = dynamic_record(0.8)
    contacts = draw_contacts(6, seed=2)
    fast = dynamic_batch(RIG, contacts, np.deg2rad(50.0), time, load)
    for contact, motion in zip(contacts, fast, strict=True):
        law = ContactParameters.from_array(contact)
        # The reference divides no step: it is given those that the simulator took.
        path = FollowedMotion(RIG, contact, np.deg2rad(50.0), time, load).path
        plain = reference.simulate_dynamic(RIG, law, np.deg2rad(50.0), path.time, path.load)
        assert pytest.approx(plain, abs=1e-9) == path.motion.T
        at_samples = np.searchsorted(path.time, time - 1e-7)
        assert motion == pytest.approx(path.motion[at_samples].T, abs=1e-13)


def test_a_radial_row_off_the_mid_plane_couples_tilt_and_radial_motion() -> None:
    from dataclasses import replace
    rig = replace(RIG, radial_row=replace(RIG.radial_row, height=0.08))
    time, load = dynamic_record(0.4)
    fast = dynamic_batch(rig, TRUE_TO_SCALE.to_array()[None], np.deg2rad(50.0), time, load)[0]
    plain = reference.simulate_dynamic(rig, TRUE_TO_SCALE, np.deg2rad(50.0), time, load)
    assert fast == pytest.approx(plain, abs=1e-9)


def test_pushing_batches_of_any_size_gives_the_whole_records_numbers_to_the_last_bit() -> None:
    time, load = dynamic_record()
    effects = {name: {p.name: (p.scale if p.amplitude else p.start) for p in effect.parameters}
               for name, effect in catalogue().items() if name in
               ('radial_friction', 'film_creep', 'probe_lag', 'settling', 'clock_offset')}
    for chosen in ({}, effects):
        parameters = ParameterSet(TRUE_TO_SCALE, chosen)
        whole = simulate(RIG, parameters, np.deg2rad(50.0), time, load)
        for sizes in ((1,), (7, 1, 300, 90)):
            live = RingSimulator(RIG, parameters, np.deg2rad(50.0))
            times, probes = pushed(live, time, load, sizes)
            assert np.array_equal(times, whole.time)
            assert np.array_equal(probes, whole.probes)


def test_a_negative_clock_offset_waits_for_the_load_it_needs() -> None:
    time, load = dynamic_record()
    parameters = ParameterSet(TRUE_TO_SCALE, {'clock_offset': {'offset': -0.0125}})
    live = RingSimulator(RIG, parameters, np.deg2rad(50.0))
    times, probes = pushed(live, time, load)
    assert times[-1] == pytest.approx(time[-1] - 0.0125, abs=2e-3)
    plain = simulate(RIG, ParameterSet(TRUE_TO_SCALE), np.deg2rad(50.0), time, load)
    late = np.interp(times + 0.0125, plain.time, plain.probes[0])
    assert probes[0] == pytest.approx(late, abs=1e-12)


def test_reset_forgets_the_past_completely() -> None:
    time, load = dynamic_record(0.8)
    simulator = RingSimulator(RIG, ParameterSet(TRUE_TO_SCALE), np.deg2rad(50.0))
    _, first = pushed(simulator, time, load)
    simulator.reset()
    _, again = pushed(simulator, time, load)
    assert np.array_equal(first, again)


def test_a_batch_gives_each_member_the_numbers_it_gets_alone() -> None:
    """Equal rows and worn ones may be mixed."""
    time, load = dynamic_record(0.6)
    worn = catalogue()['worn_sector_radial']
    extension = worn.extend(NO_EXTENSION, worn.complete({'wear': 0.3}))
    members = [(TRUE_TO_SCALE.to_array(), extension),
               *((law, NO_EXTENSION) for law in draw_contacts(5, seed=4))]
    together = probe_batch(RIG, members, 0.9, time, load)
    for member, increments in zip(members, together, strict=True):
        assert np.array_equal(probe_batch(RIG, [member], 0.9, time, load)[0], increments)


def test_a_long_gap_between_samples_is_stepped_through_not_jumped() -> None:
    time, load = dynamic_record()
    keep = (time < 0.5) | (time > 0.6)
    full = simulate(RIG, ParameterSet(TRUE_TO_SCALE), 0.9, time, load)
    cut = simulate(RIG, ParameterSet(TRUE_TO_SCALE), 0.9, time[keep], load[keep])
    assert cut.failed_steps == 0
    assert cut.displacement.delta_x[-1] == pytest.approx(full.displacement.delta_x[-1], abs=1e-9)


def test_no_step_fails_over_the_box_even_with_coarse_noisy_samples() -> None:
    time, load = dynamic_record(4.0, rate=20.0)
    for contact in draw_contacts(25, seed=5):
        law = ParameterSet(ContactParameters.from_array(contact))
        assert simulate(RIG, law, 0.9, time, load, max_step=0.1).failed_steps == 0


@pytest.mark.parametrize(('time', 'load', 'words'), [
    ([0.0, 1.0], [1.0, np.nan], 'not finite'),
    ([0.0, 1.0, 0.5], [1.0, 1.0, 1.0], 'does not rise at sample 2'),
    ([], [], 'do not fit')])
def test_a_record_that_cannot_be_simulated_is_refused_in_one_line(time, load, words) -> None:
    with pytest.raises(SimulationError, match=words):
        simulate(RIG, ParameterSet(TRUE_TO_SCALE), 0.9, time, load)


@pytest.mark.parametrize(('elevation', 'load', 'words'), [
    (np.nan, 5.0 * TONNE, 'elevation is nan'),
    (0.9, np.nan, 'load 1 is nan'),
    (0.9, np.inf, 'load 1 is inf')])
def test_equilibrium_is_refused_at_an_elevation_or_load_that_is_no_number(elevation, load, words):
    with pytest.raises(SimulationError, match=words):
        static_batch(RIG, TRUE_TO_SCALE.to_array()[None], elevation, [RIG.preload, load])


def test_where_there_is_no_equilibrium_stands_no_number() -> None:
    broken = TRUE_TO_SCALE.to_array()
    broken[0] = np.nan
    both = static_batch(RIG, np.stack([broken, TRUE_TO_SCALE.to_array()]), 0.9, STATIC_LOADS[:3])
    assert np.all(np.isnan(both[0]))
    assert np.all(np.isfinite(both[1]))


def test_an_equilibrium_is_found_everywhere_in_the_box() -> None:
    assert np.all(np.isfinite(static_batch(RIG, draw_contacts(400, seed=7), 0.9, STATIC_LOADS)))


@pytest.mark.parametrize('wrong', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(('argument', 'words'), [
    ('elevation', 'elevation is'), ('time', 'not finite'), ('load', 'not finite'),
    ('zero_load', 'zero load is'), ('max_step', 'longest step is')])
def test_a_batch_is_refused_where_an_argument_is_no_finite_number(argument, words, wrong) -> None:
    time, load = dynamic_record(0.1)
    arguments = {'elevation': 0.9, 'time': time, 'load': load}
    held = arguments.get(argument)
    arguments[argument] = wrong if np.ndim(held) == 0 else np.append(held[:-1], wrong)
    with pytest.raises(SimulationError, match=words):
        probe_batch(RIG, [(TRUE_TO_SCALE.to_array(), NO_EXTENSION)], **arguments)
    if argument != 'zero_load':
        with pytest.raises(SimulationError, match=words):
            dynamic_batch(RIG, TRUE_TO_SCALE.to_array()[None], **arguments)


@pytest.mark.parametrize('step', [0.0, -1e-3])
def test_a_step_that_does_not_move_time_on_is_refused(step: float) -> None:
    with pytest.raises(SimulationError, match='longest step is'):
        RingSimulator(RIG, ParameterSet(TRUE_TO_SCALE), 0.9, max_step=step)


@pytest.mark.parametrize('wrong', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('name', PARAMETER_NAMES)
def test_a_law_that_is_no_finite_number_gets_none_and_leaves_its_neighbours_alone(name, wrong):
    time, load = dynamic_record(0.1)
    broken = TRUE_TO_SCALE.to_array()
    broken[PARAMETER_NAMES.index(name)] = wrong
    laws = np.stack([TRUE_TO_SCALE.to_array(), broken, TRUE_TO_SCALE.to_array()])
    motion = dynamic_batch(RIG, laws, 0.9, time, load)
    seen = probe_batch(RIG, [(law, NO_EXTENSION) for law in laws], 0.9, time, load)
    for rows in (motion, seen):
        assert np.all(np.isnan(rows[1]))
        assert np.array_equal(rows[0], rows[2])
        assert np.all(np.isfinite(rows[0]))


def test_the_number_of_threads_changes_no_bit(monkeypatch) -> None:
    laws = TRUE_TO_SCALE.to_array() * np.linspace(0.9, 1.1, 7)[:, None]
    time = np.linspace(0.0, 0.5, 51)
    load = 4903.325 + 5e4 * (1.0 - np.cos(2.0 * np.pi * time / 0.5))
    motions = []
    for threads in '13':
        monkeypatch.setenv('SADDLERING_THREADS', threads)
        motions.append(dynamic_batch(RIG, laws, 0.9, time, load))
    np.testing.assert_array_equal(*motions)
