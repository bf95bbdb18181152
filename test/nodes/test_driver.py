"""The nodes behind a driver instead of a replay: best effort, late, loss, jumps, zeroing."""

from dataclasses import replace

from geometry_msgs.msg import Vector3, Vector3Stamped
import numpy as np
import pytest
from rosnet import Client, Driver, OUTPUTS, READERS, wait_until
from std_srvs.srv import Trigger

from saddlering_ros.record.batches import Displacements, Samples
from saddlering_ros.record.displacement import DisplacementStream
from saddlering_ros.rig import default_rig
from saddlering_ros.ros.launcher import NodeGroup, RING_NODES

pytestmark = pytest.mark.ros
PORTION = 10
"""Rows sent at a time with best effort; their messages fit into the receive buffer of a socket."""
RELIABLE_PORTION = 50


def start(group: NodeGroup, heard: Client, driver: Driver) -> None:
    for name in RING_NODES:
        group.start(name)
    wait_until(lambda: driver.matched(2) and heard.ring_nodes_matched(), 80.0, 'all are matched')


def stamps_of(heard: Client, topic: str) -> set[int]:
    return set(heard.heard(topic).stamps.tolist())


def offline(record, rows=slice(None)) -> Displacements:
    stamps = record.stamps[rows]
    return DisplacementStream(default_rig()).push(
        Samples(stamps, record.load[rows]),
        [Samples(record.probe_stamps[probe][rows],
                 np.float64(np.float32(record.gaps[probe][rows]))) for probe in range(4)])


def test_best_effort_driver_late_join_zero_and_stamp_jump(record, group, heard) -> None:
    driver = Driver(heard, reliable=False)
    start(group, heard, driver)

    # Joining while the ring is under load: nothing is made up, diagnostics say what is missing.
    driver.send(record, slice(900, 1100), PORTION)
    wait_until(lambda: 'waiting for preload' in heard.diagnostics.get(
        'ring_displacement: zero', (0, ''))[1], what='it waits for preload')
    wait_until(lambda: 'waiting for preload' in heard.diagnostics.get(
        'ring_simulator: zero', (0, ''))[1], what='the simulator too')
    assert not any(heard.raw[topic] for topic in OUTPUTS)

    # A zero on request at that load; simulator and residual follow, as soon as each hears of it.
    # One that a busy machine hears after a silence is refused, and made again.
    held = replace(record, load=np.full_like(record.load, record.load[1099]),
                   gaps=[np.full_like(gap, gap[1099]) for gap in record.gaps])
    row, is_asked = 1101, False
    while not is_asked:
        driver.send(held.later((row - 1101) * 2e-3), slice(1101, 1101 + PORTION), PORTION)
        row += PORTION
        is_asked = heard.call(Trigger, '/ring_displacement/zero').success
    while len(heard.raw['/ring/residual']) <= 250:
        driver.send(held.later((row - 1101) * 2e-3), slice(1101, 1101 + PORTION), PORTION)
        row += PORTION
        assert row < 10_000, 'no residual in 18 s of the load'
    residual = heard.heard('/ring/residual')
    assert abs(residual.zero_loads[-1] - record.load[1099]) < 1.0
    assert np.abs(residual.channels).max() < 1e-8

    # The clock of the driver jumps back a minute: new zero at preload, nothing mixed.
    again, rows = record.later(-60.0), slice(0, 800)
    expected = offline(again, rows)
    with heard.lock:
        heard.diagnostics.clear()
    driver.send(again, rows, PORTION)
    wait_until(lambda: stamps_of(heard, '/ring/residual') >= set(expected.stamps.tolist()),
               what='a residual for every row')
    measured = heard.heard('/ring/displacement')
    rows = np.flatnonzero(measured.stamps <= again.stamps[-1])
    assert np.array_equal(measured.stamps[rows], expected.stamps)
    assert np.array_equal(measured.channels[:, rows], expected.channels)
    wait_until(lambda: heard.diagnostics.get('ring_displacement: zero', (9, ''))[0] == 0)


