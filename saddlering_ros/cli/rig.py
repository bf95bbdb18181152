"""`saddlering rig`: a rig file, its drawing, and its contradictions with bags."""

import argparse
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Command, option, tell_json
from saddlering_ros.errors import counted

if TYPE_CHECKING:
    from saddlering_ros.rig import Rig

COMMANDS = (Command(
    'rig', 'write, draw or check a rig file',
    'Write a commented rig file and a drawing of its ring, draw an existing rig file, or compare '
    'bags with a rig file.', (
        arguments.RIG,
        option('--draft', 'write a commented rig file (default rig.yaml) and, beside it, its '
               'drawing as SVG', type=arguments.file_written, nargs='?', const=Path('rig.yaml'),
               metavar='FILE.yaml'),
        option('--set', 'an entry of the draft in SI units, like axial_rows.rollers=48 (may be '
               'repeated)', action='append', default=[], metavar='NAME=VALUE'),
        option('--drawing', 'write the drawing here (.svg, .png or .pdf)',
               type=arguments.file_written, metavar='FILE'),
        option('--check', 'print the contradictions between these bags and the rig file',
               type=arguments.bag_read, nargs='+', default=[], metavar='BAG'),
        *arguments.METADATA,
        arguments.json_option('write the rig and the findings as JSON; - for stdout')), (
        ('saddlering rig --draft my_rig.yaml --set axial_rows.rollers=48 '
         '--set full_scale_load=98066.5', 'a rig file to complete, and a drawing of this ring'),
        ('saddlering rig --check bags/static_50',
         'contradictions between a bag and the rig file'))),)


def run(args: argparse.Namespace) -> int:
    """Draft, draw, check; status 2 if a bag speaks against the rig."""
    from saddlering_ros.doubts.comparison import rig_in_words
    from saddlering_ros.files import check_ending, write_text
    from saddlering_ros.rig import load_rig, RigError
    from saddlering_ros.rig.drawing import draft_rig_file, save_drawing

    rig = load_rig(args.rig)
    if args.set and args.draft is None:
        raise RigError('--set is an entry of a draft: give --draft too')
    written: list[Path] = []
    if args.draft is not None:
        check_ending(args.draft, ('.yaml', '.yml'), RigError)
        written = [args.draft, args.draft.with_suffix('.svg')]
        for path in written:
            if path.exists():
                raise RigError(f'{path}: exists already, and a draft does not replace it: choose '
                               'another name')
        text, rig = draft_rig_file(rig, args.set)
    if args.drawing is not None:
        save_drawing(args.drawing, rig, 50.0 if args.elevation is None else args.elevation)
        written.append(args.drawing)
    if args.draft is not None:
        if args.drawing != written[1]:
            save_drawing(written[1], rig)
        write_text(args.draft, text, RigError)
    found, alike = {}, {}
    for bag in args.check:
        found[bag], alike[bag] = contradictions(bag, rig, args.test, arguments.elevation_of(args))
    doubts = sum(len(lines) for lines in found.values())
    if not tell_json(args, {'rig_hash': rig.digest, 'written': [str(path) for path in written],
                            'checked': found, 'elevations_alike': alike}):
        print(f'rig: {rig_in_words(rig)}')
        for path in written:
            print(f'written: {path}')
        for bag, lines in found.items():
            print(f'{bag}: {"no contradiction to the rig file" if not lines else ""}'.rstrip())
            for line in lines:
                print(f'  {line}')
            if alike[bag]:
                print('  the elevation is not certain: the motion agrees with '
                      f'{" and ".join(f"{one:g}" for one in alike[bag])} deg too')
    if doubts:
        sys.stdout.flush()
        print(f'saddlering rig: {counted(doubts, "contradiction")} between the bags and the rig '
              'file: correct the rig file, or the map of the import', file=sys.stderr)
    return 2 if doubts else 0


def contradictions(bag: Path | str, rig: 'Rig', test: str | None = None,
                   elevation: float | None = None) -> tuple[list[str], list[float]]:
    """Contradictions between a bag and a rig, a line each, and other elevations [deg] that agree.

    elevation [rad] in place of the stated one.
    """
    from saddlering_ros.bags.reader import read_raw, read_run
    from saddlering_ros.doubts.on_rig import check_rig, elevations_alike
    from saddlering_ros.record.record import condensed

    run = condensed(read_run(bag, test=test, elevation=elevation, rig=rig), rig)
    findings = check_rig(rig, read_raw(bag, rig=rig), run)
    return [*findings], [] if findings else elevations_alike(rig, run)
