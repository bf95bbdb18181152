"""Compiled sums over rollers, equilibrium and time stepping, as plain functions of float arrays.

The equations are those of docs/ring.md and of `test/ring/readable_ring.py`, which sums the
same 304 rollers in readable NumPy. These files are fast for four reasons. Rollers are sorted by
their cosine, so that the rollers in contact are an interval. One loop computes powers, forces and
tangents, and the compiler turns this loop into vector code. BDF2 needs one implicit solution per
step. Stiffness and damping of the last step predict the next step, so that mostly one Newton
iteration follows.

`m` is the record of constants that `ring/model.py` makes; kernels read its fields by name. The
state `s` and the work array `w` are flat; `layout` defines their indices. All functions release
the GIL. Kernels import from this folder only, because the hash of its files identifies the
compiled code.
"""
