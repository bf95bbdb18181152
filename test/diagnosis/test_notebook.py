"""The notebook in examples/ does what it shows, on short bags of a rig with friction.

The engine's answer is shared with the tutorial, which asks the same by a command.
"""

import ast
import json
from pathlib import Path

import pytest
from shared_verdicts import PLACE, shared_diagnose

from saddlering_ros.rig import read_parameters

NOTEBOOK = Path(__file__).resolve().parents[2] / 'examples' / 'from_bags_to_a_verdict.ipynb'

pytestmark = pytest.mark.slow


def cells():
    """The source of every code cell."""
    return [''.join(cell['source']) for cell in json.loads(NOTEBOOK.read_text())['cells']
            if cell['cell_type'] == 'code']


def shown(source, names):
    """Execute a cell; what a notebook would show of its last expression, or None."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, '<cell>', 'exec'), names)
    value = None if last is None else eval(
        compile(ast.Expression(last.value), '<cell>', 'eval'), names)
    for form in ('_repr_html_', '_repr_png_'):
        if hasattr(value, form):
            return getattr(value, form)()
    return None


def test_the_notebook_goes_from_bags_to_a_verdict(
        campaign, made_once, pictures_once, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(PLACE, shared_diagnose(made_once))
    (tmp_path / 'bags').symlink_to(campaign('radial_friction', 8000.0, 'force')[0].parent)
    monkeypatch.chdir(tmp_path)
    names = {}
    tables = [shown(source, names) for source in cells()]
    printed = capsys.readouterr().out
    assert 'static test at 50 deg' in printed
    assert f'verdict: {names["verdict"].verdict}' in printed
    assert 'radial_friction' in names['verdict'].causes
    assert '>K1<' in tables[2]
    assert tables[3].startswith(b'\x89PNG')
    assert 'Verdict: ' in tables[-1]
    assert read_parameters('extended.yaml').effects['radial_friction']
    assert Path('verdict.html').stat().st_size > 100_000
    assert json.loads(Path('verdict.json').read_text())['verdict'] == names['verdict'].verdict


def test_the_notebook_is_kept_without_outputs():
    for cell in json.loads(NOTEBOOK.read_text())['cells']:
        assert not cell.get('outputs')
