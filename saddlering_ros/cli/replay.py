"""`saddlering replay`: a bag through the live nodes, in real processes, without ros2cli."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'replay', help='replay a bag through the live nodes',
        description='Start the replay, displacement, simulator and residual nodes on a bag and '
                    'end them with it. Other ROS 2 programs hear them in the same ROS domain.')
    parser.add_argument('bag', type=Path, metavar='BAG', help='the bag to replay')
    parser.add_argument('--params', type=Path, help='contact parameters to simulate with')
    parser.add_argument('--rig', type=Path, help='rig file (default: the shipped rig)')
    parser.add_argument('--elevation', type=float, metavar='DEG',
                        help='elevation of the test (default: as the bag says)')
    parser.add_argument('--rate', type=float, default=1.0,
                        help='speed; 1 is real time, 0 as fast as the nodes follow (default 1)')
    parser.add_argument('--domain', type=int, help='ROS domain (default: ROS_DOMAIN_ID, or 0)')
    parser.add_argument('--log', type=Path, metavar='FOLDER', help='keep what the nodes say here')


def run(args: argparse.Namespace) -> int:
    """Replay until the bag is at its end, or until Ctrl-C."""
    import os

    from saddlering_ros.bags import read_raw
    from saddlering_ros.nodes.errors import NodeError
    from saddlering_ros.nodes.launcher import start_nodes
    from saddlering_ros.rig import load_rig, read_parameters

    record = read_raw(args.bag)
    load_rig(args.rig)
    simulator: dict[str, Any] = {}
    if args.params is not None:
        read_parameters(args.params)
        simulator['parameters_file'] = str(args.params)
    if args.elevation is not None:
        simulator['elevation_deg'] = args.elevation
    if not 0.0 <= args.rate <= 100.0:
        raise NodeError(f'--rate {args.rate:g}: give 0 (as fast as possible) to 100')
    domain = args.domain if args.domain is not None else int(os.environ.get('ROS_DOMAIN_ID') or 0)
    length = (record.stop - record.start) / 1e9
    patience = 120.0 + 10.0 * length / min(args.rate or 1.0, 1.0)
    with start_nodes(args.bag, rate=args.rate, domain_id=domain, log_folder=args.log,
                     parameters={'ring_simulator': simulator},
                     files=[] if args.rig is None else [args.rig]) as group:
        print(f'replaying {args.bag} ({length:.1f} s) in ROS domain {domain}; Ctrl-C ends it')
        group.wait('replay_clock', patience)
    print('the bag is at its end')
    return 0
