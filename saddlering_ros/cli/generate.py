"""`saddlering generate`: a bag of the virtual rig, with any effect hidden in it."""

from __future__ import annotations

import argparse
from typing import Any, TYPE_CHECKING

from saddlering_ros.cli._arguments import add_json_option, add_rig_option, file_read, file_written
from saddlering_ros.cli._terminal import tell_json
from saddlering_ros.errors import plain_number, VirtualRigError

if TYPE_CHECKING:
    from saddlering_ros.rig import ContactParameters, Rig
    from saddlering_ros.virtual_rig.recording import TestPlan
    from saddlering_ros.virtual_rig.schedule import Schedule


EXAMPLES = (
    ('saddlering generate made/friction --test static --elevation 50 '
     '--effect radial_friction=5000', 'a static test with a hidden friction of 5 kN'),
    ('saddlering generate --list-effects', 'the effects that can be hidden'),
)


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'generate', help='record a test of the virtual rig as a bag',
        description='Carry out a test on the virtual rig and record it as a bag.')
    parser.add_argument('out', metavar='OUT', type=file_written, nargs='?', help='bag to write')
    parser.add_argument('--test', choices=('static', 'dynamic'), help='kind of test')
    parser.add_argument('--elevation', type=float, metavar='DEG', help='elevation of the barrel')
    effect = parser.add_argument(
        '--effect', action='append', default=[], metavar='NAME[.PARAM]=VALUE',
        help='an effect to hide in the bag (SI units; may be repeated); NAME alone gives a '
             'typical size on the rig; see --list-effects')
    setattr(effect, 'completer', _effects)  # noqa: B010  # read by argcomplete
    parser.add_argument('--form', action='append', default=[], metavar='NAME=FORM',
                        help='physical form of an effect that has several')
    parser.add_argument('--list-effects', action='store_true',
                        help='list all effects, their parameters and forms')
    parser.add_argument('--seed', type=int, default=0,
                        help='seed of noise, jitter and offsets (default 0)')
    parser.add_argument('--rig-seed', type=int, default=1,
                        help='number of the rig; the same number gives the same rollers (default '
                             '1)')
    add_rig_option(parser)
    parser.add_argument('--params', type=file_read,
                        help='parameter file with the true contact law')
    parser.add_argument('--set', action='append', default=[], metavar='NAME=VALUE',
                        help='one contact parameter, K1 n1 D1 K2 n2 D2, in SI units')
    parser.add_argument('--noise', type=float, default=0.3, metavar='UM',
                        help='rms noise of the probes in micrometres (default 0.3)')
    parser.add_argument('--load-noise', type=float, metavar='N',
                        help='rms white noise of the load cell (default: 0.02 %% of full scale)')
    parser.add_argument('--gap-scatter', type=float, default=0.7, metavar='UM',
                        help="rms difference of the rollers' gaps in micrometres (default 0.7)")
    parser.add_argument('--stiffness-scatter', type=float, default=2.0, metavar='PERCENT',
                        help="rms difference of the rollers' stiffness (default 2)")
    parser.add_argument('--rate', type=float, metavar='HZ',
                        help='sample rate (default 50 static, 1000 dynamic)')
    parser.add_argument('--probe-rate', type=float, metavar='HZ',
                        help='sample rate of the probes (default: that of the load)')
    parser.add_argument('--duration', type=float, metavar='S',
                        help='length of a dynamic test at normal speed (default 10)')
    parser.add_argument('--speed', type=float, metavar='FACTOR',
                        help='factor of the speed of a dynamic ramp (default 1)')
    parser.add_argument('--hold', type=float, metavar='S',
                        help='time per static step (default 5), or at the peak (default 0)')
    parser.add_argument('--load-step', type=float, metavar='LOAD',
                        help='step of a static test, in the unit of the rig file, rig.force_unit '
                             '(default: a 25th of full scale)')
    parser.add_argument('--peak', type=float, metavar='LOAD',
                        help='highest load, in the unit of the rig file (default: full scale)')
    parser.add_argument('--lowest', type=float, metavar='LOAD',
                        help='load at both ends, in the unit of the rig file (default: its '
                             'preload)')
    parser.add_argument('--cycles', type=int, default=1, help='number of load cycles (default 1)')
    parser.add_argument('--run-name', default='', help='free text for the bag')
    parser.add_argument('--overwrite', action='store_true', help='replace an existing bag')
    add_json_option(parser)


def _effects(**_: object) -> list[str]:
    """Completions that the shell offers after --effect."""
    from saddlering_ros.virtual_rig.effects import EFFECTS

    return [f'{name}=' for name in sorted(EFFECTS)]


