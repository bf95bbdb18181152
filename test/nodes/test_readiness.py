"""A rig is ready to test when every node is active and reports nothing but OK."""

import pytest

from saddlering_ros.rig import default_rig
from saddlering_ros.rig.geometry import ZeroReading
from saddlering_ros.ros.diagnostics import ACTIVE, ERROR, OK, STALE, WARN
from saddlering_ros.ros.rig_state import EVENTS_COUNT, Readiness, SILENT, zero_status

NODES = ('/rig1/ring_displacement', '/rig1/ring_simulator')


def rig(now: float = 100.0, **changes: tuple[int, str]) -> Readiness:
    """Two nodes that report at `now`; changes: statuses of the first by task."""
    readiness = Readiness(NODES)
    for node in NODES:
        sound = {'state': (OK, ACTIVE), 'zero': (OK, 'zero at 0.5 t'), 'rig': (OK, 'rig 1234'),
                 'stream /rig/hydraulic_load': (OK, '1000 messages a second'),
                 'events': (OK, 'nothing lost, late or dropped')}
        for task, (level, words) in {**sound, **(changes if node == NODES[0] else {})}.items():
            readiness.hear(f'{node}: {task}', level, words, now)
    return readiness


def test_a_rig_whose_nodes_are_active_and_sound_is_ready() -> None:
    assert rig().reasons(100.5) == []


def test_every_thing_amiss_is_a_reason() -> None:
    for task, level, words in (
            ('state', OK, 'not active: ros2 lifecycle set /rig1/ring_displacement configure'),
            ('zero', WARN, 'waiting for preload'), ('rig', ERROR, 'others have another'),
            ('stream /rig/hydraulic_load', STALE, 'nothing received yet'),
            ('events', WARN, '1 impossible')):
        (reason,) = rig(**{task: (level, words)}).reasons(100.5)
        assert words in reason
        assert reason.startswith('/rig1/ring_displacement')


def test_a_node_that_is_not_heard_any_more_is_a_reason() -> None:
    assert rig().reasons(100.0 + 2 * SILENT) == [f'{name} does not report' for name in NODES]


def test_a_refused_sample_counts_for_some_seconds() -> None:
    readiness = rig(events=(WARN, '1 impossible'))
    for now in (101.0, 100.0 + EVENTS_COUNT):
        for node in NODES:
            readiness.hear(f'{node}: state', OK, ACTIVE, now)
            readiness.hear(f'{node}: events', OK, 'nothing lost, late or dropped', now)
        ready = now >= 100.0 + EVENTS_COUNT
        assert (readiness.reasons(now) == []) == ready


def test_nodes_of_another_namespace_do_not_count() -> None:
    readiness = rig()
    readiness.hear('/rig2/ring_displacement: zero', ERROR, 'of another rig', 100.0)
    readiness.hear('ring_displacement: zero', ERROR, 'of another rig', 100.0)
    assert readiness.reasons(100.5) == []


@pytest.mark.parametrize(('factor', 'words'), [
    (1.0, ''), (0.7, ''), (1e-3, 'looks like kN: publish newtons'),
    (1.0 / 9806.65, 'looks like t: publish'), (1.0 / 9.80665, 'looks like kgf or daN: publish'),
    (-0.002, 'zero at -0.001 t is below the preload (0.50 t): the load was tared'),
    (-1.0, 'is a pull: publish a pushing load as positive')])
def test_a_zero_below_the_preload_or_at_it_in_another_unit_is_a_warning(factor, words) -> None:
    shipped = default_rig()
    zero = ZeroReading(shipped.preload * factor, (), 0, 10, True)
    status = zero_status(shipped, zero, 1, 2, zero.load)
    assert status.level == (WARN if words else OK)
    assert words in status.words
    waiting = zero_status(shipped, None, 0, 2, shipped.preload)
    assert 'waiting for 5 samples in a steady 0.5 s' in waiting.words, 'a slow load is at rest too'
