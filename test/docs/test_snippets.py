"""Python that a page shows runs as it stands, block after block, among bags of a ring."""

from pathlib import Path
import re

import pytest
from shared_verdicts import PLACE, shared_diagnose

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
        page, campaign, made_once, pictures_once, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(PLACE, shared_diagnose(made_once))
    (tmp_path / 'bags').symlink_to(campaign('radial_friction', 8000.0, 'force')[0].parent)
    (tmp_path / 'config').symlink_to(ROOT / 'config')
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in PAGES[page]:
        exec(block, names)
    printed = capsys.readouterr().out
    assert [part for part in PRINTED[page] if part not in printed] == []
