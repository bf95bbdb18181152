"""Whether all nodes of a namespace were given one rig, by the hash that each publishes."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from saddlering_ros.rig import Rig
from saddlering_ros.rig.description import short_digest
from saddlering_ros.ros.diagnostics import ERROR, Finding, OK
from saddlering_ros.ros.names import RIG
from saddlering_ros.ros.qos import LATCHED, LATCHED_BY_SEVERAL


class RigAgreement:
    """The diagnostics task `rig`: the hash of the node's rig, and who has another."""

    name = 'rig'

    def __init__(self, node: Node, rig: Rig) -> None:
        self._node = node
        self.digest = rig.digest
        self._others: dict[str, str] = {}
        self._publisher = node.create_publisher(DiagnosticStatus, RIG, LATCHED)
        node.create_subscription(DiagnosticStatus, RIG, self._hear, LATCHED_BY_SEVERAL)
        self._publisher.publish(DiagnosticStatus(
            name=node.get_fully_qualified_name(), message=self.digest))
        node.get_logger().info(f'rig {short_digest(self.digest)}')

    def _hear(self, message: DiagnosticStatus) -> None:
        self._others[message.name] = message.message

    def report(self, elapsed: float) -> Finding:
        """Who of the nodes that are there has another rig."""
        there = {f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                 for info in self._node.get_publishers_info_by_topic(
                     self._node.resolve_topic_name(RIG))}
        figures = {'rig hash': self.digest}
        others = {name: digest for name, digest in sorted(self._others.items())
                  if digest != self.digest and name in there}
        if others:
            words = ', '.join(f'{name} ({short_digest(digest)})'
                              for name, digest in others.items())
            return Finding(ERROR, f'this node has rig {short_digest(self.digest)}, and others '
                           f'have another, {words}: give all nodes the same rig file', figures)
        return Finding(OK, f'rig {short_digest(self.digest)}', figures)
