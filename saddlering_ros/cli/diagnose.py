"""`saddlering diagnose`: what the simulation gets wrong in bags, and why."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from saddlering_ros.cli._json import tell_json


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser('diagnose', help='show and name what the simulation gets wrong')
    parser.add_argument('bags', nargs='+', metavar='BAG', help='runs to explain')
    parser.add_argument(
        '--hold-out',
        nargs='+',
        default=[],
        metavar='BAG',
        help='runs kept sealed, on which the gain is measured',
    )
    parser.add_argument('--rig', type=Path, help='rig file (default: the shipped rig)')
    parser.add_argument('--params', type=Path, help='parameter file to start from')
    parser.add_argument('--json', metavar='FILE', help='write the verdict as JSON; - for stdout')
    parser.add_argument('--report', type=Path, metavar='FILE.html', help='write a report')
    parser.add_argument('--out', type=Path, help='write the extended parameter file here')
    parser.add_argument('--seed', type=int, default=0, help='seed of the base fit (default 0)')


def run(args: argparse.Namespace) -> int:
    """Diagnose and print, write or emit the verdict."""
    from saddlering_ros.cli._progress import Bar
    from saddlering_ros.diagnosis import diagnose_bags
    from saddlering_ros.diagnosis.summary import verdict_text
    from saddlering_ros.provenance import name_files
    from saddlering_ros.rig import (
        load_rig,
        read_parameters,
        write_parameters,
    )

    rig = load_rig(args.rig)
    parameters = None if args.params is None else read_parameters(args.params)
    with Bar() as bar:
        verdict = diagnose_bags(
            args.bags, args.hold_out, rig, parameters, seed=args.seed,
            on_progress=lambda stage, share: bar.show('diagnose', share, stage),
        )
    if args.out is not None:
        write_parameters(args.out, verdict.extended_parameters())
    if args.report is not None:
        from saddlering_ros.report import write_diagnosis_report

        write_diagnosis_report(verdict, args.report, args.command_line)
    if tell_json(args, name_files(verdict.to_json(), args.rig, args.params)):
        return 0
    print(verdict_text(verdict))
    for path in (args.out, args.report):
        if path is not None:
            print(f'written: {path}')
    return 0
