"""Python that a page shows runs as it stands, block after block, among bags of a ring."""

from pathlib import Path
import re

import numpy as np
import pytest
from shared_verdicts import PLACE, shared_diagnose

from saddlering_ros import discrepancy

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r'^```python\n(.*?)^```', re.S | re.M)
PAGES = {page.stem: found for page in sorted((ROOT / 'docs').glob('*.md'))
         if (found := BLOCK.findall(page.read_text(encoding='utf-8')))}
PRINTED = {'python_api': ('named',),
           'own_simulator': ('verdict: named', 'The simulation lacks Coulomb friction')}
"""Pages with snippets, each with parts of what it prints."""


def test_every_page_with_a_snippet_is_run():
    assert set(PAGES) == set(PRINTED)


@pytest.mark.parametrize('page', PRINTED)
def test_the_snippets_of_a_page_run_as_they_stand(
        page, campaign, made_once, no_pictures, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(PLACE, shared_diagnose(made_once))
    (tmp_path / 'bags').symlink_to(campaign('radial_friction', 8000.0, 'force')[0].parent)
    (tmp_path / 'config').symlink_to(ROOT / 'config')
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in PAGES[page]:
        exec(block, names)
    printed = capsys.readouterr().out
    assert [part for part in PRINTED[page] if part not in printed] == []


def test_the_axis_of_a_page_gets_the_verdicts_of_its_table():
    """Each row has a friction, declared errors, and the verdict with what it leaves."""
    page = (ROOT / 'docs' / 'own_simulator.md').read_text(encoding='utf-8')
    axis = {'np': np, **vars(discrepancy)}
    exec(PAGES['own_simulator'][1], axis)
    rows = re.findall(r'^\| (none|\d+ N) \| (.*?) \| `(\w+)`(.*) \|$', page, re.M)
    assert len(rows) > 6
    for friction, cell, verdict, rest in rows:
        true = {**axis['sound'], 'coulomb.force': float(friction.replace('none', '0').strip(' N'))}
        runs = [axis['record'](*run, true) for run in (('slow', 1.0), ('fast', 2.5))]
        declared = [float(share) / 100.0 for share in re.findall(r'([\d.]+) %', cell)]
        for error in declared + [0.0] * ('nothing' in cell) + [0.5] * ('or more' in cell):
            found = discrepancy.diagnose(
                axis['axis'](error), runs, hold_out=[axis['record']('other', 1.7, true)])
            assert found.verdict == verdict, (friction, error)
            assert found.complete == ('complete' in rest or verdict == 'none'), (friction, error)
            for words in re.findall('"(.*?)"', rest):
                assert words in found.headline
