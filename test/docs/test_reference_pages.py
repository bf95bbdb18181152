"""The reference pages of a clone are those that the code of today gives."""

from pathlib import Path
import re

from generate import PAGES
import pytest

DOCS = Path(__file__).resolve().parents[2] / 'docs'
LINK = re.compile(r'\]\(([^)#:\s]*)(?:#([^)]*))?\)')
FILE = re.compile(r'(?<![\w./])(?:\w+/)*\w+\.(?:py|md)\b')
OWN_FOLDERS = ('saddlering_ros', 'docs', 'benchmarks', 'test', 'launch', 'examples', 'tools',
               'requirements')
FOREIGN = {'launch.py'}
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


def test_files_that_code_and_pages_name_are_in_the_repository():
    root = DOCS.parent
    listed = {str(file.relative_to(root)) for folder in ('.', *OWN_FOLDERS)
              for file in (root / folder).glob('**/*' if folder != '.' else '*')}
    texts = [root / 'CONTRIBUTING.md', *DOCS.glob('*.md'), *root.glob('saddlering_ros/**/*.py')]
    named = {(text.name, name) for text in texts for name in FILE.findall(text.read_text('utf-8'))}
    assert len(named) > 50
    lost = [pair for pair in named if pair[1] not in FOREIGN
            and not any(f'/{file}'.endswith(f'/{pair[1]}') for file in listed)]
    assert not lost
