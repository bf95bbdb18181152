"""`saddlering replay`: a bag played to the live nodes, in real processes, without ros2cli."""

import argparse
from collections.abc import Callable
import contextlib
from functools import partial
import os
from pathlib import Path
import re
import sys
import time
from typing import Any

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, option, tell_json, Within
from saddlering_ros.errors import counted

PLAYS, AT_END = 'replay is playing', 'replay is at its end'
"""Log lines of replay_clock at its start and after its last sample."""

START_PATIENCE = 60.0
"""How long the nodes may take until the replay starts [s]."""

SAMPLES_PER_STEP, MIN_STEP, MAX_STEP = 50, 0.2, 1.8
"""Loads in a step of a replay as fast as possible, so that a test at 25 Hz takes few steps, and
the limits of the step [s]: those of replay_clock."""

LAST_MESSAGES = 5.0
"""How long the last messages may take to the recorder [s]."""

COMMANDS = (Command(
    'replay', 'replay a bag through the live nodes',
    'Start the replay, displacement, simulator and residual nodes for a bag, and end them with '
    'the bag. Other programs of the same ROS domain receive all topics.', (
        option('bag', 'the bag to replay', type=arguments.bag_read, metavar='BAG'),
        option('--params', 'contact parameters to simulate with', type=arguments.file_read),
        arguments.RIG, arguments.TRUST,
        option('--elevation', 'elevation of the test (default: that of the bag)',
               type=Within(float, -10.0, 90.0), metavar='DEG'),
        option('--rate', 'speed; 1 is real time, 0 as fast as the nodes follow (default 1)',
               type=Within(float, 0.0, 100.0), default=1.0),
        *arguments.NETWORK,
        option('--record', 'record all topics and results into this bag (lossless: the replay '
               'waits for the recorder)', type=arguments.bag_written, metavar='OUT'),
        option('--overwrite', 'replace an existing bag with --record', action='store_true'),
        option('--alarm', 'start ring_alarm too, which watches the residual',
               action='store_true'),
        arguments.json_option(),
        option('--log', 'folder for the logs of the nodes', type=arguments.folder_filled,
               metavar='FOLDER')), (
        ('saddlering replay bags/dynamic_50 --params params.yaml',
         'to live nodes, in real time'),
        ('saddlering replay bags/dynamic_50 --params params.yaml --rate 0 --record replayed',
         'as fast as possible, with all results in a new bag'))),)


def run(args: argparse.Namespace) -> int:
    """Replay until the bag is at its end, or until Ctrl-C."""
    told = play(args, lambda place: print(
        f'note: the recording until then is in {place}', file=sys.stderr))
    if not tell_json(args, told):
        print('the bag is at its end')
        if args.record is not None:
            print(f'written: {args.record}, '
                  + counted(sum(told['messages'].values()), 'message'))
    return 0


def play(args: argparse.Namespace,
         on_cut: Callable[[Path], None] = lambda place: None) -> dict[str, Any]:
    """Replay a bag to nodes of its own; what was replayed and recorded, as plain data.

    on_cut: called with the place of a recording that an error cuts off.
    """
    from saddlering_ros.bags.reader import read_raw, usable_facts
    from saddlering_ros.doubts.comparison import refuse_other_hash
    from saddlering_ros.doubts.readings import absent_topic
    from saddlering_ros.record.topics import LOAD_TOPIC
    from saddlering_ros.rig import load_rig
    from saddlering_ros.ros import launcher
    from saddlering_ros.ros.names import namespace_of, NodeError

    rig, bag = load_rig(args.rig), Path(args.bag)
    record = read_raw(bag, rig=rig)
    if not args.trust_rig:
        refuse_other_hash(record, rig)
    if args.elevation is None:  # else the simulator asks for no metadata of the bag
        usable_facts(record.path, record.facts, None, None)
    for note in (*record.notes, *(note for name in record for note in record[name].notes)):
        print(f'note: {note}', file=sys.stderr)
    domain = arguments.domain_of(args)
    length = (record.stop - record.start) / 1e9
    parameters = _parameters(args, length, len(record[LOAD_TOPIC]))
    nodes = (*launcher.RING_NODES, *launcher.ALARM_NODES) if args.alarm else launcher.RING_NODES
    with contextlib.ExitStack() as stack:
        recorder = None
        if args.record is not None:
            from saddlering_ros.live.recorder import NAME, recording

            os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
            launcher.prepare_middleware()
            facts = record.facts.overruled(None, args.elevation)
            is_stated = facts.test is not None and facts.elevation_deg is not None
            recorder = stack.enter_context(recording(
                args.record, domain, facts=facts.as_text() if is_stated else {},
                overwrite=args.overwrite, namespace=namespace_of(args.namespace)))
            parameters['replay_clock']['participants'] = [*launcher.REPLAY_NODES, *nodes, NAME]
        group = stack.enter_context(launcher.start_nodes(
            bag, nodes=nodes, rate=args.rate, domain_id=domain, log_folder=args.log,
            parameters=parameters, files=[] if args.rig is None else [args.rig],
            namespace=namespace_of(args.namespace)))
        if args.json != '-':
            print(f'replaying {args.bag} ({length:.1f} s) in ROS domain {domain}; Ctrl-C ends it',
                  flush=True)
        began = time.monotonic()
        try:
            alarm = _wait(group, began + 120.0 + 10.0 * length / min(args.rate or 1.0, 1.0),
                          length / args.rate if args.rate else None,
                          (lambda _: None) if args.json == '-' else partial(
                              print, 'ring_alarm:', flush=True),
                          lambda: None if recorder is None else recorder.fault)
            sent = {name: len(record[name]) for name in record if name != absent_topic(rig)}
            last = time.monotonic() + LAST_MESSAGES
            while recorder is not None and (missing := recorder.missing(sent)):
                if time.monotonic() > last:
                    raise NodeError(f'the recording is incomplete ({missing}): repeat the replay')
                time.sleep(0.02)
        except BaseException:
            if recorder is not None and recorder.fault is not None:
                raise recorder.fault from None
            if recorder is not None:
                on_cut(recorder.keep_as_incomplete())
            raise
        took = time.monotonic() - began
        counts = {} if recorder is None else recorder.counts()
    return {'bag': str(args.bag), 'domain': domain, 'duration': length, 'seconds': took,
            'recorded': None if args.record is None else str(args.record), 'messages': counts,
            'alarm': alarm}


