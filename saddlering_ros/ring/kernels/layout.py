"""Places of scalars in the flat arrays that the kernels work on: model (M,), state (S,), work.

numba keeps compiled kernels by the contents of kernels.py alone, with these numbers in them: after
a change here, change LAYOUT in kernels.py too (a test holds the two together).
"""

# Model: rig, contact law and extension
RADIUS = 0
MIDDLE_HEIGHT = 1
AXIAL_ROLLERS = 2
MIDDLE_ROLLERS = 3
AXIAL_CLEARANCE = 4
MIDDLE_CLEARANCE = 5
K1 = 6
N1 = 7
D1 = 8
K2 = 9
N2 = 10
D2 = 11
MASS = 12
INERTIA = 13
WEIGHT = 14
WEIGHT_X = 15
TRUNNION_X = 16
TRUNNION_Y = 17
ELEVATION = 18
FULL_SCALE = 19
AXIAL_SPAN = 20
RADIAL_HEIGHT = 21
LOAD_GAIN = 22
LOAD_OFFSET = 23
LOAD_CURVE = 24
ELEVATION_ERROR = 25
MOMENT_ARM = 26
CYLINDER_LIMIT = 27
CYLINDER_PRESLIDING = 28
CYLINDER_SHARPNESS = 29
CYLINDER_INITIAL = 30
BRACKET_LIMIT = 31
BRACKET_PRESLIDING = 32
BRACKET_SHARPNESS = 33
BRACKET_INITIAL = 34
RADIAL_LIMIT = 35
RADIAL_PRESLIDING = 36
RADIAL_SHARPNESS = 37
RADIAL_INITIAL = 38
TILT_LIMIT = 39
TILT_PRESLIDING = 40
TILT_SHARPNESS = 41
TILT_INITIAL = 42
DAMPING_SHARE = 43
RADIAL_COMPLIANCE = 44
AXIAL_COMPLIANCE = 45
TILT_COMPLIANCE = 46
OPENING_COMPLIANCE = 47
OPENING_MOMENT = 48
CREEP_RADIAL = 49
CREEP_AXIAL = 50
CREEP_TIME = 51
SETTLING_X = 52
SETTLING_Y = 53
SETTLING_TILT = 54
RESONANCE_FREQUENCY = 55
RESONANCE_DAMPING = 56
OVALISATION = 57
PROBE_HEIGHT = 58
PICKUP_FREQUENCY = 59
CLOCK_OFFSET = 60
CLOCK_SKEW = 61
# Four numbers each, probes 1 to 4
BRACKET = 62
GAIN = 66
CURVE = 70
DRIFT = 74
LAG = 78
PICKUP_COSINE = 82
PICKUP_SINE = 86
CLIP_LOW = 90
CLIP_HIGH = 94
# Cosine and sine of the elevation as it is without bracket play
COSINE = 98
SINE = 99
# Factors on K of each row (not on D)
UPPER_STIFFNESS = 100
LOWER_STIFFNESS = 101
MIDDLE_STIFFNESS = 102
# Share of a probe's lag that its second stage takes, probes 1 to 4
LAG_SECOND = 103
# Share of the motion that the second mode carries
RESONANCE_SHARE = 107
# Power of penetration by which damping grows, 0 for n of the row
DAMPING_EXPONENT = 108
# One over the penetration beyond which damping grows no more [1/m]
DAMPING_LEVELLING = 109
# Half the range of moments over which a joint opens [N m]
OPENING_SPREAD = 110
MODEL_SIZE = 111

# State of a running simulation
TIME = 0
START_TIME = 1
STEP_OLD = 2
TROUBLE = 3
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
RADIAL_Z = 27
TILT_Z = 29
CREEP = 31
CREEP_INPUT = 34
RESONANCE = 37
RESONANCE_RATE = 40
RESONANCE_INPUT = 43
LAGGED = 46
LAG_INPUT = 50
LAGGED_TWICE = 54
# Forces and slopes of the last step: 3, and entries 00, 02, 11, 12, 22 of two matrices
LAST_FORCE = 58
LAST_STIFFNESS = 61
LAST_DAMPING = 66
STATE_SIZE = 71

# Work of one kernel call, not kept between calls
FORCE = 0
STIFFNESS = 3
DAMPING = 8
EXTERNAL = 13
RESOLVED = 16
MOTION = 19
TOUCHING = 22        # rollers in contact of each row when last summed
BACKUP = 25          # of the state
WORK_SIZE = BACKUP + STATE_SIZE
