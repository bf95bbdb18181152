"""The notebook in examples/ does what it shows, on short bags of a rig with friction.

The engine's answer is shared with the tutorial, which asks the same by a command.
"""

import json
from pathlib import Path

from execute_notebook import shown
import pytest
from shared_verdicts import PLACE, shared_diagnose

from saddlering_ros.rig import read_parameters

NOTEBOOK = Path(__file__).resolve().parents[2] / 'examples' / 'from_bags_to_a_verdict.ipynb'

pytestmark = pytest.mark.slow


def cells():
    """The code cells."""
    return [cell for cell in json.loads(NOTEBOOK.read_text())['cells']
            if cell['cell_type'] == 'code']


def test_the_notebook_goes_from_bags_to_a_verdict(
        campaign, made_once, no_pictures, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(PLACE, shared_diagnose(made_once))
    (tmp_path / 'bags').symlink_to(campaign('radial_friction', 8000.0, 'force')[0].parent)
    monkeypatch.chdir(tmp_path)
    names = {}
    seen = [shown(''.join(cell['source']), names) for cell in cells()]
    tables = [None if one is None else one[1] for one in seen]
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


def test_the_notebook_is_kept_with_its_outputs():
    kept = cells()
    assert [cell['execution_count'] for cell in kept] == list(range(1, len(kept) + 1))
    outputs = [output for cell in kept[1:] for output in cell['outputs']]
    assert len(outputs) >= len(kept) - 1
    assert 'verdict: named' in json.dumps(outputs)
    assert sum('image/png' in output.get('data', {}) for output in outputs) == 3
