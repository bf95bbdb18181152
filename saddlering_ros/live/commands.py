"""Commands of the page to the nodes: zero, start and pause, each a service of one node."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

SERVICES = {'zero': 'ring_displacement/zero', 'start': 'replay_clock/play',
            'pause': 'replay_clock/pause'}
"""Relative names: in the namespace of the page's node."""


class Commands:
    """Clients of the services, and the last answer of each."""

    def __init__(self, node: Node) -> None:
        self._clients = {name: node.create_client(Trigger, path)
                         for name, path in SERVICES.items()}
        self._answers: dict[str, str] = {}

    def ask(self, name: str) -> bool:
        """Call a service without waiting for it; whether it has a server."""
        client = self._clients[name]
        if not client.service_is_ready():
            self._answers[name] = 'no node offers it now'
            return False
        self._answers[name] = 'asked'
        client.call_async(Trigger.Request()).add_done_callback(
            lambda future: self._note(name, future))
        return True

    def as_page(self) -> dict[str, dict[str, Any]]:
        """By command: whether a node offers it, and its last answer."""
        return {name: {'ready': bool(client.service_is_ready()),
                       'words': self._answers.get(name, '')}
                for name, client in self._clients.items()}

    def _note(self, name: str, future: Any) -> None:
        answer = future.result()
        self._answers[name] = str(answer.message) or ('done' if answer.success else 'refused')
