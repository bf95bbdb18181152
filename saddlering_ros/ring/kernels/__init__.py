"""Compiled sums over rollers, equilibrium and time stepping, as plain functions of float arrays.

The equations are those of docs/ring-model.md and of `ring/reference.py`, which sums the same 304
rollers in readable numpy. What makes these files fast: rollers are sorted by their cosine, so that
those in contact are an interval; their powers, forces and tangents are one loop that the compiler
turns into vector code; BDF2 needs one implicit solve a step; the last step's stiffness and damping
predict the next so well that mostly one Newton iteration is left to do.

`m` is the record of constants made by `ring/model.py` and read by name; the state `s` and the work
`w` are flat arrays, and `layout` has the meaning of each place. All functions release the GIL.
Kernels import from this folder only: its files are what the compiled code is kept by.
"""

from saddlering_ros.ring.kernels.equilibrium import static_batch
from saddlering_ros.ring.kernels.integration import advance, run_batch, start

__all__ = ['advance', 'run_batch', 'start', 'static_batch']
