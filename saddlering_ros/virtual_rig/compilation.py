"""The compiler of the virtual rig's inner loops; what it compiled is kept by all their sources."""

from __future__ import annotations

from pathlib import Path

from saddlering_ros.compiled import Compiler

HERE = Path(__file__).parent
SOURCES = ('integrator.py', 'friction.py', 'filters.py', 'effects_load.py')

compiled = Compiler(*(HERE / name for name in SOURCES))
