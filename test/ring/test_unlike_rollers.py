"""Claims about rows whose rollers do not all have the same clearance."""

from dataclasses import replace

import numpy as np
import pytest
import readable_ring as reference

from saddlering_ros.effects import extension_of
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, Rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.rig.geometry import Displacement, displacement_to_probes
from saddlering_ros.ring.model import mixed, rows_of
from saddlering_ros.ring.simulator import static_batch, static_response
from saddlering_ros.ring.small_errors import known_rigs, scatter_columns

RIG = default_rig()
ELEVATION = float(np.radians(50.0))
LOADS = np.array([1.0, 5.0, 12.0, FULL_SCALE_LOAD / TONNE]) * TONNE


@pytest.mark.parametrize('count', [60, 101, 121])
def test_clearances_are_even_in_all_and_unlike_from_roller_to_roller(count: int) -> None:
    places = mixed(count)
    assert np.sort(places) == pytest.approx(np.linspace(-1.0, 1.0, count), abs=3.0 / count)
    every_five = np.lib.stride_tricks.sliding_window_view(places, 5)
    assert np.ptp(every_five, axis=1).min() > 1.0


def test_the_ring_rests_where_the_sum_of_such_rollers_balances_the_load() -> None:
    effects = {'axial_clearance': {'change': 1.4e-5, 'spread': 1.0},
               'radial_clearance': {'change': 1e-5, 'spread': 0.5},
               'axial_flatness': {'amplitude': 6e-6, 'angle': 0.3, 'third': 0.5,
                                  'rows': 1.0},
               'out_of_round': {'amplitude': 4e-6, 'angle': 0.4}}
    motion = static_batch(RIG, TRUE_TO_SCALE.to_array()[None], ELEVATION, LOADS,
                          [extension_of(effects)])[0]
    upper, lower, middle = reference.contact_rows(RIG, TRUE_TO_SCALE)
    axial = 7e-6 * (1.0 + mixed(RIG.axial_rows.rollers))
    bent, angles = (np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
                    for count in (RIG.axial_rows.rollers, RIG.radial_row.rollers))
    saddle = 6e-6 * (np.cos(2.0 * (bent - 0.3)) + 0.5 * np.cos(3.0 * bent))
    radial = (5e-6 * (1.0 + 0.5 * mixed(RIG.radial_row.rollers))
              + 4e-6 * np.cos(2.0 * (angles - 0.4)))
    rows = (replace(upper, gap=upper.gap + axial + saddle),
            replace(lower, gap=lower.gap + axial - saddle),
            replace(middle, gap=middle.gap + radial))
    for load, q in zip(LOADS, motion.T, strict=True):
        external = reference.external_force(RIG, load, ELEVATION)
        left = external + reference.contact_force(rows, q, np.zeros(3))
        assert np.abs(left) == pytest.approx(0.0, abs=1e-5 * np.abs(external).max())


def test_a_file_from_before_rollers_could_differ_gives_the_numbers_it_gave() -> None:
    plain, spread = (
        rows_of(RIG, extension_of({'axial_clearance': {'change': 1.4e-5, **more}}))
        for more in ({}, {'spread': 0.0}))
    assert np.array_equal(plain.flat, spread.flat)
    assert plain.uniform.all()
    gaps = plain.flat.reshape(3, 3, -1)[0, 2, :plain.counts[0]]
    assert gaps == pytest.approx(0.5 * RIG.axial_rows.clearance + 7e-6, abs=1e-18)


def test_an_uncertain_quantity_lies_as_far_below_its_value_as_above() -> None:
    def read(rig: Rig) -> np.ndarray:
        return np.array([rig.axial_rows.clearance, rig.radial_row.clearance, rig.carriage.weight])

    above, below = (np.array([read(one) for one in side])
                    for side in zip(*known_rigs(RIG), strict=True))
    assert above + below == pytest.approx(np.tile(2.0 * read(RIG), (3, 1)))
    assert np.array_equal(above > below, np.eye(3, dtype=bool))


@pytest.mark.parametrize('static', [True, False])
def test_a_ring_that_no_roller_touches_is_no_singular_matrix(static: bool) -> None:
    """A wrong unit of the probes let the best ring float: the identification failed."""
    contact, time = TRUE_TO_SCALE.to_array(), np.arange(0.0, 1.0, 0.02)
    zero = static_response(RIG, contact, ELEVATION, np.array([RIG.preload]))[:, 0]
    within = np.where((time > 0.4) & (time < 0.6), 0.0, 1.0)[:, None] * zero - zero
    probes = displacement_to_probes(RIG.probes, Displacement(*within.T, np.zeros(len(time))))
    columns = scatter_columns(RIG, contact, ELEVATION, RIG.preload, time, np.asarray(probes),
                              static=static)
    assert np.isfinite(columns).all()
