"""The mechanics of the ring: contact, equilibrium, dynamics, tangents; compiled in `kernels/`."""

from saddlering_ros.ring.simulator import (
    dynamic_batch,
    probe_batch,
    RingSimulator,
    simulate,
    SimulatedRun,
    SimulationError,
    static_batch,
    static_response,
)

__all__ = [
    'RingSimulator', 'SimulatedRun', 'SimulationError', 'dynamic_batch',
    'probe_batch', 'simulate', 'static_batch', 'static_response',
]
