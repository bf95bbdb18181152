"""`saddlering generate`: a bag of the virtual rig, with any effect hidden in it."""

import argparse
from dataclasses import replace
import math
from typing import TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Command, option, tell_json, Within
from saddlering_ros.errors import plain_number, VirtualRigError

if TYPE_CHECKING:
    from saddlering_ros.rig import ContactParameters
    from saddlering_ros.virtual_rig.experiment import TestPlan

COMMANDS = (Command(
    'generate', 'record a test of the virtual rig as a bag',
    'Carry out a test on the virtual rig and record it as a bag.', (
        option('out', 'bag to write', metavar='OUT', type=arguments.bag_written, nargs='?'),
        option('--test', 'kind of test', choices=('static', 'dynamic')),
        option('--elevation', 'elevation of the barrel', type=Within(float, -10.0, 90.0),
               metavar='DEG'),
        option('--effect', 'an effect to hide in the bag (SI units; may be repeated); NAME alone '
               'gives a typical size on the rig; see --list-effects', action='append', default=[],
               metavar='NAME[.PARAM]=VALUE'),
        option('--form', 'physical form of an effect that has several', action='append',
               default=[], metavar='NAME=FORM'),
        option('--list-effects', 'list all effects, their parameters and forms',
               action='store_true'),
        option('--seed', 'seed of noise, jitter and offsets (default 0)', type=Within(int, 0),
               default=0),
        option('--rig-seed', 'number of the rig; the same number gives the same rollers (default '
               '1)', type=Within(int, 0), default=1),
        arguments.RIG,
        option('--params', 'parameter file with the true contact law', type=arguments.file_read),
        option('--set', 'one contact parameter, K1 n1 D1 K2 n2 D2, in SI units', action='append',
               default=[], metavar='NAME=VALUE'),
        option('--noise', 'rms noise of the probes in micrometres (default 0.3)',
               type=Within(float, 0.0, 1e4), default=0.3, metavar='UM'),
        option('--gap-scatter', "rms difference of the rollers' gaps in micrometres (default 0.7)",
               type=Within(float, 0.0, 1e4), default=0.7, metavar='UM'),
        option('--stiffness-scatter', "rms difference of the rollers' stiffness (default 2)",
               type=Within(float, 0.0, 1e4), default=2.0, metavar='PERCENT'),
        option('--rate', 'sample rate (default 50 static, 1000 dynamic)', type=float,
               metavar='HZ'),
        option('--duration', 'length of a dynamic test at normal speed (default 10)', type=float,
               metavar='S'),
        option('--speed', 'factor of the speed of a dynamic ramp (default 1)', type=float,
               metavar='FACTOR'),
        option('--hold', 'time per static step (default 5), or at the peak (default 0)',
               type=float, metavar='S'),
        option('--load-step', 'step of a static test, in the unit of the rig file, rig.force_unit '
               '(default: a 25th of full scale)', type=float, metavar='LOAD'),
        option('--peak', 'highest load, in the unit of the rig file (default: full scale)',
               type=float, metavar='LOAD'),
        option('--lowest', 'load at both ends, in the unit of the rig file (default: its preload)',
               type=float, metavar='LOAD'),
        option('--cycles', 'number of load cycles (default 1)', type=int, default=1),
        arguments.OVERWRITE, arguments.json_option()), (
        ('saddlering generate made/friction --test static --elevation 50 '
         '--effect radial_friction=5000', 'a static test with a hidden friction of 5 kN'),
        ('saddlering generate --list-effects', 'the effects that can be hidden'))),)


