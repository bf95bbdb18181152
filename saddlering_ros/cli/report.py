"""`saddlering report`: a report on parameters and their predictions."""

from __future__ import annotations

import argparse
from typing import Any

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli import validate

EXAMPLES = (
    ('saddlering report bags/static_70 --params params.yaml --out parameters.html',
     'a report on the prediction of another test'),
)


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'report', help='write a report on parameters and their predictions',
        description='Write one HTML file that opens offline: the parameters with their '
        'uncertainty, and simulation beside measurement for the given bags. saddlering diagnose '
        '--report writes the report of a diagnosis.')
    arguments.add_bags_options(parser, 'runs to predict')
    arguments.add_parameter_options(parser)
    parser.add_argument('--out', dest='report', type=arguments.page_written, required=True,
                        metavar='FILE.html', help='the report to write')
    arguments.add_json_option(parser, 'write all figures as JSON; - for stdout')
    parser.set_defaults(plots=None)


def run(args: argparse.Namespace) -> int:
    """Validate, and write the page."""
    return validate.run(args)
