"""Claims about exact sensitivities: those of the readable reference, and of every effect."""

import numpy as np
import pytest
import readable_ring as reference

from saddlering_ros import rig
from saddlering_ros.effects import catalogue, extension_of, NO_EXTENSION, RingEffect
from saddlering_ros.effects.base import Variant
from saddlering_ros.effects.extension import RingExtension
from saddlering_ros.rig import ContactParameters, default_rig, FULL_SCALE_LOAD, TRUE_TO_SCALE
from saddlering_ros.ring.kernels import integration
from saddlering_ros.ring.sensitivity import FollowedMotion, Neighbourhoods, static_sensitivities
from saddlering_ros.ring.simulator import probe_batch, static_batch

RIG, ELEVATION = default_rig(), 0.9
LAW = TRUE_TO_SCALE.to_array()
STEP = 2e-3
TIME = STEP * np.arange(60)
LOAD = np.interp(TIME, [0.0, 0.06, 0.118], [RIG.preload, FULL_SCALE_LOAD, 0.3 * FULL_SCALE_LOAD])


def swell(time: np.ndarray, share: float) -> np.ndarray:
    """A load so slow that no step is divided: differences over divided steps are not smooth."""
    turns = time / time[-1]
    return RIG.preload + 0.5 * share * FULL_SCALE_LOAD * (1.0 - np.cos(2.0 * np.pi * turns))


SLOW = STEP * np.arange(150)
SLOW_LOAD = swell(SLOW, 0.1)
EACH = pytest.mark.parametrize('index', range(6), ids=rig.PARAMETER_NAMES)


def aside(index: int, share: float) -> list[ContactParameters]:
    """The law with one parameter a share more, and a share less."""
    return [ContactParameters.from_array(np.where(np.arange(6) == index, LAW * (1.0 + by), LAW))
            for by in (share, -share)]


@EACH
def test_a_motion_changes_with_the_contact_law_as_the_reference_does(index: int) -> None:
    load = swell(TIME, 0.05)
    slopes = FollowedMotion(RIG, LAW, ELEVATION, TIME, load, STEP).sensitivities()
    more, less = (reference.simulate_dynamic(RIG, law, ELEVATION, TIME, load)
                  for law in aside(index, 3e-5))
    expected = (more - less) / (6e-5 * LAW[index])
    assert slopes[index] == pytest.approx(expected, rel=1e-4, abs=2e-5 * np.abs(expected).max())


@pytest.mark.parametrize('index', [0, 1, 3, 4], ids=['K1', 'n1', 'K2', 'n2'])
def test_equilibria_change_with_the_contact_law_as_the_reference_does(index: int) -> None:
    loads = np.linspace(RIG.preload, FULL_SCALE_LOAD, 5)
    still = static_batch(RIG, LAW[None], ELEVATION, loads)[0]
    slopes = static_sensitivities(RIG, LAW, ELEVATION, still)
    more, less = (np.stack([reference.static_equilibrium(RIG, law, load, ELEVATION)
                            for load in loads], axis=1) for law in aside(index, 3e-5))
    expected = (more - less) / (6e-5 * LAW[index])
    assert slopes[index] == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())


def test_damping_changes_no_equilibrium() -> None:
    still = static_batch(RIG, LAW[None], ELEVATION, [RIG.preload, FULL_SCALE_LOAD])[0]
    assert not static_sensitivities(RIG, LAW, ELEVATION, still)[[2, 5]].any()


def shown_variants(one: RingEffect) -> list[Variant]:
    """All variants of a friction, which act in different coordinates; else first and last."""
    if 'friction' in one.id:
        return list(one.variants)
    return list({item.label: item for item in (one.variants[0], one.variants[-1])}.values())


def assert_tangents_are_differences(
        centre: tuple[np.ndarray, RingExtension], pair: list[tuple[np.ndarray, RingExtension]],
        where: str) -> None:
    more, less = probe_batch(RIG, pair, ELEVATION, SLOW, SLOW_LOAD, max_step=STEP)
    found = Neighbourhoods(RIG, [(centre, pair)]).along(
        ELEVATION, SLOW, SLOW_LOAD, max_step=STEP)[0].neighbours
    largest = np.abs(more - less).max()
    assert found[0] - found[1] == pytest.approx(more - less, abs=5e-3 * largest + 1e-14), where


