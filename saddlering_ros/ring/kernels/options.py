"""How the kernels are compiled: one compiler for all of them, kept by all their sources."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from saddlering_ros import compiled

kernel = compiled.Compiler(Path(__file__).parent)
"""Decorator of every kernel: `@kernel(**INNER)`."""

OUTER: dict[str, Any] = {'nogil': True, 'error_model': 'numpy'}
"""Options of kernels that allocate or are called from Python."""

INNER: dict[str, Any] = {**OUTER, '_nrt': False}
"""Options of the rest: they borrow their arrays, so none is counted (an atomic each otherwise)."""

FAST = {'reassoc', 'contract', 'nsz', 'arcp', 'nnan', 'ninf'}
"""What fast arithmetic may do: all but reckoning with roots and reciprocals of less accuracy."""
