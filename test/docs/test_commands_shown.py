"""Every command that a page shows is typed here, or says beside it why it is not."""

from pathlib import Path
import re
import shlex

import pytest
from typed_pages import blocks, FENCE, lines_run, typed_page

from saddlering_ros.cli.main import build_parser, SHOWN

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*sorted((ROOT / 'docs').glob('*.md')), ROOT / 'README.md', ROOT / 'CONTRIBUTING.md']
COMMAND = re.compile(r'^(?: {4}|\t)\$? ?(?:saddlering|ros2|make|python3?|pip|sudo|source|colcon|'
                     r'export|\.venv/bin/\w+) ', re.M)


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
def test_every_command_of_a_page_does_what_it_says(page, campaign, made_once):
    typed = typed_page(page, made_once, campaign)
    for one in typed.lines:
        assert one.status == 0, f'{one.line}: {one.complained}'
        assert one.printed, one.line
        words = shlex.split(one.line)
        for option in ('--out', '--report', '--plots'):
            if option in words:
                assert (typed.folder / words[words.index(option) + 1]).exists(), one.line
    assert [one.line for one in typed.lines] == lines_run(page)


UNTRIED = {
    'campaign': 'test/campaign tests it',
    'check-driver': 'test/nodes/test_check_driver.py runs it beside the example driver',
    'compare': 'the shipped bags are one session of one ring',
    'demo': 'test/cli/test_demo.py runs it',
    'live': 'serves until it is ended',
    'plan': 'it simulates every test that could be added: half a minute',
    'record': 'records until it is ended',
    'replay': 'test/cli/test_numbers_out.py replays a bag and records it'}
"""Commands whose examples no test types, and why."""


def test_the_examples_of_the_help_are_among_them():
    run = {line for page in RUN for line in lines_run(page)}
    _, commands = build_parser()
    examples = {line for command, _ in commands.values() for line, _ in command.examples
                if command.name not in UNTRIED}
    assert examples <= run
    assert set(SHOWN) <= set(commands)
