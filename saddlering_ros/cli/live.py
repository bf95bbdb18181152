"""`saddlering live`: a page in the browser that shows a running test."""

from __future__ import annotations

import argparse
from typing import Any

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._terminal import tell_json
from saddlering_ros.errors import LiveError

EXAMPLES = (
    ('saddlering live', 'then, in another terminal: saddlering replay bags/dynamic_50'),
    ('saddlering live --host 0.0.0.0', 'for other machines; the printed address contains a '
                                       'token'),
)
UNTRIED = 'serves until it is ended'
"""Why no test types these examples."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'live', help='show a running test in the browser',
        description='Serve a page with load, displacement, residual, the state of every node, '
        'and the progress of identification and diagnosis. The page shows all nodes of the ROS '
        'domain and does not disturb them.')
    parser.add_argument('--port', type=int, default=8765,
                        help='port of the page; 0 takes a free one (default 8765)')
    parser.add_argument('--host', default='127.0.0.1',
                        help='address to serve on; every other address than the default needs a '
                             'token (default 127.0.0.1: this machine only)')
    parser.add_argument('--token', default='',
                        help='token that a browser must give (default for other machines: a '
                             'random one)')
    arguments.add_network_options(parser)
    arguments.add_rig_option(parser, 'rig file of the drawing, and of the unit of loads (default: '
                                     'that of SADDLERING_RIG, or the shipped rig)')
    parser.add_argument('--window', type=float, default=600.0, metavar='S',
                        help='longest time shown, in seconds (default 600)')
    arguments.add_json_option(parser, 'write the address as JSON; - for stdout')


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    from saddlering_ros.live.server import Address, address, serve
    from saddlering_ros.live.watcher import Watcher
    from saddlering_ros.rig import load_rig
    from saddlering_ros.ros.launcher import prepare_transport
    from saddlering_ros.ros.names import namespace_of

    if not 0 <= args.port <= 65535:
        raise LiveError(f'--port {args.port}: give 0 to 65535')
    if not 1.0 <= args.window <= 86400.0:
        raise LiveError(f'--window {args.window:g}: give 1 to 86400 seconds')
    domain = arguments.domain_of(args)
    rig = load_rig(args.rig)
    prepare_transport()

    def say(where: Address) -> None:
        if not tell_json(args, {'url': where.url, 'domain': domain}):
            print(f'{where.url} shows ROS domain {domain}; Ctrl-C ends it', flush=True)

    with Watcher(domain, args.window, namespace_of(args.namespace), rig) as watcher:
        serve(watcher, address(args.host, args.port, args.token), say, rig=rig)
    return 0
