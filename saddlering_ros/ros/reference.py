"""The reference of the nodes' parameters in docs/nodes.md, written from their declarations.

python -m saddlering_ros.ros.reference docs/nodes.md       rewrites what stands below the marker
"""

from __future__ import annotations

import importlib
from pathlib import Path
import sys

from saddlering_ros.ros.parameters import Parameter, table
from saddlering_ros.ros.streaming_node import AUTOSTART, StreamingNode

MARKER = '<!-- from here on written by python -m saddlering_ros.ros.reference -->\n'

CLASSES = {
    'replay_clock': 'ReplayClockNode', 'hydraulic_load': 'LoadReplay',
    'eddy_current': 'ProbeReplay', 'ring_displacement': 'RingDisplacementNode',
    'ring_simulator': 'RingSimulatorNode', 'ring_residual': 'RingResidualNode',
    'ring_identification': 'RingIdentificationNode', 'ring_diagnosis': 'RingDiagnosisNode',
}


def parameters_of(node: str) -> tuple[Parameter, ...]:
    """All parameters of a node but those of the rig."""
    kind = getattr(importlib.import_module(f'saddlering_ros.nodes.{node}'), CLASSES[node])
    own: tuple[Parameter, ...] = kind.PARAMETERS
    return (AUTOSTART, *own) if issubclass(kind, StreamingNode) else own


def reference() -> str:
    """Everything below the marker."""
    parts = [MARKER, '## Parameters\n']
    parts += [f'### {node}\n\n{table(parameters_of(node))}\n' for node in CLASSES]
    return '\n'.join(parts)


def main() -> None:
    """Rewrite the page given."""
    page = Path(sys.argv[1])
    head = page.read_text().partition(MARKER)[0]
    page.write_text(head + reference())


if __name__ == '__main__':
    main()
