"""Every command that a page shows is typed here, or says beside it why it is not."""

from dataclasses import dataclass
from pathlib import Path
import re
import shlex

import pytest

from saddlering_ros.cli._examples import EXAMPLES, UNTRIED
from saddlering_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*sorted((ROOT / 'docs').glob('*.md')), ROOT / 'README.md', ROOT / 'CONTRIBUTING.md']
FENCE = re.compile(r'(?:<!-- (?P<note>(?:not )?run[^>]*?) -->\n)?'
                   r'```(?:sh|console)\n(?P<text>.*?)```', re.S)
COMMAND = re.compile(r'^(?: {4}|\t)\$? ?(?:saddlering|ros2|make|python3?|pip|sudo|source|colcon|'
                     r'export|\.venv/bin/\w+) ', re.M)


@dataclass(frozen=True)
class Block:
    """A block of commands: why it is not run ('' if it is), and its lines without remarks."""

    note: str
    lines: tuple[str, ...]


def blocks(page):
    text = page.read_text(encoding='utf-8')
    return [
        Block(found['note'] or '', tuple(
            line for line in (re.sub(r'\s+# .*', '', line).removeprefix('$ ').strip()
                              for line in found['text'].splitlines())
            if line and not line.startswith('#')))
        for found in FENCE.finditer(text)]


def lines_run(page):
    return [line for block in blocks(page) if not block.note for line in block.lines]


RUN = [page for page in PAGES if lines_run(page)]


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_commands_stand_in_blocks_that_can_be_run_or_say_why_not(page):
    shown = COMMAND.findall(FENCE.sub('', page.read_text(encoding='utf-8')))
    assert shown == [], 'put commands into ```sh blocks'
    for block in blocks(page):
        kind, _, reason = block.note.partition(': ')
        if kind == 'not run':
            assert len(reason) > 10
            for name in re.findall(r'test/\w+/test_\w+\.py', reason):
                assert (ROOT / name).is_file(), name
        elif block.note:
            elsewhere = ROOT / block.note.removeprefix('run in ')
            there = [line for other in blocks(elsewhere) for line in other.lines]
            assert set(block.lines) <= set(there)
        else:
            assert all(line.startswith('saddlering ') for line in block.lines)


@pytest.mark.timeout(900)
@pytest.mark.parametrize('page', RUN, ids=lambda page: page.name)
def test_every_command_of_a_page_does_what_it_says(page, campaign, tmp_path, monkeypatch, capsys):
    (tmp_path / 'bags').symlink_to(campaign('radial_friction', 8000.0, 'force')[0].parent)
    (tmp_path / 'config').symlink_to(ROOT / 'config')
    (tmp_path / 'docs').mkdir()
    (tmp_path / 'docs' / 'data').symlink_to(ROOT / 'docs' / 'data')
    monkeypatch.chdir(tmp_path)
    for line in lines_run(page):
        words = shlex.split(line)[1:]
        assert main(words) == 0, f'{line}: {capsys.readouterr().err}'
        assert capsys.readouterr().out, line
        for option in ('--out', '--report', '--plots'):
            if option in words:
                assert Path(words[words.index(option) + 1]).exists(), line


def test_the_examples_of_the_help_are_among_them():
    run = {line for page in RUN for line in lines_run(page)}
    examples = {line for name, lines in EXAMPLES.items() for line, _ in lines
                if name not in UNTRIED and name != 'saddlering'}
    assert examples <= run
    started = {line.split()[1] for line, _ in EXAMPLES['saddlering']}
    assert started <= set(EXAMPLES)
