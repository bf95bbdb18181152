"""A verdict's causes as typed messages hold what its JSON holds."""

from __future__ import annotations

import math

from saddlering_ros.ros.messages import causes_to_messages

DOCUMENT = {'causes': [
    {'effect': 'radial_friction', 'group': ['radial_friction', 'probe_lag'],
     'parameters': {'force': {'value': 5e3, 'std': 100.0, 'unit': 'N'}},
     'evidence': {'p_value': 1e-9, 'delta_bic': -40.0}, 'gain': {'fit': 0.4, 'held_out': None}},
    {'channel': 'gamma'}]}


def test_every_figure_of_a_cause_is_in_its_message() -> None:
    (cause,) = causes_to_messages(DOCUMENT)
    assert (cause.effect, list(cause.group)) == ('radial_friction',
                                                 ['radial_friction', 'probe_lag'])
    assert (list(cause.parameter_names), list(cause.units)) == (['force'], ['N'])
    assert (cause.values[0], cause.stds[0]) == (5e3, 100.0)
    assert (cause.lower[0], cause.upper[0]) == (4804.0, 5196.0)
    assert (cause.p_value, cause.delta_bic, cause.misfit_reduction_fit) == (1e-9, -40.0, 0.4)
    assert math.isnan(cause.misfit_reduction_held_out)
