"""A node that collects the published displacements while a bag is replayed."""

from __future__ import annotations

from dataclasses import dataclass
import threading

from geometry_msgs.msg import WrenchStamped
import numpy as np
from numpy.typing import NDArray

from saddlering_interfaces.msg import RingDisplacement
from saddlering_ros.bags.messages import decode_displacements
from saddlering_ros.record import Record
from saddlering_ros.record.samples import Displacements, join
from saddlering_ros.record.topics import LOAD
from saddlering_ros.ros.names import DISPLACEMENTS
from saddlering_ros.ros.raw_topics import RawSubscription
from saddlering_ros.ros.streaming_node import StreamingNode

NAME = 'demo_recorder'


@dataclass(frozen=True)
class ReplayRecording:
    """Messages received during one replay: the batch of each topic, and the number of loads."""

    measured: Displacements
    simulated: Displacements
    residual: Displacements
    loads: int

    @property
    def messages(self) -> int:
        """Messages received."""
        return len(self.measured) + len(self.simulated) + len(self.residual) + self.loads

    def lost(self, run: Record) -> int:
        """Messages that the replay of `run` should have given and that did not come.

        Every load has a simulation, and every load at which a pair of probes reads has a
        displacement and a residual.
        """
        read = np.isfinite(run.gaps)
        known = int(((read[0] & read[2]) | (read[1] & read[3])).sum())
        return 2 * (len(run.time) + known) - self.messages

    def at(self, stamps: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Measured and simulated channels (4, N) at `stamps` [ns], NaN where none came."""
        return _placed(self.measured, stamps), _placed(self.simulated, stamps)


class DemoRecorder(StreamingNode):
    """Keeps displacements and loads; the clock in lockstep waits for it too."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self._lock = threading.Lock()
        self._clear()

    def connect(self) -> None:
        """Subscribe to the load and to everything about the ring."""
        self.inputs = [RawSubscription(self, topic, RingDisplacement) for topic in DISPLACEMENTS]
        self.inputs.append(RawSubscription(self, LOAD.relative, WrenchStamped))

    def process_batch(self) -> None:
        """Keep one batch."""
        with self._lock:
            for topic, flow in zip(DISPLACEMENTS, self.inputs, strict=False):
                batch = flow.take_as(decode_displacements)
                if len(batch):
                    flow.last_stamp = int(batch.stamps[-1])
                    self._kept[topic].append(batch)
            load = self.inputs[-1].take_samples(LOAD)
            if len(load):
                self.inputs[-1].last_stamp = int(load.stamps[-1])
                self._loads += len(load)

    def cut(self) -> ReplayRecording:
        """The messages since the last cut."""
        with self._lock:
            kept, loads = self._kept, self._loads
            self._clear()
        measured, simulated, residual = (join(kept[topic]) for topic in DISPLACEMENTS)
        return ReplayRecording(measured, simulated, residual, loads)

    def _clear(self) -> None:
        self._kept: dict[str, list[Displacements]] = {topic: [] for topic in DISPLACEMENTS}
        self._loads = 0


def _placed(batch: Displacements, stamps: NDArray[np.int64]) -> NDArray[np.float64]:
    placed = np.full((4, len(stamps)), np.nan)
    _, here, there = np.intersect1d(stamps, batch.stamps, return_indices=True)
    placed[:, here] = batch.channels[:, there]
    return placed
