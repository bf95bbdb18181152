"""Imports point down the list of CONTRIBUTING.md, and two borders are never crossed."""

import ast
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / 'saddlering_ros'


def layers():
    text = (ROOT / 'CONTRIBUTING.md').read_text(encoding='utf-8')
    listed = re.search(r'point down this list only:(.*?)\.\s', text, re.DOTALL)
    return re.findall(r'`(\w+)`', listed.group(1))


def imported(path):
    """Layers of the package that a file imports, anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module == 'saddlering_ros':
            names = [f'saddlering_ros.{alias.name}' for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or '']
        else:
            continue
        for name in names:
            if name.startswith('saddlering_ros.'):
                yield name.split('.')[1]


def test_every_folder_and_module_of_the_package_stands_in_the_list():
    folders = {path.parent.name for path in PACKAGE.glob('*/__init__.py')}
    modules = {path.stem for path in PACKAGE.glob('*.py')} - {'__init__'}
    assert folders | modules == set(layers())


@pytest.mark.parametrize('layer', layers())
def test_a_layer_imports_only_those_below_it(layer):
    order = layers()
    above = set(order[order.index(layer) + 1:])
    files = [*PACKAGE.glob(f'{layer}/**/*.py'), *PACKAGE.glob(f'{layer}.py')]
    wrong = {f'{path.relative_to(PACKAGE)}: {name}'
             for path in files for name in imported(path) if name in above}
    assert not wrong


@pytest.mark.parametrize(('layer', 'forbidden'), [
    ('virtual_rig', {'ring', 'effects', 'estimation', 'identification'}),
    ('discrepancy', {'rig', 'ring', 'effects', 'record', 'bags', 'identification'}),
    ('estimation', {'ring', 'effects', 'discrepancy', 'identification'}),
])
def test_a_border_is_not_crossed(layer, forbidden):
    crossed = {name for path in PACKAGE.glob(f'{layer}/**/*.py') for name in imported(path)}
    assert forbidden <= set(layers())
    assert not crossed & forbidden


OPTIONAL = ('importing', 'fleet', 'campaign')


@pytest.mark.parametrize('layer', sorted(set(layers()) - {*OPTIONAL, 'cli'}))
def test_nothing_but_cli_imports_an_optional_room(layer):
    files = [*PACKAGE.glob(f'{layer}/**/*.py'), *PACKAGE.glob(f'{layer}.py')]
    assert not {name for path in files for name in imported(path)} & set(OPTIONAL)


@pytest.mark.parametrize('layer', OPTIONAL)
def test_an_optional_room_computes_by_the_public_functions_alone(layer):
    inner = {'effects', 'ring', 'estimation', 'monitoring', 'identification', 'discrepancy',
             'diagnosis', 'virtual_rig', 'report', 'nodes'}
    assert inner <= set(layers())
    seen = {name for path in PACKAGE.glob(f'{layer}/**/*.py') for name in imported(path)}
    assert not seen & inner
