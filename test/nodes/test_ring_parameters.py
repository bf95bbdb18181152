"""What /ring/parameters says: the simulator's own in force, what others offer, and who follows."""

from dataclasses import replace
from pathlib import Path

from builtin_interfaces.msg import Time
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosnet import Client, client, Driver, wait_until

from saddlering_interfaces.msg import RingParameters
from saddlering_ros.rig import ParameterSet, ParameterSource, TRUE_TO_SCALE, write_parameters
from saddlering_ros.ros.launcher import NodeGroup

pytestmark = pytest.mark.ros
TOPIC = '/ring/parameters'
SIMULATED = '/ring/simulated_displacement'
LATCHED = QoSProfile(depth=20, durability=DurabilityPolicy.TRANSIENT_LOCAL)
JOINERS = 6


def listen(one: Client) -> list[RingParameters]:
    said: list[RingParameters] = []
    with one.lock:
        one.node.create_subscription(RingParameters, TOPIC, said.append, LATCHED)
    return said


def test_the_simulator_tells_every_late_joiner_what_it_simulates_with(
        group: NodeGroup, heard: Client, ros_domain: int) -> None:
    group.start('ring_simulator')
    wait_until(lambda: 'ring_simulator' in heard.progress, 80.0, 'it runs')
    for _ in range(JOINERS):
        with client(ros_domain) as joiner:
            said = listen(joiner)
            wait_until(lambda said=said: bool(said), what='the parameters in force')
            assert said[0].k1 == TRUE_TO_SCALE.K1
            assert said[0].applied_by == '/ring_simulator'
            assert 'true to scale' in said[0].source


def test_a_parameter_file_is_taken_as_any_ros_parameters_are(
        group: NodeGroup, heard: Client, tmp_path: Path) -> None:
    found = ParameterSet(
        replace(TRUE_TO_SCALE, K1=7.0e7),
        {'radial_friction': {'force': 4000.0, 'presliding': 2e-6, 'sharpness': 0.5,
                             'initial': 0.0}},
        ParameterSource('diagnose', ('static_50',), covariance=np.eye(6), note='from a test'))
    path = tmp_path / 'found.yaml'
    write_parameters(path, found)
    said = listen(heard)
    group.start('ring_simulator', files=[path])
    wait_until(lambda: bool(in_force(said)), 80.0, 'the parameters in force')
    assert in_force(said)[-1].k1 == 7.0e7
    assert 'radial_friction.force' in in_force(said)[-1].effect_parameter_names
    assert 'from a test' in in_force(said)[-1].source


def test_a_following_simulator_takes_what_is_offered_and_not_what_another_one_has(
        group: NodeGroup, heard: Client) -> None:
    with heard.lock:
        offer = heard.node.create_publisher(RingParameters, TOPIC, LATCHED)
        offer.publish(message(1, k1=2.0e10))  # before there is anyone to hear it
    said = listen(heard)
    group.start('ring_simulator', {'follow_parameters': True})
    wait_until(lambda: bool(in_force(said)) and in_force(said)[-1].k1 == 2.0e10, 80.0,
               'it follows what was offered before it started')
    with heard.lock:
        offer.publish(message(2, k1=3.0e10, applied_by='/another_simulator'))
    with heard.lock:
        offer.publish(message(3, k1=-1.0))
    wait_until(lambda: 'refused' in group.processes['ring_simulator'].said(), what='it refuses')
    with heard.lock:
        offer.publish(message(3, k1=3.0e10, rig_hash='another'))
    wait_until(lambda: 'belong to the rig' in group.processes['ring_simulator'].said(),
               what='one of another rig')
    with heard.lock:
        offer.publish(message(4, k1=4.0e10))
    wait_until(lambda: in_force(said)[-1].k1 == 4.0e10, what='it follows the new offer')
    with heard.lock:
        offer.publish(message(2**31 - 1, k1=3.0e10))  # 2038: refused, and blocks no later one
    wait_until(lambda: 'lies in the future' in group.processes['ring_simulator'].said(),
               what='it refuses the future')
    with heard.lock:
        offer.publish(message(5, k1=5.0e10))
    wait_until(lambda: in_force(said)[-1].k1 == 5.0e10, what='a good one after that')
    with heard.lock:
        offer.publish(message(0, k1=6.0e10))  # as `ros2 topic pub` stamps it
    wait_until(lambda: in_force(said)[-1].k1 == 6.0e10, what='one without a stamp counts as now')
    with heard.lock:
        offer.publish(message(6, k1=3.0e10))
    wait_until(lambda: 'older than' in group.processes['ring_simulator'].said(), what='an old one')
    # Its own parameters were in force first, if the offer came later than its start.
    assert {one.k1 for one in in_force(said)} - {TRUE_TO_SCALE.K1} == {2e10, 4e10, 5e10, 6e10}


def test_the_parameters_it_has_already_do_not_restart_a_simulation(
        record, group: NodeGroup, heard: Client) -> None:
    with heard.lock:
        offer = heard.node.create_publisher(RingParameters, TOPIC, LATCHED)
    said, driver = listen(heard), Driver(heard)
    group.start('ring_simulator', {'follow_parameters': True})
    wait_until(lambda: bool(driver.load.subscriptions() and heard.matched((SIMULATED,))
                            and offer.get_subscription_count() >= 2), 80.0, 'it is matched')
    driver.send_load(record.stamps[:1000], record.load[:1000])
    wait_until(lambda: len(heard.raw[SIMULATED]) == 1000, what='the first half')
    with heard.lock:
        offer.publish(message(1, k1=TRUE_TO_SCALE.K1))
    wait_until(lambda: 'test' in said[-1].source and bool(said[-1].applied_by), what='it heard')
    driver.send_load(record.stamps[1000:], record.load[1000:])
    wait_until(lambda: len(heard.raw[SIMULATED]) == 2000, what='the second half, under load')
    zeros = heard.heard(SIMULATED).zero_stamps
    assert (zeros == zeros[0]).all()


def in_force(said: list[RingParameters]) -> list[RingParameters]:
    return [one for one in said if one.applied_by == '/ring_simulator']


def message(second: int, *, k1: float, applied_by: str = '', rig_hash: str = '',
            ) -> RingParameters:
    found = TRUE_TO_SCALE
    result = RingParameters(k1=k1, n1=found.n1, d1=found.D1, k2=found.K2, n2=found.n2,
                            d2=found.D2, source='test', applied_by=applied_by, rig_hash=rig_hash)
    result.header.stamp = Time(sec=second)
    return result
