"""`saddlering watch`: whether the ring behaved as its model during a recorded test."""

from __future__ import annotations

import argparse
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from saddlering_ros.bags.samples import DisplacementSamples
    from saddlering_ros.monitoring import MonitorSettings, Report
    from saddlering_ros.rig import ParameterSet, Rig

MATERIALITY_PERCENT = 2.0
"""Share of the motion at full scale that a residual may have without an alarm [%]."""

SHORT_REST = 2.0
"""Noise read from less rest than this [s] is not known well enough for the promise."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    from saddlering_ros.cli._samples import add_bag_options, add_parameter_option

    parser = subparsers.add_parser(
        'watch', help='raise the alarm that a live test would have raised: the ring no longer '
                      'behaves as its model')
    add_bag_options(parser)
    add_parameter_option(parser)
    parser.add_argument('--materiality', type=float, default=MATERIALITY_PERCENT,
                        metavar='PERCENT', help='residual without an alarm, in percent of the '
                        f'motion at full scale (default {MATERIALITY_PERCENT:g})')
    parser.add_argument('--false-alarm-hours', type=float, default=1000.0, metavar='H',
                        help='at most one false alarm in so many hours of testing (default 1000)')
    parser.add_argument('--json', metavar='FILE', help='write the result as JSON; - for stdout')


def run(args: argparse.Namespace) -> int:
    """Read, measure, simulate, watch; the alarm in one line."""
    from dataclasses import asdict

    import numpy as np

    from saddlering_ros.cli._json import tell_json
    from saddlering_ros.cli._samples import read_shown, residual_samples
    from saddlering_ros.monitoring import MonitorSettings, watch
    from saddlering_ros.rig import load_rig, read_parameters

    rig, parameters = load_rig(args.rig), read_parameters(args.params)
    test_run = read_shown(args, rig)
    samples, _, notes = residual_samples(test_run, rig, parameters)
    settings = MonitorSettings(
        _materiality(rig, parameters, test_run.elevation, args.materiality),
        false_alarm_hours=args.false_alarm_hours)
    residual = np.stack([np.asarray(getattr(samples.displacement, name))
                         for name in ('delta_x', 'delta_y', 'gamma')])
    noise, rest = _noise(rig, samples, residual, settings)
    report = watch(np.asarray(samples.time), residual, np.asarray(samples.load), noise, settings)
    if rest < SHORT_REST:
        notes.append(f'the noise is read from {rest:.1f} s of rest: record {SHORT_REST:g} s '
                     'before the load moves, else the rate of false alarms is not sure')
    notes += report.lapses
    document = {'bag': str(test_run.path), 'seconds': report.seconds, 'notes': notes,
                'false_alarm_hours': args.false_alarm_hours,
                'materiality': list(settings.materiality),
                'alarm': None if report.alarm is None else asdict(report.alarm)}
    if tell_json(args, document):
        return 0
    print(_words(report))
    for note in notes:
        print(f'note: {note}')
    return 0


def _materiality(
    rig: Rig, parameters: ParameterSet, elevation: float, percent: float
) -> tuple[float, float, float]:
    """What `percent` of the motion from preload to full scale is in each channel."""
    import numpy as np

    from saddlering_ros.ring.simulator import static_response

    ends = static_response(rig, parameters.contact.to_array(), elevation,
                           np.array([rig.preload, rig.full_scale_load]))
    x, y, gamma = (float(value) for value in 0.01 * percent * np.abs(ends[:, 1] - ends[:, 0]))
    return x, y, gamma


def _noise(
    rig: Rig, samples: DisplacementSamples, residual: Any, settings: MonitorSettings
) -> tuple[list[Any], float]:
    """Noise of the blocks of every channel, and the rest [s] that it is read from."""
    import numpy as np

    from saddlering_ros.estimation.noise import fit_channel
    from saddlering_ros.estimation.rest import quiet_stretches, stretches_at_rest
    from saddlering_ros.monitoring import block_noise, MonitoringError

    time = np.asarray(samples.time)
    step = float(np.median(np.diff(time)))
    rests = quiet_stretches(stretches_at_rest(time, np.asarray(samples.load),
                                              rig.limits.rest_band))
    if not rests:
        raise MonitoringError('the load never rests, so the noise is not known: record some '
                              'seconds before the load moves')
    count = max(1, round(settings.block / step))
    found = [block_noise(fit_channel([channel[a:b] for a, b in rests], step), count)
             for channel in residual]
    return found, sum(float(time[b - 1] - time[a]) for a, b in rests)


def _words(report: Report) -> str:
    alarm = report.alarm
    if alarm is None:
        return f'no alarm in {report.seconds:.1f} s'
    unit = 'urad' if alarm.channel == 'gamma' else 'um'
    return (f'ALARM at {alarm.time:.2f} s: {alarm.channel} has differed from its model since '
            f'{alarm.since:.2f} s by {1e6 * alarm.size:+.3g} {unit} in the mean'
            + (f'; the difference follows {alarm.follows}' if alarm.follows else ''))
