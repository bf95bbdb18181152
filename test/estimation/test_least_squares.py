"""Claims about bounded least squares: its bottom, its bounds, and the covariance there."""

import numpy as np
import pytest

from saddlering_ros.discrepancy import Parameter
from saddlering_ros.discrepancy.search.space import bound_reached
from saddlering_ros.estimation import least_squares
from saddlering_ros.estimation.least_squares import covariance, LazyAnswer, minimise, Rule
from saddlering_ros.rig import TRUE_TO_SCALE

PLACES = np.linspace(0.0, 4.0, 60)
TRUTH = np.array([1.3, 0.7])
LOW, HIGH = np.array([0.0, 0.1]), np.array([5.0, 3.0])


def decay(points):
    """Residuals (B, R) of a decay of amplitude and rate (B, 2)."""
    seen = TRUTH[0] * np.exp(-TRUTH[1] * PLACES)
    return 100.0 * (points[:, :1] * np.exp(-points[:, 1:] * PLACES) - seen)


def slopes(point):
    fall = 100.0 * np.exp(-point[1] * PLACES)
    return np.stack([fall, -point[0] * PLACES * fall], axis=1)


def at(point, taken=None):
    """The decay at a point; counts how often its slopes are asked for."""
    def counted():
        if taken is not None:
            taken.append(1)
        return slopes(point)

    return LazyAnswer(decay(point[None])[0], counted)


@pytest.mark.parametrize('start', [[0.2, 2.9], [5.0, 0.1], [1.3, 0.7]])
def test_the_bottom_is_found_from_afar(start):
    found = minimise(at, np.array(start), LOW, HIGH)
    assert found.point == pytest.approx(TRUTH, rel=1e-6)
    assert not found.at_bound.any()
    assert found.jacobian == pytest.approx(slopes(found.point))


def test_a_bound_in_the_way_is_where_it_stops():
    found = minimise(at, np.array([0.5, 0.5]), LOW, np.array([1.0, 3.0]))
    assert found.point[0] == pytest.approx(1.0)
    assert found.at_bound.tolist() == [True, False]


def test_a_bound_is_as_wide_in_an_identification_as_in_a_diagnosis():
    """Parameters published after a diagnosis were determined where it took them for stopped."""
    for place, is_stopped in ((0.0, True), (5e-4, True), (0.9996, True), (2e-3, False)):
        point = LOW + place * (HIGH - LOW)
        assert least_squares.on_bound(point, LOW, HIGH).all() == is_stopped
        assert (bound_reached(Parameter(1.0, 3.0), place) is not None) == is_stopped


def test_a_jump_of_the_misfit_near_the_start_is_approached():
    """As friction has one, where it holds a ring on the other side of a clearance."""
    def jumping(point):
        found = at(point)
        return found if point[0] < 0.3 else LazyAnswer(found.residual + 1e4, found.slopes)

    start = np.array([0.2, 0.7])
    found = minimise(jumping, start, LOW, HIGH)
    assert found.point[0] > 0.21
    assert found.chi_square < float(np.sum(decay(start[None])**2))


def test_slopes_are_asked_for_only_where_a_step_is_taken():
    asked, taken = [], []
    minimise(lambda point: (asked.append(1), at(point, taken))[1],
             np.array([5.0, 3.0]), LOW, HIGH)
    assert len(taken) < len(asked)


def test_a_step_that_is_to_gain_nothing_is_not_taken():
    asked = []
    found = minimise(lambda point: (asked.append(1), at(point))[1], TRUTH, LOW, HIGH)
    assert len(asked) == 1
    assert found.point == pytest.approx(TRUTH)


def test_a_coordinate_without_effect_has_a_huge_variance_unless_a_prior_holds_it():
    jacobian = np.array([[2.0, 0.0], [0.0, 0.0]])
    assert covariance(jacobian)[1, 1] > 1e12
    assert covariance(jacobian, prior=1.0) == pytest.approx(np.diag([0.2, 1.0]))


def test_the_prior_holds_all_but_periodic_coordinates_at_the_middle_of_the_box():
    rule = Rule(np.array([False, True]), prior=2.0, rounds=1, quiet_gain=0.0, quiet_share=0.0)
    assert rule.cost(np.array([3.0]), np.array([0.75, 0.0])) == pytest.approx(9.0 + 4.0 * 0.25**2)


def test_coordinates_of_a_law_outside_of_the_box_are_those_of_its_nearest_point():
    box = {'K1': (1e7, 1e9), 'n1': (1.0, 1.3)}
    space = least_squares.SearchSpace.of(box, box, TRUE_TO_SCALE, ['K1'])
    law = np.array([1e10, 0.5, *TRUE_TO_SCALE.to_array()[2:]])
    assert space.contacts(space.coordinates(law))[0, :2] == pytest.approx([1e9, 1.0])