def run(args: argparse.Namespace) -> int:
    """Generate one bag and print its content."""
    from saddlering_ros.rig import load_rig
    from saddlering_ros.virtual_rig.effects import parse_requests
    from saddlering_ros.virtual_rig.recording import record_test, write_record

    if args.list_effects:
        print(effects_text(load_rig(args.rig)))
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
    if tell_json(args, told):
        return 0
    print(f'{args.out}: {args.test}, {args.elevation:g} deg, {plan.schedule.duration:.1f} s, '
          f'{len(record.load)} load samples')
    return 0


def _plan(args: argparse.Namespace) -> TestPlan:
    import math

    from saddlering_ros.rig import FULL_SCALE_LOAD, load_rig
    from saddlering_ros.virtual_rig.effects import parse_requests
    from saddlering_ros.virtual_rig.integrator import Scatter
    from saddlering_ros.virtual_rig.physics import PhysicalRig
    from saddlering_ros.virtual_rig.recording import Instruments, TestPlan

    if not -10.0 <= args.elevation <= 90.0:
        raise VirtualRigError(f'elevation is {args.elevation:g}: give degrees from -10 to 90')
    rig = load_rig(args.rig)
    load_noise = args.load_noise
    if load_noise is None:
        load_noise = Instruments.load_noise * rig.full_scale_load / FULL_SCALE_LOAD
    noises = {'noise': args.noise, 'load-noise': load_noise, 'gap-scatter': args.gap_scatter,
              'stiffness-scatter': args.stiffness_scatter}
    for name, value in noises.items():
        if not 0.0 <= value < 1e4:
            raise VirtualRigError(f'--{name} is {value:g}: give a number from 0 up')
    if args.seed < 0 or args.rig_seed < 0:
        raise VirtualRigError('a seed is below zero: give a whole number from 0 up')
    physical = PhysicalRig(
        rig, _contact(args), math.radians(args.elevation),
        parse_requests(args.effect, args.form, rig),
        Scatter(args.gap_scatter * 1e-6, args.stiffness_scatter / 100.0), args.rig_seed)
    instruments = Instruments(noise=args.noise * 1e-6, load_noise=load_noise)
    return TestPlan(
        physical, _schedule(args, rig), args.seed, instruments, args.rate, args.probe_rate,
        rig_name=str(args.rig) if args.rig else 'virtual rig', run_name=args.run_name)


def _schedule(args: argparse.Namespace, rig: Rig) -> Schedule:
    from saddlering_ros.rig import FORCE_UNITS
    from saddlering_ros.virtual_rig.schedule import dynamic_schedule, static_schedule

    static = args.test == 'static'
    for name in ('duration', 'speed') if static else ('load_step',):
        if getattr(args, name) is not None:
            raise VirtualRigError(f'--{name.replace("_", "-")} is for '
                                  f'{"dynamic" if static else "static"} tests: leave it out')
    given: dict[str, Any] = {'cycles': args.cycles}
    for name, key in (('peak', 'peak'), ('lowest', 'lowest'), ('load_step', 'step')):
        if getattr(args, name) is not None:
            given[key] = getattr(args, name) * FORCE_UNITS[rig.force_unit]
    for name in ('hold', 'duration', 'speed'):
        if getattr(args, name) is not None:
            given[name] = getattr(args, name)
    return static_schedule(rig, **given) if static else dynamic_schedule(rig, **given)


def _contact(args: argparse.Namespace) -> ContactParameters:
    from dataclasses import asdict

    from saddlering_ros.rig import (
        ContactParameters,
        PARAMETER_NAMES,
        read_parameters,
        TRUE_TO_SCALE,
    )

    contact = TRUE_TO_SCALE if args.params is None else read_parameters(args.params).contact
    values = asdict(contact)
    for text in args.set:
        name, _, number = text.partition('=')
        if name not in PARAMETER_NAMES:
            raise VirtualRigError(f'--set {text!r}: there is no parameter {name!r}: give one of '
                                  f'{", ".join(PARAMETER_NAMES)}')
        try:
            values[name] = plain_number(number)
        except ValueError as problem:
            raise VirtualRigError(f'--set {text!r} cannot be read: write NAME=NUMBER') from problem
    return ContactParameters(**values)


def effects_text(rig: Rig) -> str:
    """All effects with their parameters (main one first), plausible sizes on a rig, and forms."""
    from saddlering_ros.virtual_rig.effects import EFFECTS

    lines = []
    for name, effect in sorted(EFFECTS.items()):
        words = (effect.act.__doc__ or '').strip()
        lines.append(f'{name}: {words}')
        for parameter in effect.parameters_on(rig):
            sign = '+-' if parameter.signed else ''
            lines.append(f'    {parameter.name} [{parameter.unit}] {sign}{parameter.low:g} to '
                         f'{parameter.high:g}, typical {parameter.typical:g}')
        if len(effect.forms) > 1:
            lines.append(f'    forms: {", ".join(effect.forms)}')
    return '\n'.join(lines)
