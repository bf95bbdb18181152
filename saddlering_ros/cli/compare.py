"""`saddlering compare`: what changed in one ring between two sessions."""

from __future__ import annotations

import argparse
from typing import Any

from saddlering_ros.cli._arguments import (
    add_fact_options,
    add_json_option,
    add_rig_option,
    add_trust_option,
    bag_read,
    page_written,
)
from saddlering_ros.cli._terminal import finish

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
    parser.add_argument('--before', type=bag_read, nargs='+', required=True, metavar='BAG',
                        help='bags of the earlier session, such as the base measurement')
    parser.add_argument('--after', type=bag_read, nargs='+', required=True, metavar='BAG',
                        action='append', help='bags of the later session; given several times, '
                        'in order of time: a series of sessions')
    add_rig_option(parser)
    add_json_option(parser, 'write the verdict on the change as JSON; - for stdout')
    parser.add_argument('--report', type=page_written, metavar='FILE.html', help='write a report')
    parser.add_argument('--seed', type=int, default=0, help='seed of the base fit (default 0)')
    add_fact_options(parser)
    add_trust_option(parser)


def run(args: argparse.Namespace) -> int:
    """Compare and print, write or emit the verdict."""
    from saddlering_ros import compare, load_rig
    from saddlering_ros.cli._samples import bags_of
    from saddlering_ros.cli._terminal import Bar

    rig = load_rig(args.rig)
    before, *between, after = (
        bags_of(args, bags, rig) for bags in (args.before, *args.after))
    with Bar() as bar:
        result = compare(before, after, between=between, rig=args.rig, seed=args.seed,
                         trust_rig=args.trust_rig, on_progress=bar.tell)
    pages = () if args.report is None else result.write_report(
        args.report, command=args.command_line)
    return finish(args, result, *pages)
