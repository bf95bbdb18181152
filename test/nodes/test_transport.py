"""What the middleware drops is sent again at once, and the user's own settings of it stand."""

from __future__ import annotations

import signal
import time
import xml.etree.ElementTree

import numpy as np
import pytest
from rosnet import Client, Driver, wait_until

from saddlering_ros.nodes.launcher import environment, NodeGroup
from saddlering_ros.nodes.transport import PROFILE_VARIABLES, transport_environment
from saddlering_ros.rig import default_rig

QUEUE = 512
"""Packets the queue of a Fast DDS shared-memory port holds; what comes on top is dropped."""


@pytest.mark.ros
def test_a_reader_that_stood_still_has_everything_soon_after_it_goes_on(
        group: NodeGroup, heard: Client) -> None:
    driver = Driver(heard)
    simulator, residual = group.start('ring_simulator'), group.start('ring_residual')

    def matched() -> bool:
        """Both ways: what comes before a reader knows of its writer is not kept for it."""
        if not heard.progress.keys() >= {simulator.name, residual.name}:
            return False
        simulates, subtracts = heard.progress[simulator.name], heard.progress[residual.name]
        return bool(driver.load.subscriptions() and simulates.publishers[0]
                    and simulates.subscriptions[0] >= 2 and subtracts.publishers[1])

    wait_until(matched, 80.0, 'all are matched')

    def sent() -> int:
        return heard.progress[simulator.name].published[0]

    def received() -> int:
        return heard.progress[residual.name].received[1]

    stamps = 1_700_000_000_000_000_000 + 1_000_000 * np.arange(1000 + 5 * 2 * QUEUE)
    load = np.full(len(stamps), default_rig().preload)
    driver.send_load(stamps[:1000], load[:1000])
    wait_until(lambda: sent() == received() == 1000, what='the zero is found')
    late = []
    for start in range(1000, len(stamps), 2 * QUEUE):
        rows = slice(start, start + 2 * QUEUE)
        residual.process.send_signal(signal.SIGSTOP)
        driver.send_load(stamps[rows], load[rows])
        wait_until(lambda rows=rows: sent() == rows.stop, what='it is simulated')
        residual.process.send_signal(signal.SIGCONT)
        began = time.monotonic()
        wait_until(lambda rows=rows: received() == rows.stop, what='everything is received')
        late.append(time.monotonic() - began)
    assert max(late) < 1.5, late  # the middleware's default lets one in two wait for longer


def test_the_profile_is_one_fast_dds_can_read_and_gives_way_to_the_users(
        monkeypatch: pytest.MonkeyPatch) -> None:
    for name in PROFILE_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    path = transport_environment()[PROFILE_VARIABLES[0]]
    space = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'
    root = xml.etree.ElementTree.parse(path)

    def number(name: str) -> int:
        found = root.find(f'.//{space}{name.replace("/", f"/{space}")}')
        assert found is not None
        return int(found.text or 0)

    assert 0 < number('heartbeatPeriod/nanosec') <= 50_000_000
    assert number('leaseAnnouncement/sec') == 0
    monkeypatch.setenv(PROFILE_VARIABLES[1], '/the/users.xml')
    assert transport_environment() == {}
    assert PROFILE_VARIABLES[0] not in environment(1)
