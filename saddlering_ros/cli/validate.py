"""`saddlering validate`: the prediction of bags by a parameter file, as table, JSON and plots."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from saddlering_ros.cli._result import finish


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    from saddlering_ros.cli._samples import (
        add_fact_options,
        add_parameter_options,
        add_trust_option,
    )

    parser = subparsers.add_parser('validate', help='check how well parameters predict bags')
    parser.add_argument('bags', nargs='+', metavar='BAG', help='runs to predict')
    add_parameter_options(parser)
    parser.add_argument('--rig', type=Path, help='rig file (default: the shipped rig)')
    parser.add_argument('--json', metavar='FILE', help='write all figures as JSON; - for stdout')
    parser.add_argument('--plots', type=Path, metavar='DIR',
                        help='write figures of simulated and measured over load and time, one '
                             'per run')
    parser.add_argument('--report', type=Path, metavar='FILE.html', help='write a report')
    add_fact_options(parser)
    add_trust_option(parser)


def run(args: argparse.Namespace) -> int:
    """Validate and print, write or emit the figures."""
    from saddlering_ros import load_rig, read_parameters, validate
    from saddlering_ros.cli._progress import Bar
    from saddlering_ros.cli._samples import bags_of, take_effects

    take_effects(args)
    read_parameters(args.params)  # a fault there is reported before any bag is read
    bags = bags_of(args, args.bags, load_rig(args.rig))
    with Bar() as bar:
        found = validate(bags, parameters=args.params, rig=args.rig,
                         trust_rig=args.trust_rig, on_progress=bar.tell)
    written = [] if args.plots is None else found.save_plots(args.plots)
    if args.report is not None:
        written += found.write_report(args.report, command=args.command_line)
    return finish(args, found, *written)
