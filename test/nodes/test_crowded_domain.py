"""Claims about ROS programs that do not find each other on one machine: it is said."""

import pytest

from saddlering_ros.ros.launcher import crowded_words, MAX_LOCAL, participants

HEAD = '  sl  local_address rem_address   st tx_queue rx_queue\n'


def table(*ports: int) -> str:
    return HEAD + ''.join(f'  1: 00000000:{port:04X} 00000000:0000 07 0:0\n' for port in ports)


def test_programs_are_counted_by_their_ports_of_discovery() -> None:
    of_domain_3 = [7400 + 750 + 10 + 2 * number for number in range(33)]
    others = [7400 + 750, 7400 + 750 + 11, 7410, 7400 + 1000 + 10]
    assert participants(3, table(*of_domain_3, *others)) == 33


@pytest.mark.parametrize(('count', 'range_', 'is_crowded'), [
    (MAX_LOCAL, 'LOCALHOST', False), (MAX_LOCAL + 1, 'LOCALHOST', True),
    (MAX_LOCAL + 1, 'SUBNET', False)])
def test_more_programs_than_find_each_other_are_reported(monkeypatch, count, range_, is_crowded):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', range_)
    assert bool(crowded_words(count, 3)) is is_crowded