def run(args: argparse.Namespace) -> int:
    """Generate one bag and print its content."""
    from saddlering_ros.rig import load_rig
    from saddlering_ros.virtual_rig.effects import parse_requests
    from saddlering_ros.virtual_rig.experiment import record_test, write_record

    if args.list_effects:
        from saddlering_ros.virtual_rig.effects import EFFECTS

        lines, rig = [], load_rig(args.rig)
        for name, effect in sorted(EFFECTS.items()):
            lines.append(f'{name}: {(effect.act.__doc__ or "").strip()}')
            lines += [f'    {size.name} [{size.unit}] {"+-" if size.signed else ""}{size.low:g} '
                      f'to {size.high:g}, typical {size.typical:g}'
                      for size in effect.parameters_on(rig)]
            if len(effect.forms) > 1:
                lines.append(f'    forms: {", ".join(effect.forms)}')
        print('\n'.join(lines))
        return 0
    parse_requests(args.effect, args.form)  # a misspelt effect is reported before missing options
    if args.out is None or args.test is None or args.elevation is None:
        raise VirtualRigError('the test is not stated: give OUT --test static|dynamic '
                              '--elevation DEG, or --list-effects')
    plan = _plan(args)
    if args.out.exists() and not args.overwrite:
        raise VirtualRigError(f'{args.out}: exists already: give --overwrite, or another name')
    record = record_test(plan)
    write_record(args.out, record, plan.physical.rig, overwrite=args.overwrite)
    told = {'bag': str(args.out), 'test': args.test, 'elevation_deg': args.elevation,
            'duration': float(plan.schedule.duration), 'load_samples': len(record.load),
            'effects': args.effect, 'seed': args.seed, 'rig_seed': args.rig_seed}
    if not tell_json(args, told):
        print(f'{args.out}: {args.test}, {args.elevation:g} deg, {plan.schedule.duration:.1f} s, '
              f'{len(record.load)} load samples')
    return 0


def _plan(args: argparse.Namespace) -> 'TestPlan':
    from saddlering_ros.rig import FORCE_UNITS, FULL_SCALE_LOAD, load_rig
    from saddlering_ros.virtual_rig import experiment
    from saddlering_ros.virtual_rig.effects import parse_requests
    from saddlering_ros.virtual_rig.integrator import Scatter

    rig, static = load_rig(args.rig), args.test == 'static'
    load_noise = experiment.Instruments.load_noise * rig.full_scale_load / FULL_SCALE_LOAD
    physical = experiment.PhysicalRig(
        rig, _contact(args), math.radians(args.elevation),
        parse_requests(args.effect, args.form, rig),
        Scatter(args.gap_scatter * 1e-6, args.stiffness_scatter / 100.0), args.rig_seed)
    for name in ('duration', 'speed') if static else ('load_step',):
        if getattr(args, name) is not None:
            raise VirtualRigError(f'--{name.replace("_", "-")} is for '
                                  f'{"dynamic" if static else "static"} tests: leave it out')
    newtons = FORCE_UNITS[rig.force_unit]
    units = {'peak': newtons, 'lowest': newtons, 'load_step': newtons, 'hold': 1.0,
             'duration': 1.0, 'speed': 1.0}
    given = {name.removeprefix('load_'): getattr(args, name) * unit
             for name, unit in units.items() if getattr(args, name) is not None}
    schedule_of = experiment.static_schedule if static else experiment.dynamic_schedule
    return experiment.TestPlan(
        physical, schedule_of(rig, cycles=args.cycles, **given), args.seed,
        experiment.Instruments(noise=args.noise * 1e-6, load_noise=load_noise), args.rate,
        rig_name=str(args.rig) if args.rig else 'virtual rig')


def _contact(args: argparse.Namespace) -> 'ContactParameters':
    """The contact law of the rig: of a file, with the values of --set."""
    from saddlering_ros.rig import PARAMETER_NAMES, read_parameters, TRUE_TO_SCALE

    values = {}
    for text in args.set:
        name, _, number = text.partition('=')
        if name not in PARAMETER_NAMES:
            raise VirtualRigError(f'--set {text!r}: there is no parameter {name!r}: give one of '
                                  f'{", ".join(PARAMETER_NAMES)}')
        try:
            values[name] = plain_number(number)
        except ValueError as problem:
            raise VirtualRigError(f'--set {text!r} cannot be read: write NAME=NUMBER') from problem
    return replace(TRUE_TO_SCALE if args.params is None else read_parameters(args.params).contact,
                   **values)
