"""Claims about damping that grows with penetration: law, tangent, lag, solver, levelling off."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.effects import extension_of
from saddlering_ros.rig import (
    ContactParameters,
    default_rig,
    FULL_SCALE_LOAD,
    PARAMETER_NAMES,
    ParameterSet,
    probes_to_displacement,
    Rig,
    TRUE_TO_SCALE,
)
from saddlering_ros.ring.kernels import contact
from saddlering_ros.ring.model import FAR_OFF
from saddlering_ros.ring.simulator import probe_batch, simulate, static_batch

RIG = default_rig()
ELEVATION = float(np.radians(50.0))
K, N, D = 9e7, 1.12, 3e6
EXPONENTS = pytest.mark.parametrize('exponent', [0.2, 0.25, 0.5, 0.95, 1.0, 1.12, 1.5, 2.0, 8.0])
LEVELLINGS = pytest.mark.parametrize('levelling', [None, 1e3, 5e4, 2e5])
DEPTHS = np.geomspace(1e-10, 2e-4, 121)
SOLVER = 5e-10
"""What dividing a step where the load jumps moves a probe [m]: one row's jump divides the step of
all, and files of before were simulated without it. Another law moves it by 1e-7."""


def one_roller(p: float, rate: float, share: float, exponent: float,
               levelling: float | None = None) -> tuple[float, float, float]:
    """Force [N], stiffness dF/dp and damping dF/d(dp/dt) of a single roller."""
    places = 16
    rows = np.zeros((3, 3, places))
    rows[:, 2] = FAR_OFF
    rows[0, :, 0] = 0.0, 1.0, 0.0
    sums = contact.row_sums(rows.reshape(-1), 0, np.uint64(places), False,
                            (p, 0.0, rate, 0.0), (K, N, D), (share, exponent), levelling, 0.0)
    return sums[0], sums[2], sums[5]


def candidates(effects: dict[str, dict[str, float]], law: ContactParameters = TRUE_TO_SCALE,
               ) -> list[tuple[np.ndarray, object]]:
    return [(law.to_array(), extension_of(effects))]


def displacement(rig: Rig, probes: np.ndarray) -> np.ndarray:
    """delta_x (N,) [m] of probe increments (4, N)."""
    return np.asarray(probes_to_displacement(rig.probes, probes).delta_x)


def noisy_cycle() -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(0.0, 2.0, 1e-3)
    load = np.interp(time, [0.0, 0.2, 0.9, 1.1, 1.8], [
        RIG.preload, RIG.preload, FULL_SCALE_LOAD, FULL_SCALE_LOAD, RIG.preload])
    return time, load + np.random.default_rng(5).normal(0.0, 50.0, time.size)


def growth(p: float, exponent: float, levelling: float | None) -> float:
    """The growing part's law as it is written down, 1 at 50 um; None: it does not level off."""
    r, c = 50e-6, levelling or 0.0
    return (p / r) ** exponent * (1.0 + (r * c) ** exponent) / (1.0 + (p * c) ** exponent)


@EXPONENTS
@LEVELLINGS
def test_damping_is_the_power_of_penetration_that_levels_off_as_asked_for(levelling, exponent):
    for p in DEPTHS[DEPTHS > contact.RAMP]:
        expected = D * (0.3 + 0.7 * growth(p, exponent, levelling))
        assert one_roller(p, 1e-3, 0.7, exponent, levelling)[2] == pytest.approx(
            expected, rel=1e-12)


def test_a_high_power_that_levels_off_is_damping_that_sets_in_at_a_depth() -> None:
    shallow, deep, deeper = (one_roller(p, 1e-3, 1.0, 8.0, 1.0 / 30e-6)[2]
                             for p in (10e-6, 60e-6, 120e-6))
    assert shallow < 1e-3 * deep
    assert deeper == pytest.approx(deep, rel=0.01)


@pytest.mark.parametrize('exponent', [1.0, 1.5, 8.0])
def test_growth_without_an_end_is_where_levelling_off_begins(exponent: float) -> None:
    for p in DEPTHS:
        assert one_roller(p, 1e-2, 0.7, exponent, 1e-4) == pytest.approx(
            one_roller(p, 1e-2, 0.7, exponent), rel=1e-7)


