"""ROS domains that tests lease, so that no two runs on one machine hear each other."""

import os
import socket

from saddlering_ros.ros.launcher import participants

DOMAINS = range(1, 101)
"""Domains whose ports lie below Linux's range for outgoing connections (32768 and up)."""


class DomainLease:
    """A ROS domain that nobody else on this machine holds, for as long as it is open.

    Another run of these tests is kept out by a lock on an abstract socket of the domain's name,
    any other ROS, and what an earlier test has left, by the ports of discovery.
    """

    def __init__(self) -> None:
        self.number, self._lock = _lease()

    def close(self) -> None:
        self._lock.close()


def _lease() -> tuple[int, socket.socket]:
    start = os.getpid() % len(DOMAINS)
    for domain in [*DOMAINS[start:], *DOMAINS[:start]]:
        if participants(domain):
            continue
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            lock.bind(f'\0saddlering_ros-test-domain-{domain}')
        except OSError:
            lock.close()
            continue
        return domain, lock
    raise RuntimeError('every ROS domain from 1 to 100 is in use on this machine')
