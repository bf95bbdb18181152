"""Node ring_residual: measured minus simulated displacement, of equal stamps and zeros only."""

import time

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np

from saddlering_interfaces.msg import RingDisplacement
from saddlering_ros.bags.wire import covariance_of, decode_displacements, encode_displacements
from saddlering_ros.errors import counted
from saddlering_ros.record.residual import ResidualStream
from saddlering_ros.rig import CHANNELS
from saddlering_ros.ros import diagnostics, streaming_node
from saddlering_ros.ros.diagnostics import ERROR, OK, TaskStatus, WARN
from saddlering_ros.ros.names import DIAGNOSTICS, DISPLACEMENT, names, RESIDUAL, RING, SIMULATED
from saddlering_ros.ros.parameters import NodeParameter
from saddlering_ros.ros.raw_topics import RawPublisher, RawSubscription
from saddlering_ros.ros.rig_state import Readiness


class RingResidualNode(streaming_node.StreamingNode):
    """Joins both displacements by stamp and publishes /ring/residual."""

    PARAMETERS = (
        streaming_node.INPUT_RELIABILITY, streaming_node.DISPLACEMENT_FRAME,
        NodeParameter('needed_nodes', list(names(RING)), 'nodes that must be active and report '
                      'nothing but OK for the status `ready to test`'),
    )

    def __init__(self) -> None:
        super().__init__('ring_residual')
        prefix = f'{self.get_namespace()}/'.replace('//', '')
        self._readiness = Readiness([
            f'{prefix}{name}' for name in self.settings['needed_nodes'] if name])
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 100)

    def configure(self) -> None:
        self._stream = ResidualStream(self._rig.full_scale_load)
        self._streams = [diagnostics.StreamTask(f'/{topic}')
                         for topic in (DISPLACEMENT, SIMULATED)]
        self._awaited = 0
        self._sizes = diagnostics.Kept()
        self.tasks = [*self._streams, diagnostics.FunctionTask('zero', self._zero_status),
                      diagnostics.FunctionTask('residual', self._residual_status),
                      self._agreement, self.sources(),
                      diagnostics.Events(lambda: vars(self._stream.counters)), self._readiness]

    def connect(self) -> None:
        wanted = self.settings['input_reliability']
        self.inputs = [
            RawSubscription(self, topic, RingDisplacement, reliability=wanted, task=task)
            for topic, task in zip((DISPLACEMENT, SIMULATED), self._streams, strict=True)]
        self.outputs = [RawPublisher(self, RESIDUAL, RingDisplacement)]

    def awaited(self) -> list[RawSubscription]:
        """The side without which no residual comes, or the one that came last before."""
        return [self.inputs[self._awaited]] if self.inputs else []

    def process_batch(self) -> None:
        measured, simulated = (flow.take_as(decode_displacements) for flow in self.inputs)
        residual = self._stream.push(measured, simulated)
        missing = [not count for count in self._stream.waiting]
        if not all(missing):
            self._awaited = missing.index(True) if any(missing) else 0
        if len(residual):
            self._sizes.push(residual.channels.ravel('F'))
            covariance = sum(covariance_of(flow.newest) for flow in self.inputs)
            self.outputs[0].send(encode_displacements(residual, self.settings['frame_id'],
                                                      np.asarray(covariance)),
                                 int(residual.stamps[-1]))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._readiness.hear(status.name, status.level[0], status.message, time.monotonic())

    def _zero_status(self) -> TaskStatus:
        measured, simulated = self._stream.waiting
        figures = {'measured waiting': str(measured), 'simulated waiting': str(simulated)}
        if not self._stream.elevations_agree:
            return TaskStatus(ERROR, 'measured and simulated are at different elevations and are '
                              'not subtracted: correct elevation_deg of one of them', figures)
        if not self._stream.zeros_agree:
            return TaskStatus(WARN, 'measured and simulated have different zeros and are not '
                                    'subtracted: call /ring_displacement/zero', figures)
        return TaskStatus(OK, 'measured and simulated have the same zero', figures)

    def _residual_status(self) -> TaskStatus:
        """Number and root mean squares of the residuals of the period."""
        numbers = self._sizes.taken().reshape(-1, len(CHANNELS))
        counts = np.isfinite(numbers).sum(axis=0)
        if not counts.any():
            return TaskStatus(OK, 'no residual in this period')
        rms = np.sqrt(np.nansum(numbers ** 2, axis=0) / np.maximum(counts, 1))
        return TaskStatus(OK, counted(int(counts.max()), 'residual'), {
            f'rms {name} [{"urad" if name == "gamma" else "um"}]': f'{value * 1e6:.3f}'
            for name, value in zip(CHANNELS, rms.tolist(), strict=True)})


main = streaming_node.executable(RingResidualNode)

if __name__ == '__main__':
    main()
