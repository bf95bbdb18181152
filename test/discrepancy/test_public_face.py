"""A claim on the engine's face: the ring is a user of it like any other."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path

import pytest

import saddlering_ros
from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import Channel, DiscrepancyError, Parameter, Run

PACKAGE = Path(saddlering_ros.__file__).parent
NAME = 'saddlering_ros.discrepancy'


def imports(path: Path) -> list[tuple[str, str]]:
    """Modules that a file imports from, with each name."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found += [(node.module, item.name) for item in node.names]
        if isinstance(node, ast.Import):
            found += [(item.name, '') for item in node.names]
    return found


def test_nothing_outside_the_engine_imports_what_it_does_not_export() -> None:
    users = [path for path in PACKAGE.rglob('*.py') if 'discrepancy' not in path.parts]
    users += (PACKAGE.parent / 'examples').rglob('*.py')
    wrong = [
        f'{path.relative_to(PACKAGE.parent)}: {module}.{name}'
        for path in users
        for module, name in imports(path)
        if module.startswith(f'{NAME}.') or (module == NAME and name not in discrepancy.__all__)
    ]
    assert len(users) > 100
    assert wrong == []


def test_the_engine_imports_no_ring() -> None:
    rooms = ('ring', 'effects', 'rig', 'diagnosis', 'bags', 'identification', 'virtual_rig')
    wrong = [
        f'{path.name}: {module}'
        for path in (PACKAGE / 'discrepancy').rglob('*.py')
        for module, _ in imports(path)
        if module.split('.')[:1] == ['saddlering_ros'] and module.split('.')[1:2]
        and module.split('.')[1] in rooms
    ]
    assert wrong == []


@pytest.mark.parametrize(('declare', 'words'), [
    (lambda: Channel(model_error=None), 'channel: model_error is None: a share of the range'),
    (lambda: Channel(offset=None), "channel: offset is None: give 'free', 'none' or a"),
    (lambda: Parameter(None, 1.0), 'parameter: low must be below high, and both finite, not None'),
    (lambda: Run('a', ['early'] * 9, {}, {'y': range(9)}), 'run a: time is no array of numbers'),
    (lambda: Run('a', range(9), {}, {'y': [[1], [2, 3]]}), 'run a: outputs y is no array of num')])
def test_a_declaration_of_another_kind_is_refused_in_one_line(
        declare: Callable[[], object], words: str) -> None:
    with pytest.raises(DiscrepancyError) as refused:
        declare()
    assert str(refused.value).startswith(words)
    assert '\n' not in str(refused.value)
