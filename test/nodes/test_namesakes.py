"""Two nodes of one name warn of each other: their topics would be mixed without a word."""

from pathlib import Path

import pytest
from rosnet import Client, wait_until

from saddlering_ros.ros.launcher import NodeGroup

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(('name', 'task'), [
    ('ring_displacement', 'state'), ('ring_identification', '/identify_ring')])
def test_two_nodes_of_one_name_warn_of_each_other_until_one_ends(
        name: str, task: str, group: NodeGroup, heard: Client, ros_domain: int,
        tmp_path: Path) -> None:
    def status() -> tuple[int, str]:
        return heard.diagnostics.get(f'{name}: {task}', (0, ''))

    first = group.start(name)
    wait_until(lambda: bool(status()[1]), what='the first reports')
    assert not status()[0]
    with NodeGroup(ros_domain, tmp_path / 'second') as other:
        second = other.start(name)
        for node in (first, second):
            wait_until(lambda: f'another node named /{name}' in node.said(),  # noqa: B023
                       what='both warn at their start')
        wait_until(lambda: 'runs twice' in status()[1], what='/diagnostics warns')
        assert status()[0] == 1
    wait_until(lambda: not status()[0], what='it is one node again')
