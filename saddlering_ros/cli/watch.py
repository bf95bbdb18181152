"""`saddlering watch`: whether the ring behaved as its model during a recorded test."""

import argparse
from typing import Any

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, option, tell_json, Within
from saddlering_ros.monitoring import DEFAULT_PERCENT

COMMANDS = (Command(
    'watch', 'find the moment when a recorded ring leaves its model',
    'Replay the residual of each bag through the detector of the node ring_alarm, and print '
    'whether, when and in which channel it raises an alarm.', (
        arguments.bags_option('rosbag2 directories or .mcap files; each bag is watched '
                              'separately'),
        *arguments.READING, *arguments.MODEL,
        option('--materiality', 'residual that is allowed without an alarm, in percent of the '
               f'range from preload to full scale (default {DEFAULT_PERCENT:g})',
               type=Within(float, 0.0, 100.0, ' percent'), default=DEFAULT_PERCENT,
               metavar='PERCENT'),
        option('--false-alarm-hours', 'mean time between false alarms, in hours of testing '
               '(default 1000)', type=Within(float, 1e-3, 1e9, ' hours'), default=1000.0,
               metavar='H'),
        arguments.json_option('write the result as JSON; - for stdout')), (
        ('saddlering watch bags/dynamic_70 --params params.yaml',
         'whether, when and in which channel a test raises the alarm'),)),)


def run(args: argparse.Namespace) -> int:
    """Read, measure, simulate, watch each bag; the alarm in one line."""
    import numpy as np

    from saddlering_ros.monitoring.detector import MonitoringError
    from saddlering_ros.monitoring.monitor import alarm_words, MonitorSettings, MOVED_ALONE
    from saddlering_ros.monitoring.stream import AlarmStream
    from saddlering_ros.record.residual import residual_stretches

    arguments.take_effects(args)
    rig, parameters = arguments.read_model(args)
    runs: list[dict[str, Any]] = []
    lines: list[str] = []
    for bag in args.bags:
        stream = AlarmStream(
            rig, MonitorSettings(false_alarm_hours=args.false_alarm_hours), args.materiality)
        stream.use(parameters.contact)
        monitor = stream.monitor
        test_run = arguments.read_shown(args, bag, rig)
        notes = list(test_run.notes)
        with Bar() as bar:
            stretches, _ = residual_stretches(rig, test_run, parameters, notes,
                                              lambda share: bar.show('watch', share))
            for batch in stretches:
                stream.watch(batch, test_run.load[np.searchsorted(test_run.stamps, batch.stamps)])
        if monitor.rest is None and monitor.unwatched == MOVED_ALONE:
            raise MonitoringError(f'{test_run.path}: nothing is watched: {MOVED_ALONE}')
        if monitor.rest is None:
            raise MonitoringError(f'{test_run.path}: the load never rests and then moves, so the '
                                  'noise is not known and nothing is watched: record some seconds '
                                  'before the load moves')
        origin, alarm = int(test_run.stamps[0]), monitor.alarm
        notes += [f'{1e-9 * (lapse.stamp - origin):.3f} s: {lapse.reason}'
                  for lapse in monitor.lapses]
        runs.append({
            'bag': str(test_run.path), 'seconds': monitor.seconds, 'notes': notes,
            'materiality': monitor.materiality.tolist(),
            'alarm': None if alarm is None else {
                'channel': alarm.channel, 'time': 1e-9 * (alarm.stamp - origin),
                'since': 1e-9 * (alarm.since - origin), 'size': alarm.size,
                'evidence': alarm.evidence, 'follows': alarm.follows,
                'first_guess': alarm.first_guess, 'stamp_ns': alarm.stamp,
                'since_ns': alarm.since}})
        words = f'no alarm in {monitor.seconds:.1f} s'
        lines += [f'{test_run.path}: {words if alarm is None else alarm_words(alarm, origin)}',
                  *(f'  note: {note}' for note in notes)]
    if not tell_json(args, {'false_alarm_hours': args.false_alarm_hours, 'runs': runs}):
        print('\n'.join(lines))
    return 0
