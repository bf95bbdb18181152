"""`saddlering validate` and `report`: the prediction of bags by a parameter file."""

from __future__ import annotations

import argparse
from typing import Any

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._terminal import Bar, finish

EXAMPLES = (
    ('saddlering validate bags/static_70 bags/dynamic_70 --params params.yaml '
     '--plots pictures',
     'figures of merit for each channel, and a figure of each run'),
    ('saddlering report bags/static_70 --params params.yaml --out parameters.html',
     'a report on the prediction of another test'),
)


def add_parser(subparsers: Any) -> None:
    """Declare the subcommands."""
    for name, words, description in (
        ('validate', 'check how well parameters predict bags',
         'Simulate tests with given parameters, and compare the prediction with the measurement '
         'by figures of merit for each channel.'),
        ('report', 'write a report on parameters and their predictions',
         'Write one HTML file that opens offline: the parameters with their uncertainty, and '
         'simulation beside measurement for the given bags. saddlering diagnose --report writes '
         'the report of a diagnosis.'),
    ):
        parser = subparsers.add_parser(name, help=words, description=description)
        arguments.add_bags_options(parser, 'runs to predict')
        arguments.add_parameter_options(parser)
        arguments.add_json_option(parser, 'write all figures as JSON; - for stdout')
        if name == 'report':
            parser.add_argument('--out', dest='report', type=arguments.page_written, required=True,
                                metavar='FILE.html', help='the report to write')
            parser.set_defaults(plots=None)
        else:
            parser.add_argument('--plots', type=arguments.folder_filled, metavar='DIR',
                                help='write figures of simulated and measured over load and '
                                     'time, one per run')
            arguments.add_report_option(parser)


def run(args: argparse.Namespace) -> int:
    """Validate and print, write or emit the figures."""
    from saddlering_ros import load_rig, read_parameters, validate

    arguments.take_effects(args)
    read_parameters(args.params)  # a fault there is reported before any bag is read
    bags = arguments.bags_of(args, args.bags, load_rig(args.rig))
    with Bar() as bar:
        found = validate(bags, parameters=args.params, rig=args.rig,
                         trust_rig=args.trust_rig, on_progress=bar.tell)
    written = [] if args.plots is None else found.save_plots(args.plots)
    return finish(args, found, *written)
