"""The virtual rig: bags as a rig would record them, by physics of its own (not ring/'s)."""

# The modules of effects enter their effects into EFFECTS when imported.
from saddlering_ros.virtual_rig import effects_probes, effects_ring

__all__ = ['effects_probes', 'effects_ring']
