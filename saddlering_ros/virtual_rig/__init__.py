"""The virtual rig: bags as a rig would record them, by physics of its own (not ring/'s)."""

# The modules of effects enter their effects into EFFECTS when imported.
from saddlering_ros.errors import VirtualRigError
from saddlering_ros.virtual_rig import effects_load, effects_probes, effects_ring
from saddlering_ros.virtual_rig.effects import (
    EffectRequest,
    EFFECTS,
    find_effect,
    parse_requests,
    request,
    RigEffect,
    TrueSize,
)
from saddlering_ros.virtual_rig.integrator import make_rollers, Rollers, Scatter
from saddlering_ros.virtual_rig.physics import PhysicalRig, PhysicalRun, run_test
from saddlering_ros.virtual_rig.recording import (
    Instruments,
    record_test,
    TestPlan,
    TestRecord,
    write_record,
)
from saddlering_ros.virtual_rig.schedule import (
    controlled_load,
    dynamic_schedule,
    Schedule,
    static_schedule,
)

__all__ = [
    'EFFECTS', 'EffectRequest', 'Instruments', 'PhysicalRig', 'PhysicalRun', 'RigEffect',
    'Rollers', 'Scatter', 'Schedule', 'TestPlan', 'TestRecord', 'TrueSize', 'VirtualRigError',
    'controlled_load', 'dynamic_schedule', 'effects_load', 'effects_probes', 'effects_ring',
    'find_effect', 'make_rollers', 'parse_requests', 'record_test', 'request', 'run_test',
    'static_schedule', 'write_record',
]