def test_radial_friction_takes_its_load_at_rest_and_pushes_no_ring_through_its_clearance() -> None:
    resting = RIG.preload * np.cos(ELEVATION)
    sizes = {'force': 1.5 * resting, 'presliding': 2e-6, 'sharpness': 0.3, 'initial': 0.9}

    def candidate(name: str, step: float) -> tuple[np.ndarray, RingExtension]:
        return LAW, extension_of({'radial_friction': {**sizes, name: sizes[name] + step}})

    far, near = probe_batch(RIG, [candidate('initial', 0.0), candidate('initial', -0.3)],
                            ELEVATION, SLOW, SLOW_LOAD, max_step=STEP)[:, 0]
    assert np.abs(far - near).max() < 0.1 * RIG.radial_row.clearance
    for name, step in (('force', 0.5), ('presliding', 1e-10), ('initial', 1e-4)):
        assert_tangents_are_differences(
            candidate(name, 0.0), [candidate(name, by) for by in (step, -step)], name)


@pytest.mark.parametrize('one', catalogue().values(), ids=list(catalogue()))
def test_readings_change_with_every_parameter_of_an_effect_as_differences_say(one) -> None:
    for variant in shown_variants(one):
        usual = {item.name: min(item.scale, 0.9 * item.high) for item in one.parameters}
        values = one.complete({**usual, **variant.values})
        centre = extension_of({one.id: values})
        for item in one.parameters:
            step = 2e-6 * (item.high - item.low)
            assert_tangents_are_differences((LAW, centre), [
                (LAW, extension_of({one.id: {**values, item.name: values[item.name] + by}}))
                for by in (step, -step)], f'{variant} {item.name}')


def test_the_response_itself_is_that_of_a_simulation_in_the_same_steps() -> None:
    extension = extension_of({'film_creep': {'share': 0.1}, 'radial_friction': {'force': 500.0}})
    load = np.append(2.0 * LOAD[0], LOAD[1:])
    arguments = ELEVATION, TIME, load, RIG.preload, 0.3 * STEP
    plain = probe_batch(RIG, [(LAW, extension)], *arguments)[0]
    found = Neighbourhoods(RIG, [((LAW, extension), [(LAW, extension)])]).along(*arguments)[0]
    assert found.centre == pytest.approx(plain, abs=1e-13)
    assert found.neighbours[0] == pytest.approx(plain, abs=1e-13)


def test_a_run_with_divided_steps_is_simulated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    once, calls = integration.run_recorded, []
    monkeypatch.setattr(integration, 'run_recorded', lambda *run: calls.append(1) or once(*run))
    path = FollowedMotion(RIG, LAW, ELEVATION, TIME, LOAD, 1.01 * STEP).path
    assert path.time.size > 1.2 * TIME.size
    assert len(calls) == 1


def test_an_effect_that_is_not_there_yet_has_a_slope() -> None:
    """As the first step away from a sound ring needs it."""
    for effects in ({'radial_friction': {'force': 1.0}}, {'load_offset': {'offset': 1.0}},
                    {'cylinder_friction': {'force': 1.0}}, {'worn_sector_axial': {'wear': 1e-4}}):
        there = LAW, extension_of(effects)
        plain = LAW, NO_EXTENSION
        without, with_it = probe_batch(RIG, [plain, there], ELEVATION, SLOW, SLOW_LOAD,
                                       max_step=STEP)
        found = Neighbourhoods(RIG, [(plain, [there])]).along(
            ELEVATION, SLOW, SLOW_LOAD, max_step=STEP)[0]
        expected = with_it - without
        assert found.neighbours[0] - found.centre == pytest.approx(
            expected, abs=2e-2 * np.abs(expected).max()), effects


def test_block_means_are_means_of_the_readings_at_the_samples() -> None:
    """Of plain readings, and of those of an effect with a clock of its own."""
    starts = np.array([0, 10, 11, 90])
    stops = np.array([10, 11, 60, 150])
    plain = LAW, extension_of({})
    stiffer = LAW * (1.0 + 1e-5 * np.eye(6)[0]), plain[1]
    late = LAW, extension_of({'clock_offset': {'offset': 1e-5}})
    groups = Neighbourhoods(RIG, [(plain, [plain, stiffer, late])])
    whole = groups.along(ELEVATION, SLOW, SLOW_LOAD, max_step=STEP)[0]
    means = groups.along(ELEVATION, SLOW, SLOW_LOAD, max_step=STEP, blocks=(starts, stops))[0]
    for few, every in ((means.centre, whole.centre), (means.neighbours, whole.neighbours)):
        expected = np.stack([every[..., start:stop].mean(axis=-1)
                             for start, stop in zip(starts, stops, strict=True)], axis=-1)
        assert few == pytest.approx(expected, rel=1e-9, abs=1e-18)
