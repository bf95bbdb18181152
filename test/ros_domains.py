"""ROS domains that tests lease, so that no two runs on one machine hear each other."""

from __future__ import annotations

import os
import socket

DOMAINS = range(1, 101)
"""Domains whose ports lie below Linux's range for outgoing connections (32768 and up)."""

DISCOVERY_PORT = 7400
PORTS_PER_DOMAIN = 250


class DomainLease:
    """A ROS domain that nobody else on this machine holds, for as long as it is open.

    Another run of these tests is kept out by a lock on an abstract socket of the domain's name,
    any other ROS by looking whether the domain's discovery port is taken.
    """

    def __init__(self) -> None:
        self.number, self._lock = _lease()

    def close(self) -> None:
        self._lock.close()


def _lease() -> tuple[int, socket.socket]:
    start = os.getpid() % len(DOMAINS)
    for domain in [*DOMAINS[start:], *DOMAINS[:start]]:
        if _taken(domain):
            continue
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            lock.bind(f'\0saddlering_ros-test-domain-{domain}')
        except OSError:
            lock.close()
            continue
        return domain, lock
    raise RuntimeError('every ROS domain from 1 to 100 is in use on this machine')


def _taken(domain: int) -> bool:
    """Return whether some participant listens to the multicast discovery of `domain`."""
    port = DISCOVERY_PORT + PORTS_PER_DOMAIN * domain
    with open('/proc/net/udp') as table:
        return any(line.split()[1].endswith(f':{port:04X}') for line in list(table)[1:])
