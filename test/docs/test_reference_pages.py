"""The reference pages of a clone are those that the code of today gives."""

from pathlib import Path
import re

from generate import PAGES
import pytest

DOCS = Path(__file__).resolve().parents[2] / 'docs'
LINK = re.compile(r'\]\(([^)#:\s]*)(?:#([^)]*))?\)')
HEADING = re.compile(r'^#+ (.*)$', re.M)


@pytest.mark.parametrize('name', sorted(PAGES))
def test_a_page_in_reference_is_what_the_code_gives(name):
    page = DOCS / 'reference' / name
    assert page.read_text(encoding='utf-8') == PAGES[name](), 'run: python docs/generate.py'


def test_links_of_pages_lead_to_files_of_the_repository():
    pages = [page for page in DOCS.rglob('*.md') if '_build' not in page.parts]
    pages += [DOCS.parent / 'README.md', DOCS.parent / 'CONTRIBUTING.md']
    links = {(page, *link) for page in pages for link in LINK.findall(page.read_text('utf-8'))}
    assert len(links) > 100
    broken = [f'{page.name}: {link}' for page, link, _ in links
              if not (page.parent / link).exists()]
    assert not broken
    lost = [f'{page.name}: {link}#{anchor}' for page, link, anchor in links
            if anchor and anchor not in anchors(page.parent / link if link else page)]
    assert not lost


def anchors(page):
    """Anchors of the headings of a page, as GitHub and Sphinx make them."""
    return {re.sub(r'[^\w\- ]', '', heading.lower()).strip().replace(' ', '-')
            for heading in HEADING.findall(page.read_text('utf-8'))}
