"""What /ring/parameters says: the simulator's own in force, what others offer, and who follows."""

from dataclasses import replace

from builtin_interfaces.msg import Time
import numpy as np
import pytest
from rosnet import client, Driver, wait_until

from saddlering_interfaces.msg import RingParameters
from saddlering_ros.rig import ParameterSet, ParameterSource, TRUE_TO_SCALE, write_parameters
from saddlering_ros.ros.raw_topics import LATCHED_BY_SEVERAL

pytestmark = pytest.mark.ros
TOPIC = '/ring/parameters'
SIMULATED = '/ring/simulated_displacement'
JOINERS = 6


def test_the_simulator_tells_every_late_joiner_what_it_simulates_with(group, heard, ros_domain):
    group.start('ring_simulator')
    wait_until(lambda: 'ring_simulator' in heard.progress, 80.0, 'it runs')
    for _ in range(JOINERS):
        with client(ros_domain) as joiner:
            said = joiner.listen(RingParameters, TOPIC)
            wait_until(lambda said=said: bool(said), what='the parameters in force')
            assert said[0].k1 == TRUE_TO_SCALE.K1
            assert said[0].applied_by == '/ring_simulator'
            assert 'true to scale' in said[0].source


def test_a_parameter_file_is_taken_as_any_ros_parameters_are(group, heard, tmp_path) -> None:
    found = ParameterSet(
        replace(TRUE_TO_SCALE, K1=7.0e7),
        {'radial_friction': {'force': 4000.0, 'presliding': 2e-6, 'sharpness': 0.5,
                             'initial': 0.0}},
        ParameterSource('diagnose', ('static_50',), covariance=np.eye(6), note='from a test'))
    path = tmp_path / 'found.yaml'
    write_parameters(path, found)
    said = heard.listen(RingParameters, TOPIC)
    group.start('ring_simulator', files=[path])
    wait_until(lambda: bool(in_force(said)), 80.0, 'the parameters in force')
    assert in_force(said)[-1].k1 == 7.0e7
    assert 'radial_friction.force' in in_force(said)[-1].effect_parameter_names
    assert 'from a test' in in_force(said)[-1].source


def test_a_following_simulator_takes_what_is_offered_and_not_what_another_one_has(group, heard):
    with heard.lock:
        offer = heard.node.create_publisher(RingParameters, TOPIC, LATCHED_BY_SEVERAL)

    def offered(second: int, k1: float, **others: str) -> None:
        with heard.lock:
            offer.publish(message(second, k1=k1, **others))

    def taken(second: int, k1: float) -> None:
        offered(second, k1)
        wait_until(lambda: in_force(said)[-1].k1 == k1, what=f'{k1} in force')

    def refused(words: str, second: int, k1: float = 3.0e10, **others: str) -> None:
        offered(second, k1, **others)
        wait_until(lambda: words in group.processes['ring_simulator'].said(), what=words)

    offered(1, 2.0e10)  # before there is anyone to hear it
    said = heard.listen(RingParameters, TOPIC)
    group.start('ring_simulator', {'follow_parameters': True})
    wait_until(lambda: bool(in_force(said)) and in_force(said)[-1].k1 == 2.0e10, 80.0,
               'it follows what was offered before it started')
    offered(2, 3.0e10, applied_by='/another_simulator')
    refused('refused', 3, k1=-1.0)
    refused('belong to the rig', 3, rig_hash='another')
    taken(4, 4.0e10)
    refused('lies in the future', 2**31 - 1)  # 2038: it blocks no later one
    taken(5, 5.0e10)
    taken(0, 6.0e10)  # as `ros2 topic pub` stamps it: counts as now
    refused('older than', 6)
    # Its own parameters were in force first, if the offer came later than its start.
    assert {one.k1 for one in in_force(said)} - {TRUE_TO_SCALE.K1} == {2e10, 4e10, 5e10, 6e10}


def test_the_parameters_it_has_already_do_not_restart_a_simulation(record, group, heard) -> None:
    with heard.lock:
        offer = heard.node.create_publisher(RingParameters, TOPIC, LATCHED_BY_SEVERAL)
    said, driver = heard.listen(RingParameters, TOPIC), Driver(heard)
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
