"""Options of compilation. One compiler serves all kernels; a hash of all sources is its key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from saddlering_ros import compiled

kernel = compiled.Compiler(Path(__file__).parent)
"""Decorator of every kernel: `@kernel(**INNER)`."""

OUTER: dict[str, Any] = {'nogil': True, 'error_model': 'numpy'}
"""Options of kernels that allocate memory or that Python calls."""

INNER: dict[str, Any] = {**OUTER, '_nrt': False}
"""Options of all other kernels. They borrow their arrays, so that no reference is counted."""

FAST = {'reassoc', 'contract', 'nsz', 'arcp', 'nnan', 'ninf'}
"""Permissions of fast arithmetic: all but approximate functions (afn)."""
