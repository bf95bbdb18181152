"""Nodes and parameters in docs/nodes.md, written from the registry and the declarations.

python -m saddlering_ros.ros.reference docs/nodes.md       rewrites its parts made from code
"""

from __future__ import annotations

import importlib
from pathlib import Path
import sys

from saddlering_ros.ros.names import NodeEntry, NODES, nodes_table
from saddlering_ros.ros.parameters import HARDWARE_ID, NodeParameter, table
from saddlering_ros.ros.streaming_node import AUTOSTART, StreamingNode

MARKER = '<!-- from here on written by python -m saddlering_ros.ros.reference -->\n'

TABLE, TABLE_END = '<!-- nodes: from the registry -->\n', '\n<!-- end of nodes -->'


def parameters_of(node: NodeEntry) -> tuple[NodeParameter, ...]:
    """All parameters of a node but those of the rig."""
    kind = getattr(importlib.import_module(node.module), node.class_name)
    own: tuple[NodeParameter, ...] = kind.PARAMETERS
    return (AUTOSTART, HARDWARE_ID, *own) if issubclass(kind, StreamingNode) else own


def reference() -> str:
    """Everything below the marker."""
    parts = [MARKER, '## Parameters\n']
    parts += [f'### {node.name}\n\n{table(parameters_of(node))}\n' for node in NODES]
    return '\n'.join(parts)


def rewritten(page: str) -> str:
    """The text of the page with both parts written anew."""
    head = page.partition(MARKER)[0]
    before, _, rest = head.partition(TABLE)
    after = rest.partition(TABLE_END)[2]
    return before + TABLE + nodes_table() + TABLE_END + after + reference()


def main() -> None:
    """Rewrite the page given."""
    page = Path(sys.argv[1])
    page.write_text(rewritten(page.read_text()))


if __name__ == '__main__':
    main()