@pytest.mark.parametrize('levelling', [None, 2e5])
def test_the_highest_power_stays_finite_at_the_least_penetration(levelling: float | None) -> None:
    """Rollers that do not touch are summed at 1e-30 m, whose powers must not make a NaN."""
    for p in (1e-30, 1e-20, 1e-12):
        assert np.isfinite(one_roller(p, 1e-2, 1.0, 8.0, levelling)).all()


@EXPONENTS
@LEVELLINGS
@pytest.mark.parametrize('share', [0.4, 1.0])
def test_the_tangent_is_the_slope_of_the_force(share, levelling, exponent) -> None:
    law = share, exponent, levelling
    for p in DEPTHS:
        h = 1e-5 * p
        ends = [one_roller(p + way * h, 1e-2, *law)[0] for way in (-1.0, 1.0)]
        _, stiffness, damping = one_roller(p, 1e-2, *law)
        assert stiffness == pytest.approx((ends[1] - ends[0]) / (2.0 * h), rel=1e-5)
        slow, fast = (one_roller(p, rate, *law)[0] for rate in (1e-2, 2e-2))
        assert damping == pytest.approx((fast - slow) / 1e-2, rel=1e-9)


@pytest.mark.parametrize('exponent', [0.2, 0.25, 0.5, 0.95])
def test_at_touch_down_no_slope_grows_without_a_bound(exponent: float) -> None:
    """The slope of p^m does, for m < 1: at 1e-15 m it is 4e8 times that at 50 um for m = 0.2."""
    width = (1.0 - exponent) * contact.RAMP
    beside_its_end = width * np.array([1.0 - 1e-9, 1.0 + 1e-9])
    depths = np.concatenate([np.geomspace(1e-15, 2e-6, 301), beside_its_end])
    slopes = np.array([one_roller(p, 1.0, 1.0, exponent)[1] for p in depths])
    slopes -= N * K * depths ** (N - 1.0)
    at_its_end = exponent * D * (width / 50e-6) ** exponent / width
    assert slopes.max() < 6.0 * at_its_end / exponent
    assert slopes[0] < 1e-6 * at_its_end
    assert slopes[-2:] == pytest.approx(at_its_end, rel=1e-6)  # no jump where the fade ends


def test_the_law_goes_over_exponent_one_without_a_jump() -> None:
    for p in DEPTHS:
        below, above = (one_roller(p, 1e-2, 1.0, 1.0 + by) for by in (-1e-7, 1e-7))
        assert below == pytest.approx(above, rel=1e-5)


@pytest.mark.parametrize('levelling', [0.0, 1e4, 2e5])
@pytest.mark.parametrize('exponent', [0.2, 8.0])
def test_newton_converges_at_the_ends_of_the_powers(exponent: float, levelling: float) -> None:
    time, load = noisy_cycle()
    effects = {'damping_law': {'share': 1.0, 'exponent': exponent, 'levelling': levelling}}
    low, high = np.array([RIG.bounds[name] for name in PARAMETER_NAMES]).T
    draws = np.random.default_rng(1).random((8, 6))
    laws = [TRUE_TO_SCALE, *(ContactParameters.from_array(low * (high / low) ** u) for u in draws)]
    for law in laws:
        run = simulate(RIG, ParameterSet(law, effects), ELEVATION, time, load)
        assert run.failed_steps == 0
        assert np.isfinite(run.probes).all()


UNLIKE_ROWS = ContactParameters(1e8, 1.05, 3e6, 2e8, 1.3, 2e6)


def short_cycle() -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(0.0, 1.2, 1e-3)
    return time, np.interp(time, [0.0, 0.2, 0.6, 0.7, 1.1, 1.2], [
        RIG.preload, RIG.preload, 2e5, 2e5, RIG.preload, RIG.preload])


@pytest.mark.parametrize(('values', 'numbers'), [
    ({'share': 0.7}, [  # from before the exponent was free
        [3.3613215928348015e-05, 0.00011670884415007244, 0.00019404834015192895],
        [3.677316144508779e-05, 8.41725402609321e-05, 8.08834279215772e-05]]),
    ({'share': 0.6, 'exponent': 0.4}, [  # from before growth could level off
        [2.8083769178234217e-05, 0.00013752418185535435, 0.00020979948330640546],
        [3.0479814263298237e-05, 8.339055815806434e-05, 8.113307134531445e-05]])])
