"""`saddlering check-driver`, `live` and `record`: commands that listen to a running rig."""

import argparse
import atexit
import math
import signal
import sys
import time
from typing import TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Command, option, tell_json, Within
from saddlering_ros.errors import BagError

if TYPE_CHECKING:
    from saddlering_ros.rig import Rig

COMMANDS = (
    Command(
        'check-driver', 'check rates, stamps, range and signs of a rig driver',
        'Listen to the topics of a rig for some seconds, and print one line for each fault and '
        'for each property that could not be checked. Status 2 if a fault is found.', (
            option('--seconds', 'how long to listen (default 5)', type=Within(float, 0.5, 3600.0),
                   default=5.0, metavar='S'),
            arguments.RIG,
            option('--elevation', 'elevation of the barrel, from which the direction of each '
                   'probe follows (default 50)', type=Within(float, -10.0, 90.0), default=50.0,
                   metavar='DEG'),
            option('--rate', 'required rate of every topic', type=Within(float, 1e-3, 1e6),
                   metavar='HZ'),
            *arguments.NETWORK,
            arguments.json_option('write the findings as JSON; - for stdout')), (
            ('saddlering check-driver', 'faults of the driver; move the load meanwhile'),
            ('saddlering check-driver --rig rig.yaml --elevation 30 --rate 1000 --seconds 20',
             'for your own rig, with the required rate of every channel'))),
    Command(
        'live', 'show a running test in the browser',
        'Serve a page with load, displacement, residual, the state of every node, and the '
        'progress of identification and diagnosis. The page shows all nodes of the ROS domain and '
        'does not disturb them.', (
            option('--port', 'port of the page; 0 takes a free one (default 8765)',
                   type=Within(int, 0, 65535), default=8765),
            option('--host', 'address to serve on; every other address than the default needs a '
                   'token (default 127.0.0.1: this machine only)', default='127.0.0.1'),
            option('--token', 'token that a browser must give (default for other machines: a '
                   'random one)', default=''),
            *arguments.NETWORK,
            option('--rig', 'rig file of the drawing, and of the unit of loads (default: that of '
                   'SADDLERING_RIG, or the shipped rig)', type=arguments.file_read),
            option('--window', 'longest time shown, in seconds (default 600)',
                   type=Within(float, 1.0, 86400.0, ' seconds'), default=600.0, metavar='S'),
            arguments.json_option('write the address as JSON; - for stdout')), (
            ('saddlering live', 'then, in another terminal: saddlering replay bags/dynamic_50'),
            ('saddlering live --host 0.0.0.0',
             'for other machines; the printed address contains a token'))),
    Command(
        'record', 'record the rig and the live results into a bag',
        'Record load, probes, displacement, simulation, residual, parameters in force and '
        'diagnostics as a rosbag2 bag (MCAP with its message definitions inside, so that '
        'PlotJuggler, Foxglove and ros2 bag read it without this package), until Ctrl-C or for '
        '--duration.', (
            option('out', 'bag to write', type=arguments.bag_written, metavar='OUT'),
            option('--test', 'kind of test, kept in the bag (with --elevation, the bag can be '
                   'identified and diagnosed)', choices=('static', 'dynamic')),
            option('--elevation', 'elevation of the barrel in degrees, kept in the bag',
                   type=Within(float, -10.0, 90.0), metavar='DEG'),
            option('--rig', 'rig file, whose hash the bag then states (default: that of '
                   'SADDLERING_RIG, or the rig of the nodes that run meanwhile)',
                   type=arguments.file_read),
            option('--duration', 'end after this time [s]',
                   type=Within(float, 1e-3, 1e6, ' seconds'), metavar='S'),
            *arguments.NETWORK, arguments.OVERWRITE, arguments.json_option()), (
            ('saddlering record test_17 --test static --elevation 50',
             'a test on the rig that can be identified and diagnosed'),)))


def run(args: argparse.Namespace) -> int:
    """Listen in the ROS domain and the namespace of the options."""
    from saddlering_ros.rig import load_rig
    from saddlering_ros.ros.launcher import prepare_middleware
    from saddlering_ros.ros.names import namespace_of

    if args.command == 'record' and (args.test is None) != (args.elevation is None):
        raise BagError('--test and --elevation belong together: give both, or neither')
    domain, namespace = arguments.domain_of(args), namespace_of(args.namespace)
    rig = load_rig(args.rig)
    prepare_middleware()
    act = {'check-driver': _check_driver, 'live': _live, 'record': _record}[args.command]
    return act(args, rig, domain, namespace)


