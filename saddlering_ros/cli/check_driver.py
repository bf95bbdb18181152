"""`saddlering check-driver`: faults of a driver of the rig, before the first test."""

from __future__ import annotations

import argparse
from typing import Any, TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._terminal import tell_json
from saddlering_ros.errors import BagError

if TYPE_CHECKING:
    from saddlering_ros.doubts.driver import HeardTopic
    from saddlering_ros.doubts.finding import Finding


EXAMPLES = (
    ('saddlering check-driver', 'faults of the driver; move the load meanwhile'),
    ('saddlering check-driver --rig rig.yaml --elevation 30 --rate 1000 --seconds 20',
     'for your own rig, with the required rate of every channel'),
)
UNTRIED = 'test/nodes/test_check_driver.py runs it beside the example driver'
"""Why no test types these examples."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'check-driver', help='check rates, stamps, range and signs of a rig driver',
        description='Listen to the topics of a rig for some seconds, and print one line for each '
        'fault and for each property that could not be checked. Status 2 if a fault is found.')
    parser.add_argument('--seconds', type=float, default=5.0, metavar='S',
                        help='how long to listen (default 5)')
    arguments.add_rig_option(parser)
    parser.add_argument('--elevation', type=float, default=50.0, metavar='DEG',
                        help='elevation of the barrel, from which the direction of each probe '
                             'follows (default 50)')
    parser.add_argument('--rate', type=float, metavar='HZ', help='required rate of every topic')
    arguments.add_network_options(parser)
    arguments.add_json_option(parser, 'write the findings as JSON; - for stdout')


def run(args: argparse.Namespace) -> int:
    """Listen, check, print; status 2 if a fault is found."""
    import math
    import sys

    from saddlering_ros.doubts.driver import check_driver
    from saddlering_ros.doubts.finding import FAULT
    from saddlering_ros.rig import load_rig
    from saddlering_ros.ros.driver_listener import listen
    from saddlering_ros.ros.launcher import prepare_transport
    from saddlering_ros.ros.names import namespace_of

    if not 0.5 <= args.seconds <= 3600.0:
        raise BagError(f'--seconds {args.seconds:g}: give 0.5 to 3600')
    if args.rate is not None and not 0.0 < args.rate < 1e6:
        raise BagError(f'--rate {args.rate:g}: give hertz above 0')
    rig, namespace = load_rig(args.rig), namespace_of(args.namespace)
    prepare_transport()
    heard = listen(arguments.domain_of(args), namespace, args.seconds)
    found = check_driver(rig, heard, math.radians(args.elevation), args.rate)
    count = sum(one.severity == FAULT for one in found)
    document = {
        'faults': count,
        'findings': [{'level': one.severity, 'topic': one.where, 'words': one.words}
                     for one in found],
        'topics': {name: _figures(one) for name, one in heard.items()}}
    if not tell_json(args, document):
        _print(heard, found)
    if count:
        sys.stdout.flush()
        print(f'saddlering check-driver: {count} fault{"s" * (count > 1)}: correct the driver '
              'before a test', file=sys.stderr)
    return 2 if count else 0


def _figures(one: HeardTopic) -> dict[str, Any]:
    from math import isfinite

    import numpy as np

    values = one.values[np.isfinite(one.values)]
    figures = {'rate': one.rate, 'delay': one.delay,
               'mean': float(values.mean()) if len(values) else float('nan')}
    return {'samples': len(one), 'publishers': one.publishers,
            **{name: value if isfinite(value) else None for name, value in figures.items()}}


def _print(heard: dict[str, HeardTopic], found: list[Finding]) -> None:
    for name, one in heard.items():
        figures = _figures(one)
        if figures['rate'] is not None and figures['mean'] is not None:
            print(f'{name}: {len(one)} samples at {figures["rate"]:.5g} Hz, mean '
                  f'{figures["mean"]:.6g}, {1e3 * figures["delay"]:.3g} ms from stamp to arrival')
    for finding in found:
        print(f'{finding.severity}: {finding}')
    if not found:
        print('this driver has no fault')
