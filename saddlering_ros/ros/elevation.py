"""The elevation of the load: its sources in order, and contradictions between them.

The first that is known counts: the node's own setting, the bag that is replayed (replay/state),
the bag that the node was started with, the inclinometer (rig/elevation).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

from geometry_msgs.msg import Vector3Stamped
from rclpy.node import Node

from saddlering_interfaces.msg import ReplayState
from saddlering_ros.record.topics import ELEVATION
from saddlering_ros.ros.lockstep import to_stamp
from saddlering_ros.ros.names import STATE
from saddlering_ros.ros.qos import LATCHED, OF_ANY_SENSOR
from saddlering_ros.streams.batches import ANY_TIME

SAME_BAG = math.radians(0.01)
"""Elevations of a setting and of a bag that differ by more contradict each other."""

SAME_MEASURED = math.radians(0.5)
"""An inclinometer that differs by more from the elevation in use contradicts it."""

MOVED = math.radians(0.1)
"""The elevation of the inclinometer is read again when it has moved by this."""

LOWEST, HIGHEST = math.radians(-10.0), math.radians(90.0)


@dataclass(frozen=True)
class Elevation:
    """An elevation [rad] (NaN: not known) and where it comes from, in words."""

    value: float
    source: str


class ElevationWatch:
    """Hears of the elevation on replay/state and rig/elevation; `on_news` is called on changes.

    recording: first and last stamp [ns] of the bag that is replayed, or ANY_TIME.
    """

    def __init__(self, node: Node, on_news: Callable[[], None] = lambda: None) -> None:
        self.of_bag = self.measured = math.nan
        self.recording = ANY_TIME
        self.impossible = 0
        self._on_news = on_news
        node.create_subscription(ReplayState, STATE, self._on_state, LATCHED)
        node.create_subscription(Vector3Stamped, ELEVATION.relative, self._on_measured,
                                 OF_ANY_SENSOR)

    def resolve(self, given: float = math.nan, started_with: float = math.nan) -> Elevation:
        """The elevation that counts; given, started_with: setting and first bag [rad], or NaN."""
        sources = ((given, 'set'), (self.of_bag, 'of the replayed bag'),
                   (started_with, 'of the given bag'), (self.measured, 'measured'))
        for value, source in sources:
            if not math.isnan(value):
                return Elevation(value, source)
        return Elevation(math.nan, 'not known')

    def contradiction(self, used: float) -> str:
        """Contradiction to the elevation in use [rad], in words; '' if there is none."""
        for value, limit, whose in ((self.of_bag, SAME_BAG, 'the replayed bag has'),
                                    (self.measured, SAME_MEASURED, 'rig/elevation measures')):
            if abs(value - used) > limit:  # False for NaN
                return (f'{whose} {math.degrees(value):.2f} deg, and '
                        f'{math.degrees(used):.2f} deg is set: correct elevation_deg')
        return ''

    def _on_state(self, message: ReplayState) -> None:
        self.recording = to_stamp(message.start), to_stamp(message.end)
        value = float(message.elevation)
        if value != self.of_bag and not (math.isnan(value) and math.isnan(self.of_bag)):
            self.of_bag = value
            self._on_news()

    def _on_measured(self, message: Vector3Stamped) -> None:
        value = float(message.vector.x)
        if not LOWEST <= value <= HIGHEST:
            self.impossible += 1
            return
        if math.isnan(self.measured) or abs(value - self.measured) > MOVED:
            self.measured = value
            self._on_news()