def _check_driver(args: argparse.Namespace, rig: 'Rig', domain: int, namespace: str) -> int:
    """Listen, check, print; status 2 if a fault is found."""
    import numpy as np

    from saddlering_ros.doubts import FAULT
    from saddlering_ros.doubts.driver import check_driver
    from saddlering_ros.quantities import finite_json
    from saddlering_ros.ros.driver_listener import listen

    heard = listen(domain, namespace, args.seconds)
    findings = check_driver(rig, heard, math.radians(args.elevation), args.rate)
    count = sum(one.severity == FAULT for one in findings)
    topics = {}
    for name, one in heard.items():
        values = one.values[np.isfinite(one.values)]
        topics[name] = finite_json({
            'samples': len(one), 'publishers': one.publishers, 'rate': one.rate,
            'delay': one.delay, 'mean': float(values.mean()) if len(values) else math.nan})
    document = {
        'faults': count, 'topics': topics,
        'findings': [{'level': one.severity, 'topic': one.where, 'words': one.words}
                     for one in findings]}
    if not tell_json(args, document):
        for name, told in topics.items():
            if told['rate'] is not None and told['mean'] is not None:
                print(f'{name}: {told["samples"]} samples at {told["rate"]:.5g} Hz, mean '
                      f'{told["mean"]:.6g}, {1e3 * told["delay"]:.3g} ms from stamp to arrival')
        for finding in findings:
            print(f'{finding.severity}: {finding}')
        if not findings:
            print('this driver has no fault')
    if count:
        sys.stdout.flush()
        print(f'saddlering check-driver: {count} fault{"s" * (count > 1)}: correct the driver '
              'before a test', file=sys.stderr)
    return 2 if count else 0


def _live(args: argparse.Namespace, rig: 'Rig', domain: int, namespace: str) -> int:
    """Serve until Ctrl-C."""
    from saddlering_ros.live.server import Address, serve
    from saddlering_ros.live.watcher import Watcher

    def say(where: Address) -> None:
        if not tell_json(args, {'url': where.url, 'domain': domain}):
            print(f'{where.url} shows ROS domain {domain}; Ctrl-C ends it', flush=True)

    with Watcher(domain, args.window, namespace, rig) as watcher:
        serve(watcher, Address(args.host, args.port, args.token), say)
    return 0


def _record(args: argparse.Namespace, rig: 'Rig', domain: int, namespace: str) -> int:
    """Record until a signal ends it, which is how a recording ends: status 0."""
    from saddlering_ros.live.recorder import recording
    from saddlering_ros.record.record import TestMetadata

    facts = {} if args.rig is None else {'rig_hash': rig.digest}
    if args.test is not None:
        facts = TestMetadata(args.test, args.elevation, details=facts).as_text()
    # No Event: its handler would wait for ever for a lock that the same thread holds.
    told_to_end: list[int] = []
    for name in ('SIGINT', 'SIGTERM', 'SIGHUP'):  # heard, too, while the bag is being closed
        number = getattr(signal, name)
        signal.signal(number, lambda number, _: told_to_end.append(number))
        # At its end the interpreter restores the default, by which a repeated signal kills.
        atexit.register(signal.signal, number, signal.SIG_IGN)
    began = time.monotonic()
    with recording(args.out, domain, facts=facts, overwrite=args.overwrite,
                   namespace=namespace) as node:
        if args.json != '-':
            print(f'recording ROS domain {domain} into {args.out}; Ctrl-C ends it', flush=True)
        end = began + (args.duration or math.inf)
        while not (node.done or told_to_end or time.monotonic() >= end):
            time.sleep(0.05)
        contradiction = node.settle_rig()
    if contradiction:
        print(f'note: {contradiction}', file=sys.stderr)
    seconds, counts = time.monotonic() - began, node.counts()
    if not tell_json(args, {'bag': str(args.out), 'seconds': seconds, 'messages': counts}):
        print(f'{args.out}: {sum(counts.values())} messages in {seconds:.1f} s')
    if not any(counts.values()):
        print(f'note: no message was received in ROS domain {domain}', file=sys.stderr)
    return 0
