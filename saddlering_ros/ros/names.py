"""Names of nodes, topics and actions; set-up, launcher, launch file and docs read them here.

Names of topics and actions are relative, so that everything of a rig is under its namespace.
A new node is a module in `saddlering_ros/nodes/` and one entry in NODES. ROS is not imported
here before a function needs it: set-up runs without it.
"""

from dataclasses import dataclass
import signal

from saddlering_ros.errors import SaddleringError

TIME, REPLAY, RING, ALARM, ACTION = 'clock', 'replay', 'ring', 'alarm', 'action'

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals that end a node."""


class NodeError(SaddleringError):
    """A request that a node cannot fulfil; one line: fault, place, remedy."""


@dataclass(frozen=True)
class NodeEntry:
    """One node: its name is that of its executable and of its module in `nodes`.

    class_name: its class in that module; kind: TIME and REPLAY nodes replay bags, RING nodes
    follow the rig, the ALARM node watches them, ACTION nodes serve an action; takes, gives,
    services: topics in words.
    """

    name: str
    class_name: str
    kind: str
    takes: str
    gives: str
    services: str = ''

    @property
    def module(self) -> str:
        return f'saddlering_ros.nodes.{self.name}'


NODES = (
    NodeEntry('replay_clock', 'ReplayClockNode', TIME, 'replay/progress', '/clock, replay/state',
              '~/play, ~/pause, ~/step, ~/seek, ~/set_rate'),
    NodeEntry('hydraulic_load', 'ReplayNode', REPLAY, '/clock, a bag',
              'rig/hydraulic_load; rig/elevation of a bag that holds it'),
    NodeEntry('eddy_current', 'ReplayNode', REPLAY, '/clock, a bag',
              'rig/eddy_current_1 to rig/eddy_current_4'),
    NodeEntry('ring_displacement', 'RingDisplacementNode', RING, 'load and probes',
              'ring/displacement, ring/zero_request', '~/zero'),
    NodeEntry('ring_simulator', 'RingSimulatorNode', RING,
              'rig/hydraulic_load, ring/parameters, ring/zero_request',
              'ring/simulated_displacement, ring/expected, ring/parameters', '~/restart, ~/zero'),
    NodeEntry('ring_residual', 'RingResidualNode', RING, 'both displacements', 'ring/residual'),
    NodeEntry('ring_alarm', 'RingAlarmNode', ALARM,
              'ring/residual, rig/hydraulic_load, ring/parameters',
              'ring/alarm, ring/within_limits', '~/reset'),
    NodeEntry('ring_identification', 'RingIdentificationNode', ACTION, 'bags',
              'identify_ring (action), ring/parameters'),
    NodeEntry('ring_diagnosis', 'RingDiagnosisNode', ACTION, 'bags',
              'diagnose_ring (action), ring/parameters'))


def names(*kinds: str) -> tuple[str, ...]:
    """Names of the nodes of these kinds (of all nodes if none is given)."""
    return tuple(node.name for node in NODES if not kinds or node.kind in kinds)


DISPLACEMENT = 'ring/displacement'
SIMULATED = 'ring/simulated_displacement'
RESIDUAL = 'ring/residual'
DISPLACEMENTS = (DISPLACEMENT, SIMULATED, RESIDUAL)
PARAMETERS_IN_FORCE = 'ring/parameters'
ZERO_REQUEST = 'ring/zero_request'
EXPECTED = 'ring/expected'
INCLINOMETER = 'rig/inclinometer'
PROGRESS = 'replay/progress'
STATE = 'replay/state'
CLOCK = 'clock'
STATE_TOLD = 'state of the alarm: '
"""Begin of the line that ring_alarm logs when its state changes; a replay shows it."""
DIAGNOSTICS = '/diagnostics'
"""Absolute, as every tool expects it; statuses there carry the full name of their node."""

RIG_IDENTITY = 'ring/rig_identity'
"""The hash of each node's rig, kept for late joiners."""

RING_ALARM = 'ring/alarm'
WITHIN_LIMITS = 'ring/within_limits'
"""True while the residual is watched and no alarm is latched: for a hydraulics interlock."""

LIVE_PAGE = 'saddlering_live'
"""Node of a live page. In its reports of progress the number of its process follows."""

IDENTIFY = 'identify_ring'
DIAGNOSE = 'diagnose_ring'


def namespace_of(text: str) -> str:
    """A namespace as ROS writes it ('/rig1', '' for the root); NodeError for one it refuses."""
    from rclpy.exceptions import InvalidNamespaceException
    from rclpy.validate_namespace import validate_namespace

    parts = text.strip().strip('/')
    if not parts:
        return ''
    try:
        validate_namespace(f'/{parts}')
    except InvalidNamespaceException as problem:
        raise NodeError(f'namespace {text!r}: give letters, digits and underscores, separated by '
                        '/ (rig1, or hall/rig1)') from problem
    return f'/{parts}'


def is_of_another_rig(status: str, namespace: str) -> bool:
    """Whether a status (NODE: TASK) on /diagnostics is not of the rig in a namespace ('': root).

    A node of somebody else, such as a driver, may leave its namespace out of its name.
    """
    space, _, node = status.partition(': ')[0].rpartition('/')
    if not namespace or not space:
        return bool(space) or bool(namespace and node in names())
    return not f'{space}/'.startswith(f'{namespace}/')
