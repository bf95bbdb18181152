"""`saddlering check-driver`: faults of a driver of the rig, before the first test."""

import argparse
import math
import sys

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Command, option, tell_json, Within
from saddlering_ros.errors import counted

COMMANDS = (Command(
    'check-driver', 'check rates, stamps, range and signs of a rig driver',
    'Listen to the topics of a rig for some seconds, and print one line for each fault and for '
    'each property that could not be checked. Status 2 if a fault is found.', (
        option('--seconds', 'how long to listen (default 5)', type=Within(float, 0.5, 3600.0),
               default=5.0, metavar='S'),
        arguments.RIG,
        option('--elevation', 'elevation of the barrel, from which the direction of each probe '
               'follows (default 50)', type=Within(float, -10.0, 90.0), default=50.0,
               metavar='DEG'),
        option('--rate', 'required rate of every topic', type=Within(float, 1e-3, 1e6),
               metavar='HZ'),
        *arguments.NETWORK,
        arguments.json_option('write the findings as JSON; - for stdout')), (
        ('saddlering check-driver', 'faults of the driver; move the load meanwhile'),
        ('saddlering check-driver --rig rig.yaml --elevation 30 --rate 1000 --seconds 20',
         'for your own rig, with the required rate of every channel'))),)


def run(args: argparse.Namespace) -> int:
    """Listen, check, print; status 2 if a fault is found."""
    import numpy as np

    from saddlering_ros.doubts import FAULT
    from saddlering_ros.doubts.driver import check_driver
    from saddlering_ros.quantities import finite_json
    from saddlering_ros.rig import load_rig
    from saddlering_ros.ros.launcher import prepare_middleware
    from saddlering_ros.ros.names import namespace_of
    from saddlering_ros.ros.raw_topics import listen

    rig, namespace = load_rig(args.rig), namespace_of(args.namespace)
    prepare_middleware()
    heard = listen(arguments.domain_of(args), namespace, args.seconds)
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
                print(f'{name}: {counted(told["samples"], "sample")} at {told["rate"]:.5g} Hz, '
                      f'mean {told["mean"]:.6g}, {1e3 * told["delay"]:.3g} ms from stamp to '
                      'arrival')
        for finding in findings:
            print(f'{finding.severity}: {finding}')
        if not findings:
            print('this driver has no fault')
    if count:
        sys.stdout.flush()
        print(f'saddlering check-driver: {counted(count, "fault")}: correct the driver before a '
              'test', file=sys.stderr)
    return 2 if count else 0