def _parameters(args: argparse.Namespace, length: float, loads: int) -> dict[str, dict[str, Any]]:
    """Parameters of the nodes for a bag of this length [s] with so many loads."""
    from saddlering_ros.ros import launcher

    trusted = {'trust_rig': args.trust_rig}
    simulator: dict[str, Any] = dict(trusted)
    if args.params is not None:
        arguments.read_model(args)
        simulator['parameters_file'] = str(args.params)
    if args.elevation is not None:
        simulator['elevation_deg'] = args.elevation
    clock: dict[str, Any] = dict(trusted)
    if not args.rate:
        step = SAMPLES_PER_STEP * length / max(loads, 1)
        clock['window'] = min(max(MIN_STEP, step), MAX_STEP)
    return {**dict.fromkeys(launcher.REPLAY_NODES, trusted),
            'ring_simulator': simulator, 'replay_clock': clock}


def _wait(group: Any, deadline: float, seconds: float | None,
          on_alarm: Callable[[str], None],
          fault: Callable[[], Exception | None] = lambda: None) -> str | None:
    """Wait for the end of the bag; the last state of its alarm, in words, None without one.

    on_alarm: called with each new state; fault: what has ended a recording, which is raised.
    NodeError if the clock leaves before the end, or does not start.
    """
    from saddlering_ros.ros.launcher import last_line
    from saddlering_ros.ros.names import NodeError, STATE_TOLD

    began, told = time.monotonic(), ''
    alarm, state = group.processes.get('ring_alarm'), None

    def newest() -> str | None:
        """The state of the alarm."""
        states = [line.partition(STATE_TOLD)[2] for line in alarm.said().splitlines()
                  if STATE_TOLD in line] if alarm else []
        if states and states[-1] != state and not states[-1].startswith('waiting'):
            on_alarm(states[-1])
        return states[-1] if states else None

    clock = group.processes['replay_clock']
    with Bar() as bar:
        while clock.running and time.monotonic() < deadline:
            group.check()
            if (problem := fault()) is not None:
                raise problem
            gone = [name for name, node in group.processes.items() if not node.running]
            if gone and clock.running:
                raise NodeError(f'{gone[0]} ended before the bag was at its end: repeat the '
                                'replay')
            said, state = clock.said(), newest()
            waits = re.findall('(?:still waits for|starts without) .*', said)
            if waits and waits[-1] != told:
                told = waits[-1]
                print(f'note: the replay {told}', file=sys.stderr)
            if PLAYS not in said and time.monotonic() - began > START_PATIENCE:
                raise NodeError('the replay does not start: ' + (
                    f'{last_line(said)}: check that this node runs' if waits else 'its nodes are '
                    f'not up within {START_PATIENCE:g} s: if the machine is busy, repeat it'))
            if seconds is not None:
                bar.show('replay', min((time.monotonic() - began) / seconds, 0.99))
            time.sleep(0.02)
    group.wait('replay_clock', 0.1)
    group.check()
    ends = [line for line in clock.said().splitlines() if AT_END in line]
    if not ends:
        raise NodeError(f'replay_clock ended before the bag was at its end: '
                        f'{last_line(clock.said())}: replay it again')
    if 'without' in ends[-1]:
        raise NodeError(f'{ends[-1][ends[-1].index(AT_END):]}, which fell behind: repeat the '
                        'replay')
    return newest()