def test_lost_and_reordered_messages_of_a_reliable_driver(record, group, heard) -> None:
    driver = Driver(heard)
    start(group, heard, driver)
    rng = np.random.default_rng(5)
    kept = np.sort(rng.permutation(2000)[:1900])
    rows = np.concatenate([np.arange(450), kept[kept >= 450]])
    order = rows.copy()
    order[500:1500] = order[500:1500].reshape(-1, 2)[:, ::-1].ravel()
    for begin in range(0, len(order), RELIABLE_PORTION):
        driver.send(record, order[begin:begin + RELIABLE_PORTION])

    # What a node has not given out, it has counted: at the most one row a portion, which may
    # arrive in two parts, cut between two rows that changed places.
    def lost(node: str, *events: str) -> int:
        return len(order) - heard.counted(node, *events)

    wait_until(lambda: len(heard.raw['/ring/displacement']) == lost(
        'ring_displacement', 'before_probes', 'late_loads'), what='every row measured or counted')
    wait_until(lambda: len(heard.raw['/ring/simulated_displacement']) == lost(
        'ring_simulator', 'late'), what='every row simulated or counted')
    measured = heard.heard('/ring/displacement')
    simulated = heard.heard('/ring/simulated_displacement')
    both = np.intersect1d(measured.stamps, simulated.stamps)
    wait_until(lambda: len(heard.raw['/ring/residual']) == len(both), what='every residual')
    assert len(both) > len(order) - 2 * 1000 / RELIABLE_PORTION

    residual = heard.heard('/ring/residual')
    residual = residual.pick(np.argsort(residual.stamps, kind='stable'))
    _, ours, _ = np.intersect1d(measured.stamps, residual.stamps, return_indices=True)
    _, theirs, _ = np.intersect1d(simulated.stamps, residual.stamps, return_indices=True)
    assert np.array_equal(residual.stamps, both)
    assert np.array_equal(residual.channels,
                          measured.channels[:, ours] - simulated.channels[:, theirs])
    wait_until(lambda: 'out of order' in ' '.join(heard.warnings), what='a warning of the order')


def test_rubbish_is_refused_and_a_node_killed_beside_a_driver_measures_again(
        record, group: NodeGroup, heard: Client) -> None:
    def matched() -> bool:
        return (driver.matched(2) and heard.matched(OUTPUTS[:2])
                and heard.progress.keys() >= set(READERS))

    def measured_all() -> bool:
        return len(heard.raw['/ring/displacement']) == len(offline(record, rows))

    driver, rows = Driver(heard), slice(0, 600)
    for name in READERS:
        group.start(name)
    wait_until(matched, 80.0, 'both are matched')
    driver.send(record, rows)
    wait_until(measured_all, what='every row measured')

    # Readings that no rig has, stamps of far past and future, and what is no message at all.
    last = int(record.stamps[rows][-1])
    stamps = np.array([last + 1, 0, 1, last - 10**12, 2**31 * 10**9 - 1])
    for value in (np.nan, np.inf, -np.inf, 3e38):
        driver.send_load(stamps, np.full(len(stamps), value))
    driver.load.send([b'\0\1\0\0', b'\0\1\0\0' + b'\xff' * 40], last)
    wait_until(driver.taken, what='the nodes take it')
    wait_until(lambda: all(heard.counted(name, 'malformed') == 2 for name in READERS),
               what='both count what is no message')
    assert measured_all()
    assert np.isfinite(heard.heard('/ring/simulated_displacement').channels).all()

    # The driver goes on while the node is not there, and a test later it measures as before.
    group.processes['ring_displacement'].process.kill()
    group.processes['ring_displacement'].process.wait()
    heard.progress.pop('ring_displacement')
    driver.send(record.later(60.0), slice(0, 100))
    group.start('ring_displacement')
    heard.forget()
    wait_until(matched, 80.0, 'it is matched again')
    for publisher in (driver.load, *driver.probes):
        publisher.published = 0  # counted from the start of the node
    del heard.progress['ring_simulator']
    again = record.later(120.0)
    driver.send(again, rows)
    expected = offline(again, rows)
    wait_until(measured_all, what='every row measured again')
    measured = heard.heard('/ring/displacement')
    assert np.array_equal(measured.stamps, expected.stamps)
    assert np.array_equal(measured.channels, expected.channels)


def test_a_gear_that_gives_under_load_is_followed_with_a_warning_and_ends_nothing(
        record, group: NodeGroup, heard: Client) -> None:
    driver = Driver(heard, reliable=True)
    with heard.lock:
        inclinometer = heard.node.create_publisher(Vector3Stamped, '/rig/elevation', 10)

    def incline(degrees: float, words: str) -> None:
        def told() -> bool:
            inclinometer.publish(Vector3Stamped(vector=Vector3(x=float(np.radians(degrees)))))
            return words in heard.diagnostics.get('ring_simulator: elevation', (0, ''))[1]
        wait_until(told, what=f'the simulator follows to {degrees} deg')

    start(group, heard, driver)
    incline(52.0, '52.000 deg, measured')
    driver.send(record, slice(0, 900), RELIABLE_PORTION)
    incline(52.13, 'has moved by +0.130 deg since the zero')
    assert heard.diagnostics['ring_simulator: elevation'][0] == 1, 'a warning'
    driver.send(record, slice(900, 1500), RELIABLE_PORTION)
    wait_until(lambda: record.stamps[1495] in stamps_of(heard, '/ring/residual'),
               what='residuals after the movement')
    residual = heard.heard('/ring/residual')
    assert set(record.stamps[900:1495].tolist()) <= set(residual.stamps.tolist())
    assert len(set(residual.zero_stamps.tolist())) == 1
    assert np.allclose(residual.elevations[-1], np.radians(52.13))
