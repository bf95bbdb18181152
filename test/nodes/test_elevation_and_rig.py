"""One elevation and one rig for all nodes: followed where they are known, else an error."""

import math
from pathlib import Path
import time

from geometry_msgs.msg import Vector3, Vector3Stamped
import numpy as np
import pytest
import rclpy
from rosnet import ACTIVATE, ANEW, Client, client, DEACTIVATE, lead, set_parameter, wait_until
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import Elevation, ReplayState, RingParameters
from saddlering_ros.bags.write import write_bag
from saddlering_ros.files import share_directory
from saddlering_ros.nodes.ring_simulator import RingSimulatorNode
from saddlering_ros.record.batches import Displacements
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.residual import ResidualStream, SimulationStream
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ros.launcher import NodeGroup
from saddlering_ros.ros.raw_topics import LATCHED


@pytest.mark.ros
def test_the_simulator_follows_the_bag_and_refuses_what_contradicts_it(
        group: NodeGroup, heard: Client, record, bag: Path, bag_root: Path, tmp_path: Path,
        ros_domain: int) -> None:
    steep = write_bag(bag_root / 'steeper', TestMetadata('dynamic', 70.0), record.stamps,
                      record.load, record.probe_stamps, record.gaps, default_rig().probes)
    said = heard.listen(RingParameters, '/ring/parameters')
    shipped = share_directory() / 'config' / 'rig.yaml'
    other = tmp_path / 'other.yaml'
    other.write_text(shipped.read_text().replace('axial_span: 1.30', 'axial_span: 1.20'))
    group.start('ring_simulator')
    group.start('ring_residual', files=[other])
    group.start('replay_clock', {'bag': str(bag), 'start_paused': True,
                                 'participants': ['nobody']})
    wait_until(lambda: bool(said), 80.0, 'the simulator tells its parameters')
    assert said[-1].applied_by == '/ring_simulator'
    assert said[-1].rig_hash == default_rig().digest

    # Another bag, swapped in by lifecycle: the simulator goes on at its elevation.
    assert set_parameter(heard, 'replay_clock', 'bag', str(steep)).successful
    heard.forget()
    wait_until(lambda: 'replay_clock: replay' in heard.diagnostics, what='a report')
    assert heard.figures['replay_clock: replay']['bag'] == bag.name
    lead(heard, 'replay_clock', *ANEW)
    wait_until(lambda: math.isclose(said[-1].elevation, math.radians(70.0)), what='70 deg')
    refused = set_parameter(heard, 'ring_simulator', 'elevation_deg', 50.0)
    assert not refused.successful
    assert 'deactivate first' in refused.reason

    # An elevation that is set contradicts it: an error, and nothing is simulated.
    lead(heard, 'ring_simulator', DEACTIVATE)
    answer = heard.call(Trigger, '/ring_simulator/zero')
    assert not answer.success
    assert answer.message == 'is not active: ros2 lifecycle set /ring_simulator activate'
    assert set_parameter(heard, 'ring_simulator', 'elevation_deg', 50.0).successful
    lead(heard, 'ring_simulator', ACTIVATE)
    assert math.isclose(latched(ros_domain).elevation, math.radians(50.0))
    wait_until(lambda: heard.diagnostics.get('ring_simulator: elevation', (0, ''))[0] == 2,
               what='an error')
    assert '70.00 deg, and 50.00 deg is set' in heard.diagnostics['ring_simulator: elevation'][1]

    # The residual was given another rig file.
    for node in ('ring_simulator', 'ring_residual'):
        wait_until(lambda node=node: heard.diagnostics.get(f'{node}: rig', (0, ''))[0] == 2,
                   what='the rigs differ')
    assert '/ring_residual' in heard.diagnostics['ring_simulator: rig'][1]


def latched(domain: int) -> RingParameters:
    """What somebody who joins now hears of the parameters first, as by `ros2 topic echo`."""
    with client(domain) as joiner:
        said = joiner.listen(RingParameters, '/ring/parameters', LATCHED)
        wait_until(lambda: bool(said), what='the latched parameters')
    return said[0]


@pytest.mark.ros
def test_a_simulator_without_a_configuration_outlives_news_and_warns_of_degrees() -> None:
    rclpy.init(args=['', '--ros-args', '-p', 'bag:=/nowhere'])
    node = RingSimulatorNode()
    try:
        node.trigger_configure()
        assert 'nowhere' in str(node.problem)
        node._watch._on_state(ReplayState(elevation=math.radians(70.0)))
        assert node._watch.of_bag == pytest.approx(math.radians(70.0))
        node._watch._on_measured(30.0)  # degrees: the last elevation counts, with a warning
        node._elevation = node._watch.of_bag
        node._stream = SimulationStream(
            default_rig(), ParameterSet(TRUE_TO_SCALE), node._elevation)
        assert node._elevation_status().level == 1
        assert 'reads 30 rad' in node._elevation_status().words
        node._watch._on_measured(math.radians(70.0))
        assert node._elevation_status().level == 0
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.ros
def test_inclinometers_that_disagree_stop_or_fail_are_told_and_restart_nothing() -> None:
    rclpy.init(args=[''])
    node = RingSimulatorNode()
    node.trigger_configure()
    first = node.create_publisher(Vector3Stamped, 'rig/elevation', 10)
    second = node.create_publisher(Elevation, 'rig/inclinometer', 10)
    streams = [node._stream]

    def told(words: str, one: float, other: float = 0.0) -> int:
        """Level of the status when it has the words, while inclinometers read [deg]; 0: none."""
        def is_told() -> bool:
            if one:
                first.publish(Vector3Stamped(vector=Vector3(x=math.radians(one))))
            if other:
                second.publish(Elevation(elevation=math.radians(other)))
            rclpy.spin_once(node, timeout_sec=0.02)
            streams.extend([node._stream] if node._stream is not streams[-1] else [])
            return words in node._elevation_status().words
        wait_until(is_told, 20.0, words)
        return node._elevation_status().level

    try:
        both = ('rig/inclinometer measures 50.00 deg, and 53.00 deg is measured by '
                'rig/elevation: stop the wrong one')
        assert all(told(both, 53.0, 50.0) == 2 for _ in range(30))
        assert len(streams) <= 3, 'restarts for the first readings only'
        node.destroy_publisher(second)
        assert [told('53.000 deg, measured', 53.0) for _ in range(30)] == [0] * 30
        node._arrivals.last = time.monotonic() + 10.0  # the load goes on
        assert told('the inclinometer has stopped', 0.0) == 1
        node._arrivals.last = 0.0
        assert told('reads nan rad, which no barrel has: see to it', math.nan) == 1
        assert math.isclose(node._elevation, math.radians(53.0))
        assert len(streams) <= 3
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_displacements_at_different_elevations_are_not_subtracted() -> None:
    stamps = np.arange(1, 11)

    def side(degrees: float) -> Displacements:
        return Displacements.from_zero(
            stamps, np.ones((4, 10)), (5, 5), 100.0, np.radians(degrees))

    join = ResidualStream(FULL_SCALE_LOAD)
    assert len(join.push(side(50.0), side(70.0))) == 0
    assert join.counters.elevation_differs == 10
    assert not join.elevations_agree
    join = ResidualStream(FULL_SCALE_LOAD)
    found = join.push(side(math.nan), side(70.0))
    assert np.allclose(found.elevations, np.radians(70.0))
