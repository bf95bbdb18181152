"""`saddlering report`: a report on parameters and their predictions."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from saddlering_ros.cli._arguments import (
    add_fact_options,
    add_json_option,
    add_parameter_options,
    add_rig_option,
    add_trust_option,
    bag_read,
    file_read,
    page_written,
    take_effects,
)
from saddlering_ros.cli._terminal import tell_json

MAX_IDENTIFICATION = 64 << 20
"""Size of the largest JSON file of an identification that is read [bytes]."""


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
    parser.add_argument('bags', type=bag_read, nargs='+', metavar='BAG', help='runs to predict')
    add_parameter_options(parser)
    parser.add_argument('--identification', type=file_read, metavar='FILE.json',
                        help='JSON of the identification, from `saddlering identify --json`')
    add_rig_option(parser)
    parser.add_argument('--out', type=page_written, required=True, metavar='FILE.html',
                        help='the report to write')
    add_json_option(parser, 'write all figures as JSON; - for stdout')
    add_fact_options(parser)
    add_trust_option(parser)


def run(args: argparse.Namespace) -> int:
    """Validate, and write the page."""
    from saddlering_ros import load_rig, read_parameters, validate
    from saddlering_ros.cli._samples import bags_of

    take_effects(args)
    read_parameters(args.params)  # a fault there is reported before any bag is read
    identification = _identification(args.identification)
    bags = bags_of(args, args.bags, load_rig(args.rig))
    found = validate(bags, parameters=args.params, rig=args.rig, trust_rig=args.trust_rig)
    written = found.write_report(args.out, command=args.command_line,
                                 identification=identification)
    if tell_json(args, found.to_json()):
        return 0
    for path in written:
        print(f'written: {path}')
    return 0


def _identification(path: Path | None) -> dict[str, Any] | None:
    """The JSON of an identification; ReportError if it is something else."""
    import json

    from saddlering_ros.pages import ReportError
    from saddlering_ros.plain_yaml import read_regular_text

    if path is None:
        return None
    text = read_regular_text(path, ReportError, MAX_IDENTIFICATION)
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as problem:
        raise ReportError(f'{path}: is not JSON ({problem}): give the file of saddlering '
                          'identify --json') from problem
    if not isinstance(found, dict) or not {'parameters', 'evaluations', 'status'} <= set(found):
        raise ReportError(f'{path}: is not the result of an identification: give the file of '
                          'saddlering identify --json')
    return found
