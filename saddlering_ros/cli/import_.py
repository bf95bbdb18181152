"""`saddlering import`: conversion of measured files of a data logger to a bag."""

import argparse
from collections.abc import Sequence
from contextlib import suppress
from itertools import combinations
import math
from pathlib import Path
import re
import shlex
import sys
from typing import TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, option, tell_json
from saddlering_ros.errors import BagError, counted, printable

if TYPE_CHECKING:
    from saddlering_ros.importing.convert import ImportResult
    from saddlering_ros.rig import Rig

REMEDY = re.compile('publish (metres|newtons)')
"""What a driver must do about a wrong unit; here the map is corrected."""

COMMANDS = (Command(
    'import', 'convert files of a data logger to a bag',
    'Write measured files as a bag, by a map of columns to channels (MAP.yaml). Units are stated '
    'in the map, never guessed.', (
        option('files', 'measured files', nargs='+', type=arguments.file_read, metavar='FILE'),
        option('--map', 'the map: column and unit of each channel', type=arguments.file_read,
               metavar='MAP.yaml'),
        option('--out', 'the bag to write; a folder of bags if the map splits runs',
               type=arguments.bag_written, metavar='BAG'),
        option('--draft', 'print the content of the files and a draft of the map, which --map '
               'receives', action='store_true'),
        option('--rig', 'rig file: its hash goes into the bag, its probes give the range',
               type=arguments.file_read),
        option('--preview', 'write a figure of load and gaps over time',
               type=arguments.file_written, metavar='FILE.png'),
        arguments.json_option(),
        option('--overwrite', 'replace a bag at --out', action='store_true')), (
        ('saddlering import docs/data/static_30.csv --draft',
         'the content of a file, and a draft of its map'),
        ('saddlering import docs/data/static_30.csv --map docs/data/map_static_30.yaml '
         '--rig docs/data/rig.yaml --out measured/static_30 --preview measured/static_30.png',
         'the file as a bag, with a figure'))),)


def run(args: argparse.Namespace) -> int:
    """Draft a map, or write the bag and print its content."""
    from saddlering_ros.files import write_text
    from saddlering_ros.importing.calibration import ImportingError
    from saddlering_ros.importing.convert import draft_map
    from saddlering_ros.importing.source import open_sources

    if not args.draft:
        return _import(args)
    if args.map is not None and args.map.exists():
        raise ImportingError(f'{args.map}: exists already, and a draft does not replace it: '
                             'choose another name')
    text, seen = draft_map(open_sources(args.files))
    if args.map is None:
        print(*seen, sep='\n', file=sys.stderr)
        print(text, end='')
        return 0
    write_text(args.map, text, ImportingError)
    print(*seen, sep='\n')
    command = ['saddlering', 'import', *args.files, '--map', args.map, '--out', 'BAG']
    print(f'written: {args.map}; complete every TODO in it, then: {_typed(command)}')
    return 0


def _import(args: argparse.Namespace) -> int:
    from saddlering_ros.files import check_ending, spare_files
    from saddlering_ros.importing.calibration import ImportingError, Table, words_of
    from saddlering_ros.importing.convert import import_files, PREVIEW_ENDINGS, save_preview
    from saddlering_ros.importing.mapping import read_map
    from saddlering_ros.rig import load_rig

    if args.map is None or args.out is None:
        raise ImportingError('--map and --out are both needed: give --map MAP.yaml --out BAG, or '
                             'start with --draft --map MAP.yaml')
    if args.preview is not None:  # before the bag is written
        check_ending(args.preview, PREVIEW_ENDINGS, ImportingError)
    mapping = read_map(args.map)
    tables = [channel.calibration.path for channel in mapping.channels
              if isinstance(channel.calibration, Table)]
    named = [(table, f'table {table}') for table in tables]  # which no output replaces
    for name, given in (('out', args.out), ('json', args.json), ('preview', args.preview)):
        if given is not None and str(given) != '-':
            spare_files(Path(given), f'--{name} {given}', named)
    rig = load_rig(args.rig) if args.rig is not None else None
    shown = rig or load_rig()
    with Bar() as bar:
        result = import_files(
            args.files, mapping, args.out, rig=rig, overwrite=args.overwrite,
            on_progress=lambda samples: bar.show('import', 0.0, counted(samples, 'sample')))
    if args.preview is not None:
        save_preview(args.preview, result.runs, shown)
    warnings = [*result.warnings, *_doubts(args, result, shown)]
    for line in warnings:
        print(f'saddlering import: warning: {printable(line)}', file=sys.stderr)
    if tell_json(args, {**result.as_dict(), 'warnings': warnings}):
        return 0
    for run in result.runs:
        print(f'{run.path}: {run.metadata.test} test at {run.metadata.elevation_deg:g} deg, '
              f'{(run.stop - run.start) / 1e9:.3f} s from {words_of(run.start)}')
        for name, course in run.courses.items():
            print(f'  {name}: {counted(course.count, "sample")}, '
                  f'{_reading(name, min(course.lowest), shown)} to '
                  f'{_reading(name, max(course.highest), shown)}')
    if args.preview is not None:
        print(f'written: {args.preview}')
    by = [] if args.rig is None else ['--rig', args.rig]
    print(f'next: {_typed(["saddlering", "info", result.runs[0].path, *by])}')
    return 0


def _typed(words: Sequence[Path | str]) -> str:
    """A command as it is typed in a shell."""
    return shlex.join(map(str, words))


def _doubts(args: argparse.Namespace, result: 'ImportResult', rig: 'Rig') -> list[str]:
    """Findings of `info` on the bags, and of `rig --check` where a rig file is given."""
    from saddlering_ros.bags.reader import bag_info, read_run
    from saddlering_ros.cli.rig import contradictions
    from saddlering_ros.doubts.comparison import overlap_words

    lines, records = [], {}
    for run in result.runs:
        if any(run.start <= other.stop and other.start <= run.stop
               for other in result.runs if other is not run):
            with suppress(BagError):  # which is one of the problems below
                records[run.path] = read_run(run.path, rig=rig)
    for first, second in combinations(records, 2):
        if words := overlap_words(records[first], records[second]):
            lines.append(f'{second}: {words}')
    for run in result.runs:
        info = bag_info(run.path, rig=rig)
        doubts = [arguments.in_options(line) for line in (*info.problems, *info.notes)]
        if args.rig is not None and not info.problems:
            doubts += contradictions(run.path, rig)[0]
        doubts = [REMEDY.sub('correct unit or scale in the map', line) for line in doubts]
        lines += [line if line.startswith(str(run.path)) else f'{run.path}: {line}'
                  for line in dict.fromkeys(doubts)]
    return lines


def _reading(name: str, value: float, rig: 'Rig') -> str:
    if name.startswith('eddy'):
        return f'{value * 1e3:.4f} mm'
    if name == 'elevation':
        return f'{math.degrees(value):.3f} deg'
    return rig.force_words(value, 3)
