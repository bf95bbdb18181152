"""Messages of the suite by the place that they come from, for docs/generate.py."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / 'saddlering_ros'

AREAS = {
    'Bags': (('bags', 'record'), 'bags.md'),
    'Doubtful records': (('doubts',), 'bags.md#what-gets-a-note'),
    'Import': (('importing',), 'import.md'),
    'Rig and parameter files': (('rig', 'plain_yaml.py'), 'ring.md'),
    'Files and arguments': (('files.py', 'cli', 'api'), 'reference/commands.md'),
    'Simulation and effects': (('ring', 'effects', 'virtual_rig'), 'effects.md'),
    'Identification': (('identification', 'estimation'), 'identification.md'),
    'Diagnosis and comparison': (('diagnosis', 'comparison', 'discrepancy'), 'diagnosis.md'),
    'Alarm': (('monitoring',), 'alarm.md'),
    'Nodes, replay and live page': (('ros', 'nodes', 'jobs', 'live'), 'hardware.md'),
    'Campaigns and fleets': (('campaign', 'fleet'), 'campaigns.md'),
}
"""Heading: the folders whose messages it lists, and the page that explains them."""

MIN_WORDS = 4
"""Words of a message without its figures, below which the figures are the message."""


def troubleshooting_page(document: str) -> str:
    """Every refusal and note of the code, with … for figures and names; `document` is its head."""
    parts = [
        '# Messages and remedies', '', document,
        'A refusal is one line with the fault, the place and the remedy; a note states what is '
        'doubtful. Search this page for a part of the line; … stands for names and figures. The '
        'link below a heading explains more. A traceback is a defect of the program: report it.',
        '']
    for heading, (folders, page) in AREAS.items():
        messages = sorted({text for folder in folders for text in _messages(folder)},
                          key=lambda text: text.lstrip('… :,').lower())
        target = page.removeprefix('reference/') if '/' in page else f'../{page}'
        parts += [f'## {heading}', '', f'See [{page.split("#")[0]}]({target}).', '',
                  *(f'- {text}' for text in messages), '']
    return '\n'.join(parts)


def _messages(folder: str) -> Iterator[str]:
    """Texts of errors that a user can correct, and of findings."""
    place = PACKAGE / folder
    for file in sorted(place.rglob('*.py')) if place.is_dir() else [place]:
        for item in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(item, ast.Call) and item.args:
                # The last name, as of DiscrepancyError(...) and of system.DiscrepancyError(...).
                name, texts = ast.unparse(item.func).rpartition('.')[2], item.args
                ours = name.endswith('Error') and not name.startswith(('Value', 'Type', 'Assert'))
                if ours or name == 'Finding':
                    yield from _text(texts[0])


def _put_in(value: ast.expr) -> str:
    """What stands for a value that is put in: … with the noun, in the plural, of a number."""
    if isinstance(value, ast.Call) and ast.unparse(value.func) == 'counted':
        noun = ast.literal_eval(value.args[1])
        return f'… {noun.partition("|")[2] or noun + "s"}'
    return '…'


def _text(value: ast.expr) -> Iterator[str]:
    """A message with … for what is put in; nothing if that is most of it."""
    if isinstance(value, ast.Constant) and isinstance(value.value, str):
        words = value.value
    elif isinstance(value, ast.JoinedStr):
        words = ''.join(part.value if isinstance(part, ast.Constant) else _put_in(part.value)
                        for part in value.values)
    else:
        return
    words = ' '.join(words.split())
    if len(words.replace('…', '').split()) >= MIN_WORDS:
        yield words.replace('<', '\\<').replace('*', '\\*').replace('_', '\\_')
