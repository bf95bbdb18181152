"""Right-hand sides of pcgym's process models, without the packages that its face asks for."""

from __future__ import annotations

import importlib.util
from pathlib import Path
import sys
from types import ModuleType

import numpy as np


def process_models() -> ModuleType:
    """pcgym.model_classes, with numpy in place of jax (not used by its numpy branch)."""
    found = importlib.util.find_spec('pcgym')
    if found is None or found.origin is None:
        raise ImportError('pcgym is not installed')
    sys.modules.setdefault('jax', ModuleType('jax'))
    sys.modules.setdefault('jax.numpy', np)
    path = Path(found.origin).parent / 'model_classes.py'
    spec = importlib.util.spec_from_file_location('pcgym_models', path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
