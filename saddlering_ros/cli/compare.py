"""`saddlering compare`: what changed in one ring between two sessions."""

from __future__ import annotations

import argparse
from typing import Any

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._terminal import Bar, finish

EXAMPLES = (
    ('saddlering compare --before 2025/static_50 2025/dynamic_50 --after 2026/static_50 '
     '2026/dynamic_50 --report change.html',
     'name what changed since the base measurement; write a report'),
)

UNTRIED = 'the shipped bags are one session of one ring'


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'compare', help='name what changed in one ring between two sessions',
        description='Name what changed in one ring between two sessions. What both sessions have '
                    'cancels, so that smaller causes show than in one session.')
    parser.add_argument('--before', type=arguments.bag_read, nargs='+', required=True,
                        metavar='BAG', help='bags of the earlier session, such as the base '
                        'measurement')
    parser.add_argument('--after', type=arguments.bag_read, nargs='+', required=True,
                        metavar='BAG', action='append', help='bags of the later session; given '
                        'several times, in order of time: a series of sessions')
    arguments.add_reading_options(parser)
    arguments.add_json_option(parser, 'write the verdict on the change as JSON; - for stdout')
    arguments.add_report_option(parser)
    parser.add_argument('--seed', type=int, default=0, help='seed of the base fit (default 0)')


def run(args: argparse.Namespace) -> int:
    """Compare and print, write or emit the verdict."""
    from saddlering_ros import compare, load_rig

    rig = load_rig(args.rig)
    before, *between, after = (
        arguments.bags_of(args, bags, rig) for bags in (args.before, *args.after))
    with Bar() as bar:
        result = compare(before, after, between=between, rig=args.rig, seed=args.seed,
                         trust_rig=args.trust_rig, on_progress=bar.tell)
    return finish(args, result)
