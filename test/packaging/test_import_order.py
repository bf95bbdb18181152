"""Imports point down the list of CONTRIBUTING.md, and two borders are never crossed."""

from pathlib import Path
import re

import pytest
from sources import imported

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / 'saddlering_ros'


def layers():
    text = (ROOT / 'CONTRIBUTING.md').read_text(encoding='utf-8')
    listed = re.search(r'point down this list only:(.*?)\.\s', text, re.DOTALL)
    return re.findall(r'`(\w+)`', listed.group(1))


def imports_of(layer):
    """Pairs of each file of a layer and a layer that it imports, anywhere in it."""
    for path in (*PACKAGE.glob(f'{layer}/**/*.py'), *PACKAGE.glob(f'{layer}.py')):
        for module, name in imported(path):
            root, *inside = (*module.split('.'), name)
            if root == 'saddlering_ros':
                yield path.relative_to(PACKAGE), inside[0]


def test_every_folder_and_module_of_the_package_stands_in_the_list():
    folders = {path.parent.name for path in PACKAGE.glob('*/__init__.py')}
    modules = {path.stem for path in PACKAGE.glob('*.py')} - {'__init__'}
    assert folders | modules == set(layers())


@pytest.mark.parametrize('layer', layers())
def test_a_layer_imports_only_those_below_it(layer):
    order = layers()
    above = set(order[order.index(layer) + 1:])
    assert not [(path, name) for path, name in imports_of(layer) if name in above]


@pytest.mark.parametrize(('layer', 'forbidden'), [
    ('virtual_rig', {'ring', 'effects', 'estimation', 'identification'}),
    ('discrepancy', {'rig', 'ring', 'effects', 'record', 'bags', 'identification'}),
    ('estimation', {'ring', 'effects', 'discrepancy', 'identification'})])
def test_a_border_is_not_crossed(layer, forbidden):
    assert forbidden <= set(layers())
    assert not [(path, name) for path, name in imports_of(layer) if name in forbidden]


OPTIONAL = ('importing', 'fleet', 'campaign')


def test_nothing_but_cli_imports_an_optional_room():
    """No layer imports one above it, and only cli stands above them."""
    assert layers()[-4:] == [*OPTIONAL, 'cli']


@pytest.mark.parametrize('layer', OPTIONAL)
def test_an_optional_room_computes_by_the_public_functions_alone(layer):
    inner = {'effects', 'ring', 'estimation', 'monitoring', 'identification', 'discrepancy',
             'diagnosis', 'virtual_rig', 'report', 'nodes'}
    assert inner <= set(layers())
    assert not [(path, name) for path, name in imports_of(layer) if name in inner]
