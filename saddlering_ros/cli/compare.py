"""`saddlering compare`: what changed in one ring between two sessions."""

import argparse

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, finish, option

COMMANDS = (Command(
    'compare', 'name what changed in one ring between two sessions',
    'Name what changed in one ring between two sessions. What both sessions have cancels, so that '
    'smaller causes show than in one session.', (
        option('--before', 'bags of the earlier session, such as the base measurement',
               type=arguments.bag_read, nargs='+', required=True, metavar='BAG'),
        option('--after', 'bags of the later session; given several times, in order of time: a '
               'series of sessions', type=arguments.bag_read, nargs='+', required=True,
               metavar='BAG', action='append'),
        *arguments.READING,
        arguments.json_option('write the verdict on the change as JSON; - for stdout'),
        arguments.REPORT,
        option('--seed', 'seed of the base fit (default 0)', type=int, default=0)), (
        ('saddlering compare --before 2025/static_50 2025/dynamic_50 --after 2026/static_50 '
         '2026/dynamic_50 --report change.html',
         'name what changed since the base measurement; write a report'),)),)


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
