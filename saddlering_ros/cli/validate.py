"""`saddlering validate`: how well a parameter file predicts bags, as a table, JSON and plots."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from saddlering_ros.cli._json import tell_json


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    from saddlering_ros.cli._samples import add_fact_options

    parser = subparsers.add_parser('validate', help='compare a simulation with bags')
    parser.add_argument('bags', nargs='+', metavar='BAG', help='runs to predict')
    parser.add_argument('--params', type=Path, required=True, help='parameter file')
    parser.add_argument('--rig', type=Path, help='rig file (default: the shipped rig)')
    parser.add_argument('--json', metavar='FILE', help='write all figures as JSON; - for stdout')
    parser.add_argument('--plots', type=Path, metavar='DIR',
                        help='simulated and measured over load and time, one picture per run')
    parser.add_argument('--report', type=Path, metavar='FILE.html', help='write a report')
    add_fact_options(parser)


def run(args: argparse.Namespace) -> int:
    """Validate and print, write or emit the figures."""
    from saddlering_ros.bags import read_run
    from saddlering_ros.cli._samples import radians
    from saddlering_ros.identification import validate
    from saddlering_ros.identification.summary import validation_text
    from saddlering_ros.provenance import name_files
    from saddlering_ros.rig import load_rig, read_parameters

    rig = load_rig(args.rig)
    parameters = read_parameters(args.params)
    elevation = radians(args.elevation)
    runs = [read_run(bag, test=args.test, elevation=elevation, rig=rig) for bag in args.bags]
    found = validate(runs, rig, parameters)
    pictures = []
    if args.plots is not None:
        from saddlering_ros.identification.plots import save_plots

        pictures = save_plots(found, args.plots)
    if args.report is not None:
        from saddlering_ros.report import write_validation_report

        write_validation_report(args.report, found, runs, rig, command=args.command_line)
        pictures.append(args.report)
    if tell_json(args, name_files(found.to_json(), args.rig, args.params)):
        return 0
    print(validation_text(found))
    for picture in pictures:
        print(f'written: {picture}')
    return 0
