"""The registry of nodes: set-up, launcher, launch file and docs read it; it imports nothing.

A new node is a module in `saddlering_ros/nodes/` and one entry here.
"""

from __future__ import annotations

from dataclasses import dataclass

CLOCK, REPLAY, RING, ALARM, ACTION = 'clock', 'replay', 'ring', 'alarm', 'action'


@dataclass(frozen=True)
class NodeEntry:
    """One node: its name is that of its executable and of its module in `nodes`.

    class_name: its class in that module; kind: CLOCK and REPLAY nodes replay bags, RING nodes
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
        """The module that holds its class and `main`."""
        return f'saddlering_ros.nodes.{self.name}'


NODES = (
    NodeEntry('replay_clock', 'ReplayClockNode', CLOCK, 'replay/progress', '/clock, replay/state',
              '~/play, ~/pause, ~/step, ~/seek, ~/set_rate'),
    NodeEntry('hydraulic_load', 'LoadReplay', REPLAY, '/clock, a bag',
              'rig/hydraulic_load; rig/elevation of a bag that holds it'),
    NodeEntry('eddy_current', 'ProbeReplay', REPLAY, '/clock, a bag',
              'rig/eddy_current_1 to rig/eddy_current_4'),
    NodeEntry('ring_displacement', 'RingDisplacementNode', RING, 'load and probes',
              'ring/displacement, ring/zero', '~/zero'),
    NodeEntry('ring_simulator', 'RingSimulatorNode', RING,
              'rig/hydraulic_load, ring/parameters, ring/zero',
              'ring/simulated_displacement, ring/parameters', '~/restart, ~/zero'),
    NodeEntry('ring_residual', 'RingResidualNode', RING, 'both displacements', 'ring/residual'),
    NodeEntry('ring_alarm', 'RingAlarmNode', ALARM,
              'ring/residual, rig/hydraulic_load, ring/parameters',
              'ring/alarm, ring/within_limits', '~/reset'),
    NodeEntry('ring_identification', 'RingIdentificationNode', ACTION, 'bags',
              'identify_ring (action), ring/parameters'),
    NodeEntry('ring_diagnosis', 'RingDiagnosisNode', ACTION, 'bags',
              'diagnose_ring (action), ring/parameters'),
)


def names(*kinds: str) -> tuple[str, ...]:
    """Names of the nodes of these kinds (of all nodes if none is given)."""
    return tuple(node.name for node in NODES if not kinds or node.kind in kinds)


def nodes_table() -> str:
    """The nodes as a Markdown table, for the docs."""
    lines = ['| node | takes | gives | services |', '|---|---|---|---|']
    lines += [f'| {node.name} | {node.takes} | {node.gives} | {node.services} |'
              for node in NODES]
    return '\n'.join(lines)
