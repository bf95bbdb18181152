"""The compiler of the inner loops of the virtual rig; its results are kept by their sources."""

from __future__ import annotations

from pathlib import Path

from saddlering_ros.compiled import Compiler

HERE = Path(__file__).parent
SOURCES = ('integrator.py', 'friction.py', 'filters.py', 'effects_load.py')

compiled = Compiler(*(HERE / name for name in SOURCES))
