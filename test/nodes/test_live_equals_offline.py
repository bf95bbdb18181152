"""Over real DDS, between real processes: what nodes publish is what the commands compute."""

from pathlib import Path

import numpy as np
import pytest
from rosnet import client, OUTPUTS, wait_until
from std_srvs.srv import Trigger

from saddlering_ros.bags.reader import read_run
from saddlering_ros.bags.write import write_bag
from saddlering_ros.record.displacement import displacement_of_run, measured_rows, zero_of_run
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import CHANNELS, default_rig, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import simulate
from saddlering_ros.ros.launcher import start_nodes

pytestmark = pytest.mark.ros


def test_displacement_simulation_and_residual_equal_the_offline_ones_bit_for_bit(
        record, ros_domain: int, tmp_path: Path) -> None:
    paused = record.paused(900, 12.0)  # longer than between two tests, and still the same one
    bag = write_bag(tmp_path / 'paused', TestMetadata('dynamic', 50.0), paused.stamps, paused.load,
                    paused.probe_stamps, paused.gaps, default_rig().probes)
    with client(ros_domain) as heard, start_nodes(
            bag, domain_id=ros_domain, log_folder=tmp_path / 'log', start_paused=True) as group:
        wait_until(heard.matched, what='everyone publishes')
        assert heard.call(Trigger, '/replay_clock/play').success
        assert group.wait('replay_clock', 60.0) == 0
        run, rig = read_run(bag), default_rig()
        offline = displacement_of_run(rig, run)
        computed = simulate(rig, ParameterSet(TRUE_TO_SCALE), run.elevation, run.time, run.load)
        rows = offline.complete
        owed = dict(zip(OUTPUTS, (rows.sum(), len(run.stamps) - computed.first,
                                  rows[computed.first:].sum()), strict=True))
        wait_until(lambda: all(len(heard.raw[topic]) >= count for topic, count in owed.items()),
                   what='all of all three')
        measured, simulated, residual = (heard.heard(topic) for topic in OUTPUTS)

    expected = np.stack([getattr(offline.displacement, name) for name in CHANNELS])[:, rows]
    assert np.array_equal(measured.stamps, run.stamps[rows])
    assert np.array_equal(measured.channels, expected)
    assert set(measured.zero_loads.tolist()) == {offline.zero.load}

    expected = np.stack([getattr(computed.displacement, name) for name in CHANNELS])
    assert np.array_equal(simulated.stamps, run.stamps[computed.first:])
    assert np.array_equal(simulated.channels, expected)
    assert set(simulated.zero_loads.tolist()) == {computed.zero.load}

    both, ours, theirs = np.intersect1d(measured.stamps, simulated.stamps, return_indices=True)
    assert np.array_equal(residual.stamps, both)
    assert np.array_equal(residual.channels,
                          measured.channels[:, ours] - simulated.channels[:, theirs])


def test_rows_without_a_probe_that_dies_before_the_end_equal_the_offline_ones(
        record, ros_domain: int, tmp_path: Path) -> None:
    rig, dies = default_rig(), slice(None, 1700)
    bag = write_bag(tmp_path / 'dies', TestMetadata('dynamic', 50.0), record.stamps, record.load,
                    [*record.probe_stamps[:3], record.probe_stamps[3][dies]],
                    [*record.gaps[:3], record.gaps[3][dies]], rig.probes)
    with client(ros_domain) as heard, start_nodes(
            bag, domain_id=ros_domain, log_folder=tmp_path / 'log', start_paused=True,
            nodes=('ring_displacement',)) as group:
        wait_until(lambda: heard.matched(OUTPUTS[:1]), what='it publishes')
        assert heard.call(Trigger, '/replay_clock/play').success
        assert group.wait('replay_clock', 60.0) == 0
        run = read_run(bag)
        expected = measured_rows(rig, run, zero_of_run(rig, run), slice(None))
        wait_until(lambda: len(heard.raw[OUTPUTS[0]]) >= len(expected), what='all rows')
        measured = heard.heard(OUTPUTS[0])
    assert np.array_equal(measured.stamps, expected.stamps)
    assert np.array_equal(measured.channels, expected.channels, equal_nan=True)
