"""The reference pages from the code: `python docs/generate.py` writes docs/reference."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Callable, Sequence
from functools import cached_property
import importlib
import inspect
from itertools import groupby, pairwise
import math
from operator import itemgetter
from pathlib import Path
import re
from typing import Any

from catalogue_page import catalogue_page
from troubleshooting_page import troubleshooting_page

import saddlering_ros
from saddlering_ros.cli.main import build_parser
from saddlering_ros.record.topics import TOPICS as RIG
from saddlering_ros.ros import names as ros_names

ROOT = Path(__file__).resolve().parent.parent
INTERFACES = ROOT / 'saddlering_interfaces'
DOCUMENT = ('This page is written from the code by `python docs/generate.py`. '
            'A test compares the two.\n')

TOPICS = {
    **{name: topic.words for name, topic in RIG.items()},
    '/ring/displacement': 'measured motion of the ring, from the probes',
    '/ring/simulated_displacement': 'simulated motion of the ring, at the same stamps',
    '/ring/residual': 'measured minus simulated motion, at the same stamps',
    '/ring/parameters': 'contact parameters in force (applied_by names the node) or offered; '
                        'kept for late joiners',
    '/ring/zero_request': 'a node takes a new zero, from this stamp on',
    '/ring/alarm': 'state of the alarm, and the latched alarm; kept for late joiners',
    '/ring/within_limits': 'true while the residual is watched, or the load rests before, and no '
                           'alarm is latched; about ten times a second, for an interlock',
    '/replay/state': 'position and state of a replay; kept for late joiners',
    '/diagnostics': 'health of every node, once a second',
}
"""What the recorder takes, in words."""

UNRECORDED = {
    '/rig/inclinometer': ('saddlering_interfaces/msg/Elevation',
                          'elevation of the load from an inclinometer, with its standard '
                          'uncertainty; nodes take it as `/rig/elevation`'),
    '/ring/expected': ('saddlering_interfaces/msg/RingExpected',
                       'motion that the model expects for the load now, for feed-forward'),
    '/ring/rig_identity': ('saddlering_interfaces/msg/RigIdentity',
                           'the rig that a node works with; kept for late joiners'),
    '/replay/progress': ('saddlering_interfaces/msg/ReplayProgress',
                         'progress of each node in a replay in lockstep'),
    '/clock': ('rosgraph_msgs/msg/Clock', 'time of a replay'),
}
"""The other topics of the nodes: type and words."""


def topics_page() -> str:
    """Topics with their types, as the nodes and the recorder declare them."""
    from saddlering_ros.live.recorder import KEPT, OTHERS, streams
    from saddlering_ros.ros.raw_topics import type_name

    known = {topic: type_name(kind) for topic, kind in {**streams(), **KEPT, **OTHERS}.items()}
    named = {'/' + value.lstrip('/') for name, value in vars(ros_names).items()
             if name.isupper() and isinstance(value, str) and '/' in value}
    missing = (set(known) ^ set(TOPICS)) | (named - set(TOPICS) - set(UNRECORDED))
    if missing:
        raise SystemExit(f'docs/generate.py: no description of {", ".join(sorted(missing))}')
    described = {topic: (known[topic], words) for topic, words in TOPICS.items()} | UNRECORDED
    rows = [f'| `{topic}` | `{kind}` | {words} |' for topic, (kind, words) in described.items()]
    nodes = ', '.join(f'`{name}`' for name in ros_names.names())
    return '\n'.join([
        '# Topics and actions', '', DOCUMENT,
        'All messages are in SI units. The stamp of a measurement is its time.', '',
        '| topic | type | meaning |', '|---|---|---|', *rows, '',
        '| action | type | served by |', '|---|---|---|',
        '| `/identify_ring` | [IdentifyRing](messages.md) | `ring_identification` |',
        '| `/diagnose_ring` | [DiagnoseRing](messages.md) | `ring_diagnosis` |', '',
        f'Nodes: {nodes}. [Nodes](nodes.md) lists their topics, services '
        'and parameters.', ''])


def messages_page() -> str:
    """Every definition of saddlering_interfaces as it is compiled."""
    parts = ['# Messages, services and actions', '', DOCUMENT]
    for kind, folder in (('msg', 'Messages'), ('srv', 'Services'), ('action', 'Actions')):
        parts += [f'## {folder}', '']
        for file in sorted((INTERFACES / kind).glob(f'*.{kind}')):
            parts += [f'### {file.stem}', '', f'`saddlering_interfaces/{kind}/{file.stem}`', '',
                      '```text', file.read_text(encoding='utf-8').rstrip(), '```', '']
    return '\n'.join(parts)


def commands_page() -> str:
    """Every subcommand with its options and examples, from the parser itself."""
    parser, commands = build_parser()
    action = next(item for item in parser._actions
                  if isinstance(item, argparse._SubParsersAction))
    words = {item.dest: item.help for item in action._choices_actions}
    parts = ['# Commands', '', DOCUMENT, 'Exit status: 0 done; 1 a defect of the program; 2 '
             'unusable arguments or input, with one line on stderr that states the fault, the '
             'place and '
             'the remedy; 130 interrupted. `--json -` prints only JSON to standard output. '
             'Colours and progress appear in terminals only, and not if `NO_COLOR` is set. After '
             '`eval "$(register-python-argcomplete saddlering)"` the tab key completes '
             'commands.', '']
    for name in sorted(commands):
        found = action.choices[name]
        parts += [f'## {name}', '', f'{_sentence(found.description or words[name])}', '',
                  '```text', _usage(found), '```', '', '| option | meaning |', '|---|---|']
        parts += [_option(item) for item in found._actions if item.dest != 'help']
        examples = [f'# {text}\n{line}' for line, text in commands[name][0].examples]
        parts += ['', '```text', *examples, '```', '']
    return '\n'.join(parts)


def _usage(parser: argparse.ArgumentParser) -> str:
    return ' '.join(parser.format_usage().removeprefix('usage: ').split())


def _option(item: argparse.Action) -> str:
    names = ', '.join(item.option_strings) or str(item.metavar or item.dest)
    value = ''
    if item.option_strings and item.nargs != 0:
        shown = item.metavar or ('|'.join(map(str, item.choices)) if item.choices
                                 else item.dest.upper())
        value = f' {shown}'
    meaning = (item.help or '').replace('%%', '%')
    return f'| `{_cell(names + value)}` | {_cell(meaning)} |'


def _cell(text: str) -> str:
    return text.replace('|', '\\|')


def _sentence(text: str) -> str:
    text = ' '.join(text.replace('%%', '%').split())
    return f'{text[:1].upper()}{text[1:]}' + ('' if text.endswith('.') else '.')


def files_page() -> str:
    """The files the suite reads and writes, with the shipped ones as they are."""
    from saddlering_ros.bags.samples import COLUMNS
    from saddlering_ros.rig import ParameterSet, TRUE_TO_SCALE
    from saddlering_ros.rig.parameter_file import parameters_to_mapping

    sections = ', '.join(f'`{name}`' for name in parameters_to_mapping(
        ParameterSet(TRUE_TO_SCALE, {'radial_friction': {'force': 5e3}})))
    return '\n'.join([
        '# Files', '', DOCUMENT,
        '## The rig', '', 'A ROS 2 parameter file, read by commands (`--rig`) and nodes '
        '(`--params-file`), or by all that the variable `SADDLERING_RIG` reaches. '
        'The shipped one is `config/rig.yaml`:', '', '```yaml',
        (ROOT / 'config' / 'rig.yaml').read_text(encoding='utf-8').rstrip(), '```', '',
        '## Parameters', '', f'A ROS 2 parameter file with the sections {sections}: the contact '
        'law in SI units, its source (bags and their hashes, objective, covariance), and '
        'the effects beyond the contact law. Written by `saddlering identify --out` and '
        '`saddlering diagnose --out`; any node reads such a file with `--params-file`.', '',
        '## Tables', '', 'CSV or Parquet, by the ending of the name. Columns: '
        + ', '.join(f'`{name}`' for name in COLUMNS)
        + '; stamps in nanoseconds, all else in SI units.', '',
        '## Bags', '', '[Bags](../bags.md) states what is read, refused and written.', '',
        '## Layouts', '', '`config/plotjuggler.xml` and `config/foxglove.json`; '
        '[Results](../results.md) shows how to load them.', ''])


def nodes_page() -> str:
    """Every node with its topics, services and parameters, from registry and declarations."""
    from saddlering_ros.ros.names import NODES
    from saddlering_ros.ros.parameters import HARDWARE_ID
    from saddlering_ros.ros.streaming_node import AUTOSTART, StreamingNode

    parts = [
        '# Nodes', '', DOCUMENT,
        'Each node is a process: `ros2 run saddlering_ros NODE`, or without ros2cli '
        '`python -m saddlering_ros.nodes.NODE`. Every node reports on `/diagnostics` once a '
        'second and reads the rig from `--params-file config/rig.yaml`. An unusable or unknown '
        'parameter ends a node with status 2 and one line. [Beside a rig](../hardware.md) '
        'explains their use.', '', '| node | takes | gives | services |', '|---|---|---|---|',
        *(f'| {node.name} | {node.takes} | {node.gives} | {node.services} |' for node in NODES),
        '']
    for node in NODES:
        kind = getattr(importlib.import_module(node.module), node.class_name)
        own = ((AUTOSTART, HARDWARE_ID, *kind.PARAMETERS) if issubclass(kind, StreamingNode)
               else kind.PARAMETERS)
        parts += [f'## {node.name}', '', _parameter_table(own), '']
    return '\n'.join([*parts, *_launch_lines()])


def _parameter_table(parameters: Sequence[Any]) -> str:
    """The parameters of a node as a Markdown table."""
    lines = ['| parameter | default | range | meaning |', '|---|---|---|---|']
    for parameter in parameters:
        limits = ', '.join(f'`{choice}`' for choice in parameter.choices)
        if math.isfinite(parameter.low) and math.isfinite(parameter.high):
            limits = f'{parameter.low:g} to {parameter.high:g}'
        default = f'`{parameter.default!r}`' if parameter.default != '' else 'none'
        when = ' (changeable)' if parameter.changeable else (
            ' (while inactive)' if parameter.while_inactive else '')
        lines.append(f'| `{parameter.name}`{when} | {default} | {limits} | {parameter.words} |')
    return '\n'.join(lines)


def _launch_lines() -> list[str]:
    """The arguments of the launch file, from its source: launch is not published as a wheel."""
    found: dict[str, tuple[object, ...]] = {}
    for item in ast.parse((ROOT / 'launch' / 'rig.launch.py').read_text('utf-8')).body:
        if isinstance(item, ast.Assign) and ast.unparse(item.targets) in ('ARGUMENTS', 'CHOICES'):
            found |= ast.literal_eval(item.value)
    rows = [f'| `{name}` | {f"`{default}`" if default else "empty"} | {words} |'
            for name, (default, *_, words) in found.items()]
    topics = ', '.join(f'`{topic.relative.rpartition("/")[2]}_topic`' for topic in RIG.values())
    return ['## rig.launch.py', '',
            '`ros2 launch saddlering_ros rig.launch.py NAME:=VALUE`. Without a bag the replay '
            'nodes are not started.', '',
            '| argument | default | meaning |', '|---|---|---|',
            '| `rig` | the rig file that the environment names, else the shipped one | rig '
            'description |', *rows,
            '', f'Arguments that rename a topic: {topics}.', '']


THRESHOLDS = {
    'quantities': 'Results, wherever they are printed',
    'rig': 'The rig and the zero',
    'ring/small_errors': 'A sound ring',
    'record': 'Readings of a test',
    'doubts': 'Doubts about a record or a driver',
    'estimation': 'Noise, rest and rounding',
    'monitoring': 'The alarm',
    'identification': 'Identification and validation',
    'discrepancy': 'The search for causes and the verdict',
    'diagnosis': 'Causes of a ring',
    'comparison': 'Changes between sessions',
    'fleet': 'Fleets',
}
"""Rooms, and headings, of the documented numbers that a reader of results may want to know."""


def thresholds_page() -> str:
    """Every documented number of the modules in THRESHOLDS, with its docstring."""
    parts = ['# Thresholds', '', DOCUMENT, 'Numbers by which bags, fits and causes are judged. '
             '[Identification](../identification.md) and [Diagnosis](../diagnosis.md) explain '
             'their use.', '']
    package = ROOT / 'saddlering_ros'
    for room, heading in THRESHOLDS.items():
        parts += [f'## {heading}', '', '| constant | value | meaning |', '|---|---|---|']
        for file in sorted([*package.glob(f'{room}.py'), *package.glob(f'{room}/**/*.py')]):
            module = '.'.join(file.relative_to(package).with_suffix('').parts)
            for meaning, alike in groupby(_numbers(file), itemgetter(2)):
                names, values, _ = zip(*alike, strict=True)
                listed = ', '.join([f'`{module}.{names[0]}`', *(f'`{one}`' for one in names[1:])])
                parts.append(f'| {listed} | {", ".join(map(_cell, values))} | {_cell(meaning)} |')
        parts.append('')
    return '\n'.join(parts)


def _numbers(file: Path) -> list[tuple[str, str, str]]:
    """Name, source and docstring of the numbers that a module defines and explains."""
    tree = ast.parse(file.read_text(encoding='utf-8'))
    found = _documented(tree.body)
    for item in tree.body:
        if isinstance(item, ast.ClassDef) and item.name == 'Settings':
            found += [(f'Settings.{name}', value, meaning)
                      for name, value, meaning in _fields(item)]
    return found


def _documented(body: list[ast.stmt]) -> list[tuple[str, str, str]]:
    """Upper-case constants that a docstring follows; several in one line share it."""
    found = []
    for item, after in pairwise(body):
        if not (isinstance(item, ast.Assign) and isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
                and isinstance(after.value.value, str)):
            continue
        names, value = item.targets[0], item.value
        several = isinstance(names, ast.Tuple) and isinstance(value, ast.Tuple)
        pairs = zip(names.elts, value.elts, strict=True) if several else [(names, value)]
        found += [(ast.unparse(name), _value(one), ' '.join(after.value.value.split()))
                  for name, one in pairs if _is_number(one)]
    return found


def _fields(item: ast.ClassDef) -> list[tuple[str, str, str]]:
    """Fields of a dataclass with the words of its docstring, `name: words; name: words`."""
    text = ' '.join((ast.get_docstring(item) or '').split())
    words = dict(re.findall(r'(?:^|[;.] )(\w+): (.*?)(?=; \w+: |\.$|$)', text))
    return [(ast.unparse(field.target), _value(field.value), words.get(field.target.id, ''))
            for field in item.body if isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name) and field.value is not None
            and field.target.id in words]


def _is_number(value: ast.expr) -> bool:
    """Whether an expression holds nothing but numbers and arithmetic."""
    allowed = (ast.Constant, ast.UnaryOp, ast.USub, ast.BinOp, ast.operator, ast.Tuple, ast.Load)
    return all(isinstance(part, allowed) and not isinstance(getattr(part, 'value', 0), str)
               for part in ast.walk(value))


def _value(value: ast.expr) -> str:
    return f'`{ast.unparse(value)}`'


def python_page() -> str:
    """Every public name of the package, from its signature and docstring."""
    functions, classes = [], []
    for name in saddlering_ros.__all__:
        item = getattr(saddlering_ros, name)
        if inspect.isclass(item):
            classes += _class_lines(name, item)
        elif callable(item):
            functions += [f'### {name}', '', *_signature(name, item), *_docstring(item)]
    return '\n'.join([
        '# Python reference', '', DOCUMENT, 'All names are imported from `saddlering_ros`. '
        '[Python API](../python_api.md) explains their use and states what stays stable.', '',
        '## Functions', '', *functions, '## Classes', '', *classes])


def _class_lines(name: str, item: type) -> list[str]:
    lines = [f'### {name}', '', *_docstring(item)]
    rows = []
    members = {key: value for kind in reversed(item.__mro__) for key, value in vars(kind).items()
               if kind.__module__.startswith('saddlering_ros')}
    for member, value in sorted(members.items()):
        if member.startswith('_') or inspect.getdoc(value) is None:
            continue
        if isinstance(value, (property, cached_property)):
            rows.append(f'| `{member}` | {_cell(_first_line(value))} |')
        elif inspect.isfunction(value):
            shown = inspect.signature(value)
            given = [str(one.replace(annotation=one.empty)) for key, one in
                     shown.parameters.items() if key != 'self']
            rows.append(f'| `{member}({", ".join(given)})` | {_cell(_first_line(value))} |')
    return [*lines, *(['| member | meaning |', '|---|---|', *rows, ''] if rows else [])]


def _signature(name: str, item: Callable[..., object]) -> list[str]:
    parameters = inspect.signature(item).parameters.values()
    kinds = inspect.Parameter
    parts, starred = [], False
    for one in parameters:
        if one.kind is kinds.KEYWORD_ONLY and not starred:
            parts.append('*')
            starred = True
        words = str(one.replace(annotation=one.empty))
        name_only, equals, default = words.partition('=')
        parts.append(f'{name_only}: {one.annotation}' + (f' = {default}' if equals else ''))
    return ['```python', f'{name}(', *(f'    {part},' for part in parts),
            f') -> {inspect.signature(item).return_annotation}', '```', '']


def _docstring(item: object) -> list[str]:
    return [*(inspect.getdoc(item) or '').splitlines(), '']


def _first_line(item: object) -> str:
    return (inspect.getdoc(item) or '').splitlines()[0]


PAGES = {'topics.md': topics_page, 'messages.md': messages_page, 'commands.md': commands_page,
         'files.md': files_page, 'python.md': python_page, 'thresholds.md': thresholds_page,
         'nodes.md': nodes_page, 'catalogue.md': catalogue_page,
         'troubleshooting.md': lambda: troubleshooting_page(DOCUMENT)}


def write_reference(folder: Path) -> None:
    """Write every page that has changed."""
    folder.mkdir(exist_ok=True)
    for name, page in PAGES.items():
        text = page()
        file = folder / name
        if not file.exists() or file.read_text(encoding='utf-8') != text:
            file.write_text(text, encoding='utf-8')


if __name__ == '__main__':
    write_reference(Path(__file__).resolve().parent / 'reference')
