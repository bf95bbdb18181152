"""Indices in the flat arrays of the kernels, state (S,) and work (W,), and options of compilation.

One compiler serves all kernels; a hash of all sources is its key.
"""

from pathlib import Path
from typing import Any

from saddlering_ros import compiled

# State of a running simulation
TIME = 0
START_TIME = 1
STEP_OLD = 2
FAILED_STEPS = 3
MEASURED_LOAD = 4
HIGHEST_LOAD = 5
ZERO_LOAD = 6
ZERO_FORCE_X = 7
Q = 8
Q_OLD = 11
V = 14
V_OLD = 17
ZERO = 20
CYLINDER_Z = 23
BRACKET_Z = 25
FRICTION_Z = 27  # two states each of the frictions against delta_x, delta_y and gamma
CREEP = 33
CREEP_INPUT = 36
RESONANCE = 39
RESONANCE_RATE = 42
RESONANCE_INPUT = 45
LAGGED = 48
LAG_INPUT = 52
LAGGED_TWICE = 56
# Forces (3) of the last step, and entries 00, 02, 11, 12, 22 of stiffness and damping
LAST_FORCE = 60
LAST_STIFFNESS = 63
LAST_DAMPING = 68
# Estimated error of the last step [m]; its length as a share of the requested step
STEP_ERROR = 73
FRACTION = 74
STATE_SIZE = 75

# Work array of one kernel call
FORCE = 0
STIFFNESS = 3
DAMPING = 8
EXTERNAL = 13
RESOLVED = 16
MOTION = 19
TOUCHING = 22        # rollers in contact of each row at the last sum
LOAD_BACKUP = 25     # states of friction in the load path
BACKUP = 29          # copy of the state
WORK_SIZE = BACKUP + STATE_SIZE

kernel = compiled.Compiler(Path(__file__).parent)
"""Decorator of every kernel: `@kernel(**INNER)`."""

OUTER: dict[str, Any] = {'nogil': True, 'error_model': 'numpy'}
"""Options of kernels that allocate memory or that Python calls."""

INNER: dict[str, Any] = {**OUTER, '_nrt': False}
"""Options of all other kernels. They borrow their arrays, so that no reference is counted."""

FAST = {'reassoc', 'contract', 'nsz', 'arcp', 'nnan', 'ninf'}
"""Permissions of fast arithmetic: all but approximate functions (afn)."""
