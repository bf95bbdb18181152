"""`saddlering live`: a page in the browser that shows a running test."""

import argparse

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Command, option, tell_json, Within

COMMANDS = (Command(
    'live', 'show a running test in the browser',
    'Serve a page with load, displacement, residual, the state of every node, and the progress of '
    'identification and diagnosis. The page shows all nodes of the ROS domain and does not '
    'disturb them.', (
        option('--port', 'port of the page; 0 takes a free one (default 8765)',
               type=Within(int, 0, 65535), default=8765),
        option('--host', 'address to serve on; every other address than the default needs a token '
               '(default 127.0.0.1: this machine only)', default='127.0.0.1'),
        option('--token', 'token that a browser must give (default for other machines: a random '
               'one)', default=''),
        *arguments.NETWORK,
        option('--rig', 'rig file of the drawing, and of the unit of loads (default: that of '
               'SADDLERING_RIG, or the shipped rig)', type=arguments.file_read),
        option('--window', 'longest time shown, in seconds (default 600)',
               type=Within(float, 1.0, 86400.0, ' seconds'), default=600.0, metavar='S'),
        arguments.json_option('write the address as JSON; - for stdout')), (
        ('saddlering live', 'then, in another terminal: saddlering replay bags/dynamic_50'),
        ('saddlering live --host 0.0.0.0',
         'for other machines; the printed address contains a token'))),)


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    from saddlering_ros.live.server import Address, serve
    from saddlering_ros.live.watcher import Watcher
    from saddlering_ros.rig import load_rig
    from saddlering_ros.ros.launcher import prepare_middleware
    from saddlering_ros.ros.names import namespace_of

    domain = arguments.domain_of(args)
    rig = load_rig(args.rig)
    prepare_middleware()

    def say(where: Address) -> None:
        if not tell_json(args, {'url': where.url, 'domain': domain}):
            print(f'{where.url} shows ROS domain {domain}; Ctrl-C ends it', flush=True)

    with Watcher(domain, args.window, namespace_of(args.namespace), rig) as watcher:
        serve(watcher, Address(args.host, args.port, args.token), say)
    return 0
