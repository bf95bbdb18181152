"""What the ring does: contact, equilibrium, dynamics; a readable reference and fast kernels."""

from saddlering_ros.ring.simulator import (
    dynamic_batch,
    probe_batch,
    RingSimulator,
    simulate,
    SimulatedRun,
    SimulatedSample,
    SimulationError,
    static_batch,
    static_response,
)

__all__ = [
    'RingSimulator', 'SimulatedRun', 'SimulatedSample', 'SimulationError', 'dynamic_batch',
    'probe_batch', 'simulate', 'static_batch', 'static_response',
]
