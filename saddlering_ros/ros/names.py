"""Relative names of topics and actions, so that everything of a rig is under its namespace."""

from __future__ import annotations

from rclpy.exceptions import InvalidNamespaceException
from rclpy.node import Node
from rclpy.validate_namespace import validate_namespace

from saddlering_ros.ros.errors import NodeError

DISPLACEMENT = 'ring/displacement'
SIMULATED = 'ring/simulated_displacement'
RESIDUAL = 'ring/residual'
DISPLACEMENTS = (DISPLACEMENT, SIMULATED, RESIDUAL)
PARAMETERS_IN_FORCE = 'ring/parameters'
ZERO = 'ring/zero'
PROGRESS = 'replay/progress'
STATE = 'replay/state'
CLOCK = 'clock'
DIAGNOSTICS = '/diagnostics'
"""Absolute, as every tool expects it; statuses there carry the full name of their node."""

RIG = 'ring/rig'
"""Kept for late joiners: the hash of each node's rig."""

RING_ALARM = 'ring/alarm'
WITHIN_LIMITS = 'ring/within_limits'
"""True while no alarm is latched; the input of a hydraulics interlock."""

IDENTIFY = 'identify_ring'
DIAGNOSE = 'diagnose_ring'


def namespace_of(text: str) -> str:
    """A namespace as ROS writes it ('/rig1', '' for the root); NodeError for one it refuses."""
    parts = text.strip().strip('/')
    if not parts:
        return ''
    try:
        validate_namespace(f'/{parts}')
    except InvalidNamespaceException as problem:
        raise NodeError(f'namespace {text!r}: give letters, digits and underscores, separated by '
                        '/ (rig1, or hall/rig1)') from problem
    return f'/{parts}'


def diagnostic_name(node: Node) -> str:
    """The node's full name as /diagnostics shows it; in the root namespace without the slash."""
    return str(node.get_fully_qualified_name() if node.get_namespace() != '/'
               else node.get_name())


def rig_name(node: Node, given: str = '') -> str:
    """The hardware_id of a node's diagnostics: the one given, or that of its namespace."""
    return given or ('saddlering' + node.get_namespace().rstrip('/'))
