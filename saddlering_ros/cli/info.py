"""`saddlering info`: show the content of a bag and its faults."""

import argparse
import math
import sys
from typing import TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, show_table, stdout_console, tell_json
from saddlering_ros.errors import BagError, counted, printable

if TYPE_CHECKING:
    from saddlering_ros.bags.reader import BagInfo, TopicInfo
    from saddlering_ros.rig import Rig

COMMANDS = (Command(
    'info', 'show the content of a bag and its faults',
    'Print the test, the topics with their rates and ranges, and every fault of each bag. Status '
    '2 if a bag cannot be used.', (
        arguments.bags_option('rosbag2 directory or .mcap file'), *arguments.METADATA,
        arguments.RIG, arguments.json_option('write all figures as JSON; - for stdout')), (
        ('saddlering info bags/static_50', 'the content of a bag and its faults'),
        ('saddlering info bags/static_50 bags/dynamic_50 --json -',
         'the same for a program'))),)


def run(args: argparse.Namespace) -> int:
    """Show every bag; status 2 if one of them cannot be used."""
    from saddlering_ros.bags.reader import bag_info
    from saddlering_ros.rig import load_rig

    rig = load_rig(args.rig)
    problems = []
    documents = []
    reader_gone = None
    for bag in args.bags:
        try:
            with Bar() as bar:
                info = bag_info(bag, test=args.test, elevation=arguments.elevation_of(args),
                                rig=rig, on_progress=bar.reading(bag))
        except BagError as problem:
            problems.append(str(problem))
            documents.append({'path': bag, 'usable': False, 'problems': [str(problem)]})
            continue
        problems += info.problems[:1]
        documents.append(info.as_dict())
        if args.json == '-' or reader_gone is not None:
            continue
        try:
            _print_info(bag, info, rig)
        except BrokenPipeError as problem:  # as with `| head`: the file is wanted all the same
            if args.json is None:
                raise
            reader_gone = problem
    tell_json(args, documents)
    if reader_gone is not None:
        raise reader_gone
    if not problems:
        return 0
    sys.stdout.flush()
    more = f' (and {counted(len(problems) - 1, "more unusable bag")})' if len(problems) > 1 else ''
    first = printable(arguments.in_options(problems[0]))
    print(f'saddlering info: {first}{more}', file=sys.stderr)
    return 2


def _print_info(bag: str, info: 'BagInfo', rig: 'Rig') -> None:
    from rich.table import Table
    from rich.text import Text

    from saddlering_ros.rig import FORCE_UNITS

    console = stdout_console()
    console.print(Text(bag, style='bold'))
    facts = Table(box=None, show_header=False, padding=(0, 2))
    stated, (low, high) = info.facts, info.load_range
    loads: list[str] = []
    for unit, newtons in FORCE_UNITS.items():
        digits = 3 if unit == 't' else 2
        words = f'{low / newtons:.{digits}f} to {high / newtons:.{digits}f} {unit}'
        loads.insert(0 if unit == rig.force_unit else 1, words)
    for name, value in (
            ('test', stated.test or 'not stated'),
            ('elevation', 'not stated' if stated.elevation_deg is None else
             f'{stated.elevation_deg:g} deg'),
            ('rig', stated.rig), ('rig hash', stated.details.get('rig_hash', '')[:12]),
            ('run', stated.run),
            ('storage', f'{counted(info.files, "file")}, {info.size / 1e6:.2f} MB, '
             f'{counted(info.message_count, "message")}, compression '
             + (', '.join(printable(name) or 'none' for name in info.compressions) or 'unknown')),
            ('duration', '' if math.isnan(info.duration) else f'{info.duration:.3f} s'),
            ('load', '' if math.isnan(high) else f'{loads[0]} ({loads[1]})'),
            ('plateaus', '' if info.plateaus is None else str(info.plateaus))):
        if value:
            facts.add_row(name, value)
    console.print(facts)
    show_table(('topic', 'type', 'messages', 'rate', 'from', 'to', 'gaps', 'lowest', 'highest'),
               [_topic_row(topic, rig) for topic in info.topics], texts=2)
    for problem in info.problems:
        console.print(Text(f'  wrong: {printable(arguments.in_options(problem))}', style='red'))
    for note in info.notes:
        console.print(Text(f'  note: {printable(note)}', style='yellow'))
    if not info.problems:
        console.print(Text('  usable; read the notes' if info.notes else '  usable',
                           style='yellow' if info.notes else 'green'))
    console.print()


def _topic_row(topic: 'TopicInfo', rig: 'Rig') -> tuple[str, ...]:
    name = printable(topic.topic), printable(topic.type)
    if math.isnan(topic.rate):
        return (*name, str(topic.count), *[''] * 6)
    gaps = f'{topic.gaps} (<= {topic.longest_gap:.3f} s)' if topic.gaps else '0'
    if topic.type.startswith('geometry_msgs'):
        values = [rig.force_words(value, 3) for value in (topic.lowest, topic.highest)]
    else:
        values = [f'{value * 1e6:.2f} µm' for value in (topic.lowest, topic.highest)]
    return (*name, str(topic.count), f'{topic.rate:.1f} Hz',
            f'{topic.start:.3f} s', f'{topic.start + topic.duration:.3f} s', gaps, *values)
