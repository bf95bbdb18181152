"""Claims on words: the code and the docs use the vocabulary of the field, and plain sentences."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
import re
import subprocess

import pytest

ROOT = Path(__file__).resolve().parents[2]

REPLACED = {
    'saddle bearing': (r'(?i)\bsaddle bearing', 'saddle ring'),
    'free_of': (r'\bfree_of\b', 'marginalise'),
    'Allowance': (r'\bAllowance\b', 'ModelErrorPrior'),
    'scouted': (r'\bscout(ed|ing)?\b', 'coarse_fit'),
    'carried_on': (r'\bcarried_on\b', 'refine'),
    'Battery': (r'\bBattery\b', 'LackOfFitTests'),
    'Ripple': (r'\bRipple\b', 'FastResidual'),
    'Muster': (r'\bMuster\b', 'LockstepGroup'),
    'Inflow': (r'\b(In|Out)flow\b', 'RawSubscription'),
    'unsound': (r'\bunsound\b', 'misfit_with_inflated_nuisances'),
    'small unknowns': (r'(?i)\bsmall unknowns\b', 'nuisance parameters'),
    'knob': (r'\bknobs?\b', 'extension parameter'),
    'kept back': (r'\bkept[ _](back|apart)\b', 'held out'),
    'left out in turn': (r'left out in turn', 'held out'),
    'rival': (r'(?i)\brivals?\b', 'alternative, open model'),
    'pinned': (r'\.pinned\b', 'determined'),
    'trouble': (r'\btrouble\b', 'failed_steps'),
    'polished': (r'\bpolished\b', 'refit_full_jacobian'),
    'LEAST_, MOST_, LARGEST_': (r'\b_?(LEAST|MOST|LARGEST|SMALLEST|FEWEST)_', 'MIN_, MAX_')}
"""Old word: a pattern that finds it, and what to say."""


@cache
def texts() -> dict[str, str]:
    """Code and pages by name; not the record of what was changed and measured."""
    listed = subprocess.run(['git', 'ls-files', '*.py', '*.md'], cwd=ROOT, capture_output=True,
                            text=True, check=False)
    if listed.returncode:
        pytest.skip('this is no git clone')
    own = Path(__file__).relative_to(ROOT).as_posix()
    return {name: (ROOT / name).read_text(encoding='utf-8') for name in listed.stdout.split()
            if name not in ('CHANGELOG.md', own) and not name.startswith('docs/benchmarks/')
            and (ROOT / name).is_file()}


@pytest.mark.parametrize('old', REPLACED)
def test_an_old_word_stands_nowhere(old: str) -> None:
    pattern, say = re.compile(REPLACED[old][0]), REPLACED[old][1]
    found = [name for name, text in texts().items() if pattern.search(text)]
    assert not found, f'say {say} for {old}'


# --- pages ---

DOCS = ROOT / 'docs'
LOGS = sorted((DOCS / 'benchmarks').glob('*.md'))
PAGES = [*sorted(DOCS.glob('*.md')), *(ROOT / name for name in (
    'README.md', 'CONTRIBUTING.md', 'SECURITY.md'))]

KINDS = {'How to': ('This page shows', 'This page leads', 'This tutorial'),
         'Explanation': ('This page explains',),
         'Reference': ('A reference of', 'This page defines', 'A declaration after',
                       'This page is written from the code')}
"""How a page of each kind of the first page's lists begins."""

FORBIDDEN = {
    r'\b(says|said|told(?! apart))\b': 'a page, file or number states, reports or defines',
    r'\b(what|that which) is left\b': 'the residual, the remainder',
    r'\b(whoever|nobody|somebody)\b': 'name who',
    r'\bless (the )?simulated\b': 'minus',
    r'\bkept apart\b|\bparts? the\b': 'separate, tell apart',
    r'\b(once|one) a sample\b|\ba row a\b': 'per',
    r'\bmiddle row\b': 'radial row',
    r'\bheard\b': 'received'}
"""A pattern that pages avoid, and what to write."""

LONGEST_SENTENCE = 40
"""Words; a table, a list of things or a formula is no sentence."""

COMMIT = re.compile(r'\b(?=[0-9a-f]*\d)(?=[0-9a-f]*[a-f])[0-9a-f]{7,40}\b')
DATE = re.compile(r'\b20\d\d-\d\d-\d\d\b')


def plain(text: str) -> str:
    """A page without remarks, blocks and spans of code."""
    text = re.sub(r'(?s)<!--.*?-->', '', text)
    text = re.sub(r'(?ms)^(```|:::).*?^\1[ ]*$', '', text)
    text = re.sub(r'(?m)^    .*$', '', text)
    text = re.sub(r'\]\([^)]*\)', ']', text)
    return re.sub(r'`[^`]*`', 'code', text)


def sentences(text: str) -> Iterator[str]:
    """Sentences outside of tables and headings; a list item is a paragraph of its own."""
    for block in re.split(r'\n\s*\n', plain(text)):
        lines = [line for line in block.split('\n') if not re.match(r'\s*(\||#|!\[)', line)]
        paragraphs: list[str] = []
        for line in lines:
            if not paragraphs or re.match(r'\s*(-|\d+\.)\s', line):
                paragraphs.append(line)
            else:
                paragraphs[-1] += f' {line}'
        for paragraph in paragraphs:
            yield from re.split(r'(?<=[.:;?!])\s+', paragraph)


def listed() -> dict[str, str]:
    """Pages of the first page's lists, each with the caption of its list."""
    index = (DOCS / 'index.md').read_text(encoding='utf-8')
    found = {}
    lists = re.findall(r'```\{toctree\}\n.*?:caption: (.*?)\n\n(.*?)```', index, re.S)
    for caption, names in lists:
        found.update(dict.fromkeys(names.split(), caption))
    return found


def name_of(page: Path) -> str:
    return page.name


@pytest.mark.parametrize('page', PAGES, ids=name_of)
def test_no_page_holds_a_seed_a_hash_or_a_date(page: Path) -> None:
    text = plain(page.read_text(encoding='utf-8'))
    assert not COMMIT.findall(text), 'figures and their commits belong into docs/benchmarks'
    assert not re.findall(r'\bseeds? \d', text)
    assert not DATE.findall(text)


@pytest.mark.parametrize('page', LOGS, ids=name_of)
def test_a_benchmark_log_is_dated(page: Path) -> None:
    assert DATE.search(page.read_text(encoding='utf-8'))


@pytest.mark.parametrize('page', PAGES, ids=name_of)
def test_a_page_has_plain_short_sentences(page: Path) -> None:
    text = page.read_text(encoding='utf-8')
    prose = plain(text)
    for pattern, say in FORBIDDEN.items():
        assert not re.search(pattern, prose, re.I), f'{pattern}: {say}'
    long = [words for words in sentences(text) if len(words.split()) > LONGEST_SENTENCE]
    assert not long, 'one idea a sentence'


def test_every_page_is_of_one_kind_and_opens_with_its_purpose() -> None:
    kinds = listed()
    own = {page.stem for page in DOCS.glob('*.md')} - {'index'}
    assert own <= set(kinds), 'list the page in docs/index.md'
    wrong = {}
    for name, kind in kinds.items():
        page = DOCS / f'{name}.md'
        if kind in KINDS and page.is_file():
            opening = plain(page.read_text(encoding='utf-8')).split('\n', 1)[1].strip()
            if not opening.startswith(KINDS[kind]):
                wrong[name] = f'{kind}: begin with one of {KINDS[kind]}'
    assert not wrong
