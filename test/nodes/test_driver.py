"""The nodes behind a driver instead of a replay: best effort, late, loss, jumps, zeroing."""

from __future__ import annotations

from dataclasses import replace
import time

import numpy as np
import pytest
from rosnet import Client, Driver, OUTPUTS, wait_until
from std_srvs.srv import Trigger

from saddlering_ros.rig import default_rig
from saddlering_ros.ros.launcher import NodeGroup, RING_NODES
from saddlering_ros.streams import batches
from saddlering_ros.streams.displacement import DisplacementStream

pytestmark = pytest.mark.ros


def start(group: NodeGroup, heard: Client, driver: Driver) -> None:
    for name in RING_NODES:
        group.start(name)
    wait_until(lambda: driver.matched(2) and heard.ring_nodes_matched(), 80.0, 'all are matched')


def settle(heard: Client, seconds: float = 1.5) -> None:
    """Wait until no more residuals come."""
    count = -1
    while count != len(heard.raw['/ring/residual']):
        count = len(heard.raw['/ring/residual'])
        time.sleep(seconds)


def offline(record, rows=slice(None)) -> batches.Displacements:
    stamps = record.stamps[rows]
    return DisplacementStream(default_rig()).push(
        batches.Samples(stamps, record.load[rows]),
        [batches.Samples(record.probe_stamps[probe][rows],
                      np.float64(np.float32(record.gaps[probe][rows]))) for probe in range(4)])


def test_best_effort_driver_late_join_zero_and_stamp_jump(
        record, group: NodeGroup, heard: Client) -> None:
    driver = Driver(heard, reliable=False)
    start(group, heard, driver)

    # Joining while the ring is under load: nothing is made up, diagnostics say what is missing.
    driver.send(record, slice(900, 1100))
    wait_until(lambda: 'waiting for preload' in heard.diagnostics.get(
        'ring_displacement: zero', (0, ''))[1], what='it waits for preload')
    wait_until(lambda: 'waiting for preload' in heard.diagnostics.get(
        'ring_simulator: zero', (0, ''))[1], what='the simulator too')
    assert not any(heard.raw[topic] for topic in OUTPUTS)

    # A zero on request at that load; simulator and residual follow.
    assert heard.call(Trigger, '/ring_displacement/zero').success
    held = replace(record, load=np.full_like(record.load, record.load[1099]),
                   gaps=[np.full_like(gap, gap[1099]) for gap in record.gaps])
    driver.send(held, slice(1101, 1500))
    settle(heard)
    residual = heard.heard('/ring/residual')
    assert len(residual) > 250
    assert abs(residual.zero_loads[-1] - record.load[1099]) < 1.0
    assert np.abs(residual.channels).max() < 1e-8

    # The clock of the driver jumps back a minute: new zero at preload, nothing mixed.
    heard.forget()
    again = record.later(-60.0)
    driver.send(again, pace=20)
    settle(heard)
    measured, expected = heard.heard('/ring/displacement'), offline(again)
    both, ours, theirs = np.intersect1d(measured.stamps, expected.stamps, return_indices=True)
    assert len(both) > 0.5 * len(expected)  # what a busy machine leaves of best effort
    assert set(measured.stamps.tolist()) <= set(again.stamps.tolist())
    if len(both) == len(expected):  # best effort may lose; then neighbours are interpolated
        assert np.array_equal(measured.channels[:, ours], expected.channels[:, theirs])
    assert len(heard.heard('/ring/residual')) > 0.5 * len(expected)
    wait_until(lambda: heard.diagnostics.get('ring_displacement: zero', (9, ''))[0] == 0)


def test_lost_and_reordered_messages_of_a_reliable_driver(
        record, group: NodeGroup, heard: Client) -> None:
    driver = Driver(heard)
    start(group, heard, driver)
    rng = np.random.default_rng(5)
    kept = np.sort(rng.permutation(2000)[:1900])
    rows = np.concatenate([np.arange(450), kept[kept >= 450]])
    order = rows.copy()
    order[500:1500] = order[500:1500].reshape(-1, 2)[:, ::-1].ravel()
    for begin in range(0, len(order), 50):
        part = order[begin:begin + 50]
        driver.send_load(record.stamps[part], record.load[part])
        for probe in range(4):
            driver.send_gap(probe, record.probe_stamps[probe][part], record.gaps[probe][part])
        time.sleep(0.005)
    settle(heard)
    residual = heard.heard('/ring/residual')
    measured = heard.heard('/ring/displacement')
    simulated = heard.heard('/ring/simulated_displacement')
    assert len(residual) > 0.97 * len(rows)
    _, ours, of = np.intersect1d(measured.stamps, residual.stamps, return_indices=True)
    _, theirs, _ = np.intersect1d(simulated.stamps, residual.stamps, return_indices=True)
    assert len(of) == len(theirs) == len(residual)
    both = np.sort(residual.stamps)
    row = {stamp: index for index, stamp in enumerate(residual.stamps.tolist())}
    index = [row[stamp] for stamp in both.tolist()]
    assert np.array_equal(residual.channels[:, index],
                          measured.channels[:, ours] - simulated.channels[:, theirs])
    said = ' '.join(heard.warnings)
    assert 'gaps in the stamps' in said or 'out of order' in said or 'late' in said
