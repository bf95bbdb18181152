"""`saddlering record`: the topics of the rig and of the nodes, recorded as a bag."""

import argparse
import atexit
from collections.abc import Mapping, Sequence
import math
import signal
import sys
import time

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Command, option, tell_json, Within
from saddlering_ros.errors import BagError, counted

COMMANDS = (Command(
    'record', 'record the rig and the live results into a bag',
    'Record load, probes, displacement, simulation, residual, parameters in force and diagnostics '
    'as a rosbag2 bag (MCAP with its message definitions inside, so that PlotJuggler, Foxglove '
    'and ros2 bag read it without this package), until Ctrl-C or for --duration.', (
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
         'a test on the rig that can be identified and diagnosed'),)),)


SILENT = 5.0
"""Time [s] without a message of a topic of the rig, while others come, after which it is noted: a
test can still be repeated then."""


class Silence:
    """Topics from which nothing comes while others go on, each told once."""

    def __init__(self, awaited: Sequence[str], now: float) -> None:
        self._last = dict.fromkeys(awaited, (0, now))  # number of messages, and since when [s]
        self._told: set[str] = set()

    def told(self, counts: Mapping[str, int], now: float) -> list[str]:
        """The topics to tell of, by the messages of each so far, at `now` [s]."""
        self._last = {topic: last if counts[topic] == last[0] else (counts[topic], now)
                      for topic, last in self._last.items()}
        newest = max(since for count, since in self._last.values())
        silent = [topic for topic, (_, since) in self._last.items()
                  if newest - since >= SILENT and topic not in self._told]
        self._told.update(silent)
        return silent


def run(args: argparse.Namespace) -> int:
    """Record until a signal ends it, which is how a recording ends: status 0."""
    from saddlering_ros.doubts.readings import absent_topic
    from saddlering_ros.live.recorder import recording
    from saddlering_ros.record.record import TestMetadata
    from saddlering_ros.record.topics import RIG_TOPICS
    from saddlering_ros.rig import load_rig
    from saddlering_ros.ros.launcher import prepare_middleware
    from saddlering_ros.ros.names import namespace_of

    if (args.test is None) != (args.elevation is None):
        raise BagError('--test and --elevation belong together: give both, or neither')
    rig = None if args.rig is None else load_rig(args.rig)
    facts = {} if rig is None else {'rig_hash': rig.digest}
    if args.test is not None:
        facts = TestMetadata(args.test, args.elevation, details=facts).as_text()
    domain = arguments.domain_of(args)
    prepare_middleware()
    # No Event: its handler would wait for ever for a lock that the same thread holds.
    told_to_end: list[int] = []
    for name in ('SIGINT', 'SIGTERM', 'SIGHUP'):  # heard, too, while the bag is being closed
        number = getattr(signal, name)
        signal.signal(number, lambda number, _: told_to_end.append(number))
        # At its end the interpreter restores the default, by which a repeated signal kills.
        atexit.register(signal.signal, number, signal.SIG_IGN)
    began, awaited = time.monotonic(), [one for one in RIG_TOPICS if one != absent_topic(rig)]
    has_begun, silence = False, Silence(awaited, began)
    with recording(args.out, domain, facts=facts, overwrite=args.overwrite,
                   namespace=namespace_of(args.namespace)) as node:
        if args.json != '-':
            print(f'recording ROS domain {domain} into {args.out}; Ctrl-C ends it', flush=True)
        end = began + (args.duration or math.inf)
        while not (node.done or told_to_end or time.monotonic() >= end):
            time.sleep(0.05)
            if not has_begun and all(map(node.counts().get, awaited)):
                has_begun = True
                if args.json != '-':
                    print(f'load and probes arrive, {time.monotonic() - began:.1f} s after the '
                          'start', flush=True)
            for topic in silence.told(node.counts(), time.monotonic()):
                print(f'note: {topic}: nothing has come for {SILENT:g} s, while other topics do: '
                      'see to its driver', file=sys.stderr, flush=True)
        contradiction = node.settle_rig()
    if contradiction:
        print(f'note: {contradiction}', file=sys.stderr)
    seconds, counts = time.monotonic() - began, node.counts()
    if not tell_json(args, {'bag': str(args.out), 'seconds': seconds, 'messages': counts}):
        print(f'{args.out}: {counted(sum(counts.values()), "message")} of rig and ring in '
              f'{seconds:.1f} s')
    if not any(counts.values()):
        print(f'note: no message was received in ROS domain {domain}, namespace '
              f'{namespace_of(args.namespace) or "/"}', file=sys.stderr)
    elif silent := [topic for topic in awaited if not counts[topic]]:
        print(f'note: nothing was received on {", ".join(silent)}, and the bag is no test without '
              'it: start its driver, or remap its topic, and record again', file=sys.stderr)
    return 0
