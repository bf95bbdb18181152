"""The commands of a page of the documentation, typed once for all tests that look at the results.
"""

from collections.abc import Iterator
import contextlib
from dataclasses import dataclass
import io
import json
import os
from pathlib import Path
import re
import shlex
from unittest import mock

from made_once import MadeOnce
from shared_pictures import DRAWN, shared_drawn
from shared_verdicts import PLACE, shared_diagnose
from short_bags import ShortBags

from saddlering_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(r'(?:<!-- (?P<note>(?:not )?run[^>]*?) -->\n)?'
                   r'```(?:sh|console)\n(?P<text>.*?)```', re.S)
MORE = {'diagnose': ('--json', 'verdict.json')}
"""Words added to a command, so that tests of its document need no other run of it."""


@dataclass(frozen=True)
class Block:
    """A block of commands: why it is not run ('' if it is), and its lines without remarks."""

    note: str
    lines: tuple[str, ...]


def blocks(page: Path) -> list[Block]:
    """All blocks of commands of a page."""
    text = page.read_text(encoding='utf-8')
    return [
        Block(found['note'] or '', tuple(
            line for line in (re.sub(r'\s+# .*', '', line).removeprefix('$ ').strip()
                              for line in found['text'].splitlines())
            if line and not line.startswith('#')))
        for found in FENCE.finditer(text)]


def lines_run(page: Path) -> list[str]:
    """The lines of a page that the tests type."""
    return [line for block in blocks(page) if not block.note for line in block.lines]


@dataclass(frozen=True)
class Typed:
    """A line, the status that it ended with, and what it printed and complained."""

    line: str
    status: int
    printed: str
    complained: str


@dataclass(frozen=True)
class TypedPage:
    """A page whose lines were typed in `folder`, up to the first that failed."""

    folder: Path
    lines: tuple[Typed, ...]

    def of(self, command: str) -> Typed:
        """The first line of a command."""
        return next(one for one in self.lines if one.line.split()[1] == command)


def typed_page(page: Path, made: MadeOnce, bags: ShortBags) -> TypedPage:
    """Type the lines of `page` among bags of a ring with friction; once for a run of the tests."""
    def make(folder: Path) -> None:
        (folder / 'bags').symlink_to(bags('radial_friction', 8000.0, 'force')[0].parent)
        (folder / 'config').symlink_to(ROOT / 'config')
        (folder / 'docs').mkdir()
        (folder / 'docs' / 'data').symlink_to(ROOT / 'docs' / 'data')
        said = []
        with (_inside(folder), mock.patch(PLACE, shared_diagnose(made)),
              mock.patch(DRAWN, shared_drawn(made))):
            for line in lines_run(page):
                said.append(_typed(line))
                if said[-1][1]:
                    break
        (folder / 'said.json').write_text(json.dumps(said))

    folder = made.folder(f'typed_{page.stem}', make)
    lines = json.loads((folder / 'said.json').read_text())
    return TypedPage(folder, tuple(Typed(*one) for one in lines))


def _typed(line: str) -> tuple[str, int, str, str]:
    words = shlex.split(line)[1:]
    printed, complained = (io.TextIOWrapper(io.BytesIO(), 'utf-8') for _ in range(2))
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(complained):
        status = main([*words, *MORE.get(words[0], ())])
    for stream in (printed, complained):
        stream.seek(0)
    return line, status, printed.read(), complained.read()


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
