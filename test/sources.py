"""What source files import, read once for all tests of a process."""

import ast
from functools import cache
from pathlib import Path


@cache
def imported(path: Path) -> frozenset[tuple[str, str]]:
    """(module, name) of all that a file imports, anywhere in it; '' of a module as a whole."""
    found: set[tuple[str, str]] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            found |= {(alias.name, '') for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module, f'{path}: a relative import'
            assert not node.level, f'{path}: a relative import'
            found |= {(node.module, alias.name) for alias in node.names}
    return frozenset(found)
