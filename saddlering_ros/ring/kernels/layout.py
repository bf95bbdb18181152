"""Indices in the flat arrays of the kernels, state (S,) and work (W,), and options of compilation.

One compiler serves all kernels; a hash of all sources is its key.
"""

from pathlib import Path
from typing import Any

from saddlering_ros import compiled

# State of a running simulation. STEP_ERROR: estimated error of the last step [m]; FRACTION: its
# length as a share of the requested step. The load path has states from MEASURED_LOAD on.
TIME, START_TIME, STEP_OLD, FAILED_STEPS, ITERATIONS, STEP_ERROR, FRACTION = range(7)
ZERO_LOAD, ZERO_FORCE_X, MEASURED_LOAD, HIGHEST_LOAD = range(7, 11)
CYLINDER_Z, BRACKET_Z = range(11, 15, 2)
LOAD_STATES = 6
FRICTION_Z = 15  # two states each of the frictions against delta_x, delta_y and gamma
# Three numbers each. LAST_FORCE and the next two are those of the last step.
(Q, Q_OLD, V, V_OLD, ZERO, CREEP, CREEP_INPUT, RESONANCE, RESONANCE_RATE, RESONANCE_INPUT,
 LAST_FORCE) = range(21, 54, 3)
# Entries 00, 02, 11, 12, 22
LAST_STIFFNESS, LAST_DAMPING = range(54, 64, 5)
# One number for each probe
LAGGED, LAG_INPUT, LAGGED_TWICE = range(64, 76, 4)
STATE_SIZE = 76

# Work array of one kernel call
STIFFNESS, DAMPING = range(0, 10, 5)
FORCE, EXTERNAL, RESOLVED, MOTION = range(10, 22, 3)
TOUCHING = 22        # rollers in contact of each row at the last sum
LOAD_BACKUP = 25     # copy of the states of the load path
BACKUP = 31          # copy of the state
WORK_SIZE = BACKUP + STATE_SIZE

kernel = compiled.Compiler(Path(__file__).parent)
"""Decorator of every kernel: `@kernel(**INNER)`."""

OUTER: dict[str, Any] = {'nogil': True, 'error_model': 'numpy'}
"""Options of kernels that allocate memory or that Python calls."""

INNER: dict[str, Any] = {**OUTER, '_nrt': False}
"""Options of all other kernels. They borrow their arrays, so that no reference is counted."""

FAST = {'reassoc', 'contract', 'nsz', 'arcp', 'nnan', 'ninf'}
"""Permissions of fast arithmetic: all but approximate functions (afn)."""
