"""What nodes report of their health counts for the period reported, and names its own things."""

from __future__ import annotations

import numpy as np

from saddlering_ros.nodes.replay_clock import ReplayClockNode
from saddlering_ros.nodes.ring_displacement import RingDisplacementNode
from saddlering_ros.record.guard import load_limits, SampleGuard, Samples
from saddlering_ros.rig import default_rig
from saddlering_ros.ros.diagnostics import Events, OK, SaturationTask, StreamTask, WARN
from saddlering_ros.ros.parameters import _rig_values, rig_words

START, MS = 10**18, 1_000_000


def test_the_longest_gap_is_that_of_the_period_and_a_stamp_of_0_makes_none() -> None:
    task = StreamTask('/rig/hydraulic_load')
    stamps = START + MS * np.arange(100)
    task.push(np.append(stamps, 0))
    task.push(stamps[-1] + MS * np.array([1, 2, 502, 503]))
    first = task.report(1.0)
    assert (first.level, first.figures['longest gap of this period [s]']) == (WARN, '0.5')
    task.push(stamps[-1] + MS * np.arange(504, 600))
    second = task.report(1.0)
    assert (second.level, second.figures['longest gap of this period [s]']) == (OK, '0')


def test_the_next_test_at_another_rate_has_no_gaps() -> None:
    task = StreamTask('/rig/hydraulic_load')
    task.push(START + MS * np.arange(1000))
    task.report(1.0)
    for stamp in START + 1000 * MS + 40 * MS * np.arange(25):
        task.push(np.array([stamp]))
    found = task.report(1.0)
    assert (found.level, found.figures['period by stamps [ms]']) == (OK, '40')


def test_a_reading_that_is_no_number_is_not_at_an_end_of_the_range() -> None:
    task = SaturationTask('/rig/eddy_current_1', 0.0, 2e-3)
    task.push(np.array([1e-3, np.nan, np.inf]))
    assert task.report(1.0).level == OK


def test_a_refused_reading_is_a_warning_of_the_same_period_and_of_no_later_one() -> None:
    guard = SampleGuard(load_limits(default_rig()))
    events = Events(lambda: vars(guard.counters))
    assert events.report(1.0).level == OK
    guard.push(Samples(START + MS * np.arange(3), np.array([1e5, 3e38, 1e5])))
    found = events.report(1.0)
    assert (found.level, found.words) == (WARN, '1 impossible')
    later = events.report(1.0)
    assert (later.level, later.figures['impossible']) == (OK, '1')


def test_every_parameter_of_the_rig_has_a_text_of_its_own() -> None:
    texts = [rig_words(name) for name in _rig_values(default_rig())]
    assert len(set(texts)) == len(texts)


def test_what_may_be_set_while_active_takes_effect_and_the_clock_does_not_hear_itself() -> None:
    changeable = {parameter.name for node in (ReplayClockNode, RingDisplacementNode)
                  for parameter in node.PARAMETERS if parameter.changeable}
    assert {'window', 'parity_noise'} <= changeable
    assert not ReplayClockNode.TELLS_PROGRESS
