"""The alarm in real processes: the same as offline, latched, reset, and a limit to act on."""

from itertools import pairwise
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosnet import ACTIVATE, client, DEACTIVATE, lead, set_parameter, wait_until
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import RingAlarm
from saddlering_ros.bags.write import write_bag
from saddlering_ros.cli.main import main
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE, write_parameters
from saddlering_ros.ros.launcher import ALARM_NODES, RING_NODES, start_nodes
from saddlering_ros.ros.messages import to_stamp
from saddlering_ros.ros.names import STATE_TOLD

pytestmark = pytest.mark.ros


@pytest.fixture(name='slipped')
def slipped_fixture(record: Any, tmp_path: Path) -> Path:
    """A bag whose radial probes slip by 10 um after 2 s."""
    late = record.stamps >= record.stamps[0] + 2_000_000_000
    gaps = [values + sign * 10e-6 * late
            for values, sign in zip(record.gaps, (1, 0, -1, 0), strict=True)]
    return write_bag(tmp_path / 'slipped', TestMetadata('dynamic', 50.0, 'a rig', 'a run'),
                     record.stamps, record.load, record.probe_stamps,
                     [np.float64(np.float32(values)) for values in gaps], default_rig().probes)


def test_the_alarm_of_a_replay_is_that_of_the_command_and_stays_until_it_is_reset(
        slipped: Path, ros_domain: int, tmp_path: Path) -> None:
    parameters, offline = tmp_path / 'params.yaml', tmp_path / 'watch.json'
    write_parameters(parameters, ParameterSet(TRUE_TO_SCALE))
    assert main(['watch', str(slipped), '--params', str(parameters), '--json', str(offline)]) == 0
    [expected] = json.loads(offline.read_text())['runs']
    with client(ros_domain) as one:
        told = one.listen(RingAlarm, '/rig1/ring/alarm')
        limits = one.listen(Bool, '/rig1/ring/within_limits')
        with start_nodes(slipped, domain_id=ros_domain, log_folder=tmp_path / 'log',
                         nodes=(*RING_NODES, *ALARM_NODES), exit_at_end=False,
                         namespace='/rig1') as group:
            wait_until(lambda: bool(told) and told[-1].state == RingAlarm.ALARM, 120.0,
                       'the alarm')
            wait_until(lambda: 'at its end' in group.processes['replay_clock'].said(), 120.0)
            want = expected['alarm']
            wait_until(lambda: told[-1].size == want['size'], what='size and guess are refined')
            alarm = told[-1]
            assert (alarm.channel, to_stamp(alarm.raised), to_stamp(alarm.since), alarm.size,
                    alarm.log_evidence, alarm.follows) == (
                want['channel'], want['stamp_ns'], want['since_ns'], want['size'],
                want['evidence'], want['follows'])
            assert alarm.materiality.tolist() == expected['materiality']
            assert alarm.false_alarm_hours == 1000.0
            assert [line.partition(' s: ')[2] for line in alarm.lapses] == [
                line.partition(' s: ')[2] for line in expected['notes'] if ' s: ' in line]
            assert 'delta_x has differed from its model' in alarm.message
            said = group.processes['ring_alarm'].said()
            assert said.count(STATE_TOLD + 'ALARM') == 1, 'a replay shows it'
            assert STATE_TOLD + 'no alarm' in said
            wait_until(lambda: bool(limits) and not limits[-1].data, what='beyond the limits')
            wait_until(lambda: one.diagnostics.get('/rig1/ring_alarm: alarm', (0, ''))[0] == 2,
                       what='diagnostics tell it')

            with client(ros_domain) as joiner:  # latched: who comes later hears it
                late = joiner.listen(RingAlarm, '/rig1/ring/alarm')
                wait_until(lambda: bool(late), what='the latched alarm')
                assert late[0].channel == 'delta_x'

            assert all(before != after for before, after in pairwise(told)), 'told once each'

            with one.lock:  # everything of the rig stands below its namespace
                assert not one.node.get_publishers_info_by_topic('/ring/alarm')

            # What is set while it is inactive counts from its activation; the alarm stays.
            assert not set_parameter(one, 'rig1/ring_alarm', 'false_alarm_hours', 500.0).successful
            lead(one, 'rig1/ring_alarm', DEACTIVATE)
            assert set_parameter(one, 'rig1/ring_alarm', 'false_alarm_hours', 500.0).successful
            lead(one, 'rig1/ring_alarm', ACTIVATE)
            wait_until(lambda: told[-1].false_alarm_hours == 500.0, what='the new rate')
            assert (told[-1].state, told[-1].size) == (RingAlarm.ALARM, want['size'])

            answer = one.call(Trigger, '/rig1/ring_alarm/reset')
            assert 'alarm of delta_x is reset' in answer.message
            wait_until(lambda: told[-1].state < RingAlarm.ALARM, what='it is reset')
            wait_until(lambda: limits[-1].data, what='within the limits')