def test_a_file_from_before_gives_the_numbers_it_gave(values, numbers) -> None:
    probes = probe_batch(RIG, candidates({'damping_law': values}, UNLIKE_ROWS), ELEVATION,
                         *short_cycle())[0]
    assert probes[:2, [300, 500, 900]] == pytest.approx(np.array(numbers), abs=SOLVER)


def test_an_exponent_left_out_is_that_of_each_row() -> None:
    left_out, axial, middle = (
        probe_batch(RIG, candidates({'damping_law': {'share': 0.7, **exponent}}, UNLIKE_ROWS),
                    ELEVATION, *short_cycle())[0]
        for exponent in ({}, {'exponent': UNLIKE_ROWS.n1}, {'exponent': UNLIKE_ROWS.n2}))
    assert axial[1::2] == pytest.approx(left_out[1::2], abs=SOLVER)
    assert middle[0::2] == pytest.approx(left_out[0::2], abs=SOLVER)
    assert np.abs(axial[0] - left_out[0]).max() > 1e-7
    assert np.abs(middle[1] - left_out[1]).max() > 1e-7


def lag_of_a_ramp(rig: Rig, law: dict[str, float],
                  shares: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lag and rest [m] of delta_x in a slow ramp at shares of full scale, and its rate [m/s]."""
    time = np.arange(0.0, 20.0, 0.01)
    load = np.interp(time, [1.0, 20.0], [RIG.preload, FULL_SCALE_LOAD])
    moved = displacement(rig, probe_batch(
        rig, candidates({'damping_law': law}), ELEVATION, time, load)[0])
    at = np.searchsorted(load, np.array(shares) * FULL_SCALE_LOAD)
    still = static_batch(rig, TRUE_TO_SCALE.to_array()[None], ELEVATION,
                         np.array([RIG.preload, *load[at]]))[0][0]
    return still[1:] - still[0] - moved[at], still[1:], np.gradient(moved, time)[at]


@pytest.mark.parametrize('exponent', [0.25, 0.5, 1.0, 1.5])
def test_the_lag_grows_with_load_as_the_exponent_says(exponent: float) -> None:
    """Without clearance all rollers sink in proportion, so with q ~ P^(1/n) a ramp's lag is
    d/k dq/dt ~ q^m q^(1-n) q^(1-n) = q^(m + 2 - 2n): at low load little or much of that at high.
    """
    rig = replace(RIG, radial_row=replace(RIG.radial_row, clearance=0.0))
    lag, still, _ = lag_of_a_ramp(rig, {'share': 1.0, 'exponent': exponent}, (0.2, 0.8))
    assert np.all(lag > 1e-8)
    growth = np.log(lag[1] / lag[0]) / np.log(still[1] / still[0])
    assert growth == pytest.approx(exponent + 2.0 - 2.0 * TRUE_TO_SCALE.n2, abs=0.02)


@pytest.mark.parametrize(('exponent', 'levelling'), [(1.5, 2e4), (6.0, 5e4), (8.0, 2e4)])
def test_a_ramp_lags_as_the_levelling_law_summed_over_the_rollers_says(exponent, levelling):
    """Slow ramp, force along x at the row's height: lag = dq/dt sum d cos^2 / sum k cos^2."""
    rig = replace(RIG, radial_row=replace(RIG.radial_row, clearance=0.0, height=0.0))
    share, law = 0.8, TRUE_TO_SCALE
    lag, still, rate = lag_of_a_ramp(
        rig, {'share': share, 'exponent': exponent, 'levelling': levelling}, (0.2, 0.5, 0.8))
    cosine = np.cos(2.0 * np.pi * np.arange(rig.radial_row.rollers) / rig.radial_row.rollers)
    cosine = cosine[cosine > 1e-9]
    p = still[:, None] * cosine
    stiffness = (law.K2 * law.n2 * p ** (law.n2 - 1.0) * cosine**2).sum(axis=1)
    grown = 1.0 - share + share * growth(p, exponent, levelling)
    damping = (law.D2 * grown * cosine**2).sum(axis=1)
    assert lag == pytest.approx(damping / stiffness * rate, rel=0.01)
