"""Two rigs in one ROS domain, each under its namespace, do not hear each other."""

from contextlib import ExitStack
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosnet import Client, Driver, wait_until
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import ReplayProgress, RingDisplacement
from saddlering_ros.bags.reader import read_run
from saddlering_ros.bags.wire import decode_displacements
from saddlering_ros.bags.write import write_bag
from saddlering_ros.live.recorder import recording
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import CHANNELS, default_rig, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import simulate
from saddlering_ros.ros.launcher import start_nodes
from saddlering_ros.ros.names import namespace_of, NodeError, PROGRESS
from saddlering_ros.ros.raw_topics import RawSubscription

SIMULATED = 'ring/simulated_displacement'


@pytest.mark.parametrize(('text', 'namespace'), [
    ('', ''), ('/', ''), ('rig1', '/rig1'), ('/hall/rig1/', '/hall/rig1')])
def test_a_namespace_is_written_with_one_slash_before_it(text: str, namespace: str) -> None:
    assert namespace_of(text) == namespace


def test_a_namespace_that_ros_refuses_is_refused_in_one_line() -> None:
    with pytest.raises(NodeError, match='give letters'):
        namespace_of('rig 1')


def simulated(bag: Path) -> np.ndarray:
    """The four channels (4, N) that the commands compute for a bag."""
    run = read_run(bag)
    found = simulate(default_rig(), ParameterSet(TRUE_TO_SCALE), run.elevation, run.time, run.load)
    return np.stack([getattr(found.displacement, name) for name in CHANNELS])


@pytest.mark.ros
def test_two_rigs_side_by_side_simulate_each_its_own_elevation(
        heard: Client, record, bag: Path, bag_root: Path, ros_domain: int, tmp_path: Path,
        ) -> None:
    steep = write_bag(bag_root / 'steep', TestMetadata('dynamic', 70.0), record.stamps,
                      record.load, record.probe_stamps, record.gaps, default_rig().probes)
    bags = {'/rig1': bag, '/rig2': steep}
    statuses: dict[str, str] = {}

    def hear(message: DiagnosticArray) -> None:
        statuses.update((status.name, status.hardware_id) for status in message.status)

    progress: dict[str, ReplayProgress] = {}
    with heard.lock:
        heard.node.create_subscription(DiagnosticArray, '/diagnostics', hear, 100)
        flows = {space: RawSubscription(heard.node, f'{space}/{SIMULATED}', RingDisplacement)
                 for space in bags}
        for space in bags:
            def note(said: ReplayProgress, space: str = space) -> None:
                if said.node == 'ring_simulator':
                    progress[space] = said

            heard.node.create_subscription(ReplayProgress, f'{space}/{PROGRESS}', note, 100)
    expected = {space: simulated(path) for space, path in bags.items()}
    with ExitStack() as stack:
        groups = {space: stack.enter_context(start_nodes(
            path, namespace=space, domain_id=ros_domain, log_folder=tmp_path / space[1:],
            start_paused=True, nodes=('ring_simulator',))) for space, path in bags.items()}
        wait_until(lambda: all(flow.publishers() for flow in flows.values())
                   and len(progress) == 2
                   and all(said.subscriptions[0] for said in progress.values()), 80.0, 'matched')
        for space, group in groups.items():
            assert heard.call(Trigger, f'{space}/replay_clock/play').success
            assert group.wait('replay_clock', 80.0) == 0
        raw: dict[str, list[bytes]] = {space: [] for space in bags}

        def has_come(space: str) -> bool:
            with heard.lock:
                raw[space] += flows[space].take()
            return len(raw[space]) == len(expected[space].T)

        for space in bags:
            wait_until(lambda space=space: has_come(space), what=f'every state of {space}')
            wait_until(lambda space=space: f'{space}/ring_simulator: zero' in statuses)
        with heard.lock:
            nobody = not heard.node.get_publishers_info_by_topic(f'/{SIMULATED}')
    assert nobody
    for space in bags:
        assert np.array_equal(decode_displacements(raw[space]).channels, expected[space])
        assert statuses[f'{space}/ring_simulator: zero'] == f'saddlering{space}'


OWN, OTHERS = {
    '': ('ring_displacement: zero', 'daq: temperature', '/daq: temperature'),
    '/rig1': ('/rig1/ring_displacement: zero', '/rig1/left/daq: x', 'daq: temperature'),
}, {
    '': ('/rig1/ring_displacement: zero', '/rig2/daq: temperature'),
    '/rig1': ('/rig10/ring_displacement: zero', '/rig2/daq: temperature', 'ring_alarm: alarm')}


@pytest.mark.ros
@pytest.mark.parametrize('space', ['', '/rig1'])
def test_a_bag_of_one_rig_holds_no_status_of_another(space, ros_domain, tmp_path) -> None:
    with recording(tmp_path / 'bag', ros_domain, namespace=space) as recorder:
        [flow] = [one for one in recorder.subscriptions if one.topic_name == '/diagnostics']
        for name in (*OWN[space], *OTHERS[space]):
            flow.callback(serialize_message(
                DiagnosticArray(status=[DiagnosticStatus(name=name)])))
    with AnyReader([tmp_path / 'bag']) as reader:
        told = [reader.deserialize(data, item.msgtype).status[0].name
                for item, _, data in reader.messages() if item.topic == '/diagnostics']
    assert tuple(told) == OWN[space]


@pytest.mark.ros
def test_the_displaced_ring_is_a_transform_below_the_frame_of_its_rig(group, heard, record):
    kind = pytest.importorskip('tf2_msgs.msg', reason='tf2_msgs is not published as a wheel')
    told: list = []
    with heard.lock:
        heard.node.create_subscription(kind.TFMessage, '/tf', told.append, 1000)
        driver = Driver(heard)
    group.start('ring_displacement', {'frame_id': 'rig1/ring',
                                      'displaced_frame_id': 'rig1/ring_displaced'})
    wait_until(lambda: driver.matched(1) and heard.node.count_publishers('/tf'), what='matched')
    driver.send(record)
    wait_until(lambda: len(told) > 2, what='transforms')
    [transform] = told[-1].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == (
        'rig1/ring', 'rig1/ring_displaced')
    found = heard.heard('/ring/displacement')
    stamp = transform.header.stamp.sec * 10**9 + transform.header.stamp.nanosec
    row = int(np.flatnonzero(found.stamps == stamp)[0])
    moved = transform.transform
    np.testing.assert_array_equal([moved.translation.x, moved.translation.y],
                                  found.channels[:2, row])
    assert moved.rotation.z == pytest.approx(-found.channels[2, row] / 2.0, rel=1e-6)
