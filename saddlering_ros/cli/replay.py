"""`saddlering replay`: a bag through the live nodes, in real processes, without ros2cli."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from saddlering_ros.cli._json import tell_json

RECORDER = 'saddlering_recorder'


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
    parser.add_argument('--namespace', default='', metavar='NS',
                        help='namespace of the rig, so that several rigs share a domain '
                             '(default: the root)')
    parser.add_argument('--record', type=Path, metavar='OUT',
                        help='record everything, results included, into this bag (lossless: the '
                             'replay waits for the recorder)')
    parser.add_argument('--overwrite', action='store_true',
                        help='replace an existing bag with --record')
    parser.add_argument('--json', metavar='FILE',
                        help='write what was replayed as JSON; - for stdout')
    parser.add_argument('--log', type=Path, metavar='FOLDER', help='keep what the nodes say here')


def run(args: argparse.Namespace) -> int:
    """Replay until the bag is at its end, or until Ctrl-C."""
    import contextlib
    import os
    import time

    from saddlering_ros.bags import read_raw
    from saddlering_ros.rig import load_rig, read_parameters
    from saddlering_ros.ros.errors import NodeError
    from saddlering_ros.ros.launcher import REPLAY_NODES, RING_NODES, start_nodes
    from saddlering_ros.ros.names import namespace_of

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
    clock: dict[str, Any] = {}
    with contextlib.ExitStack() as stack:
        recorder = None
        if args.record is not None:
            recorder = stack.enter_context(_recording(args, record.facts, domain))
            clock['participants'] = [*REPLAY_NODES, *RING_NODES, RECORDER]
        group = stack.enter_context(start_nodes(
            args.bag, rate=args.rate, domain_id=domain, log_folder=args.log,
            parameters={'ring_simulator': simulator, 'replay_clock': clock},
            files=[] if args.rig is None else [args.rig],
            namespace=namespace_of(args.namespace)))
        if args.json != '-':
            print(f'replaying {args.bag} ({length:.1f} s) in ROS domain {domain}; Ctrl-C ends it',
                  flush=True)
        began = time.monotonic()
        _wait(group, began + patience, length / args.rate if args.rate else None)
        took = time.monotonic() - began
        counts = {} if recorder is None else recorder.counts()
    _tell(args, {'bag': str(args.bag), 'domain': domain, 'duration': length, 'seconds': took,
                 'recorded': None if args.record is None else str(args.record),
                 'messages': counts})
    return 0


def _wait(group: Any, deadline: float, seconds: float | None) -> None:
    """Wait until the bag is at its end; a bar on a terminal where the time is known."""
    import time

    from saddlering_ros.cli._progress import Bar

    began = time.monotonic()
    with Bar() as bar:
        while group.processes['replay_clock'].running and time.monotonic() < deadline:
            group.check()
            if seconds is not None:
                bar.show('replay', min((time.monotonic() - began) / seconds, 0.99))
            time.sleep(0.02)
    group.wait('replay_clock', 0.1)


def _recording(args: argparse.Namespace, facts: Any, domain: int) -> Any:
    """The recorder, which keeps the facts of the test that is replayed."""
    import os

    from saddlering_ros.bags import TestFacts
    from saddlering_ros.live.recorder import recording
    from saddlering_ros.ros.names import namespace_of
    from saddlering_ros.ros.transport import prepare_transport

    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    prepare_transport()
    known = {}
    elevation = facts.elevation_deg if args.elevation is None else args.elevation
    if facts.test is not None and elevation is not None:
        known = TestFacts(facts.test, elevation, facts.rig, facts.run).as_text()
    return recording(args.record, domain, facts=known, overwrite=args.overwrite,
                     namespace=namespace_of(args.namespace))


def _tell(args: argparse.Namespace, told: dict[str, Any]) -> None:
    if tell_json(args, told):
        return
    print('the bag is at its end')
    if args.record is not None:
        print(f'written: {args.record}, {sum(told["messages"].values())} messages')
