"""`saddlering identify`, `diagnose`, `compare`, `validate` and `report`: analyses of bags."""

import argparse
from pathlib import Path

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, finish, finish_with_parameters, option
from saddlering_ros.errors import plain_number

IDENTIFY = Command(
    'identify', 'identify the contact parameters from bags',
    'Fit the six contact parameters to static and dynamic tests, and print them with their '
    'uncertainty. The parameter file is read by simulator, nodes and diagnosis.', (
        arguments.bags_option('runs to fit, static and dynamic'), *arguments.READING,
        option('--method', "'paper': two swarm steps as published; 'default': joint fit of all",
               default='default', choices=('default', 'paper')),
        option('--out', 'write the parameter file here', type=arguments.file_written),
        arguments.json_option('write all figures as JSON; - for stdout'), arguments.REPORT,
        option('--seed', 'seed of the swarm (default 0)', type=int, default=0),
        option('--bounds', 'bounds of a parameter in SI units, e.g. K1=2e7:1e9', nargs='+',
               default=[], metavar='NAME=LOW:HIGH'),
        option('--particles', 'size of the swarm (default 20)', type=int, default=20),
        option('--iterations', 'most steps of the swarm (default 50)', type=int, default=50),
        option('--accuracy', 'the swarm stops when its best objective is at most this', type=float,
               metavar='J'),
        option('--stagnation', 'the swarm stops after N iterations without progress', type=int,
               metavar='N'),
        option('--log-stiffness', "search K on a logarithmic scale in the paper's method too",
               action='store_true'),
        option('--use-delta-y', "use delta_y in the paper's method too", action='store_true')), (
        ('saddlering identify bags/static_50 bags/dynamic_50 --out params.yaml',
         'contact parameters with their uncertainty'),
        ('saddlering identify bags/static_50 bags/dynamic_50 --method paper --seed 3',
         'by the published two-step swarm')))

DIAGNOSE = Command(
    'diagnose', 'name the cause that the simulation lacks',
    'Fit the model to the bags, and search the catalogue of effects for the cause of what is '
    'left. The verdict names a cause, states that several explain the misfit, or that none is '
    'known.', (
        arguments.bags_option('runs to diagnose'), *arguments.READING,
        option('--hold-out', 'held-out runs, on which the misfit reduction is measured',
               type=arguments.bag_read, nargs='+', default=[], metavar='BAG'),
        option('--params', 'parameter file to start from', type=arguments.file_read),
        arguments.json_option('write the verdict as JSON; - for stdout'), arguments.REPORT,
        option('--out', 'write the extended parameter file here', type=arguments.file_written),
        option('--seed', 'seed of the base fit (default 0)', type=int, default=0),
        option('--propose', 'folder for the effect file of a proposed law (default with --json '
               'FILE: FILE without its suffix, followed by _effects)',
               type=arguments.folder_filled, metavar='DIR'),
        arguments.EFFECTS), (
        ('saddlering diagnose bags/static_50 bags/dynamic_50 --hold-out bags/static_70 '
         '--out extended.yaml --report report.html',
         'name the missing cause, with a held-out run; write a report and parameters'),))

COMPARE = Command(
    'compare', 'name what changed in one ring between two sessions',
    'Name what changed in one ring between two sessions. What both sessions have cancels, so that '
    'smaller causes show than in one session.', (
        option('--before', 'bags of the earlier session, such as the base measurement',
               type=arguments.bag_read, nargs='+', required=True, metavar='BAG'),
        option('--after', 'bags of the later session; given several times, in order of time: a '
               'series of sessions', type=arguments.bag_read, nargs='+', required=True,
               metavar='BAG', action='append'),
        *arguments.READING,
        arguments.json_option('write the verdict on the change as JSON; - for stdout'),
        arguments.REPORT,
        option('--seed', 'seed of the base fit (default 0)', type=int, default=0)), (
        ('saddlering compare --before 2025/static_50 2025/dynamic_50 --after 2026/static_50 '
         '2026/dynamic_50 --report change.html',
         'name what changed since the base measurement; write a report'),),
    'the shipped bags are one session of one ring')

INPUTS = (arguments.bags_option('runs to predict'), *arguments.READING, *arguments.MODEL,
          arguments.json_option('write all figures as JSON; - for stdout'))

VALIDATE = Command(
    'validate', 'check how well parameters predict bags',
    'Simulate tests with given parameters, and compare the prediction with the measurement '
    'by figures of merit for each channel.', (
        *INPUTS,
        option('--plots', 'write figures of simulated and measured over load and time, one '
               'per run', type=arguments.folder_filled, metavar='DIR'),
        arguments.REPORT), (
        ('saddlering validate bags/static_70 bags/dynamic_70 --params params.yaml '
         '--plots pictures',
         'figures of merit for each channel, and a figure of each run'),))

REPORT = Command(
    'report', 'write a report on parameters and their predictions',
    'Write one HTML file that opens offline: the parameters with their uncertainty, and '
    'simulation beside measurement for the given bags. saddlering diagnose --report writes '
    'the report of a diagnosis.', (
        *INPUTS,
        option('--out', 'the report to write', dest='report', type=arguments.page_written,
               required=True, metavar='FILE.html')), (
        ('saddlering report bags/static_70 --params params.yaml --out parameters.html',
         'a report on the prediction of another test'),))

COMMANDS = (IDENTIFY, DIAGNOSE, COMPARE, VALIDATE, REPORT)


def run(args: argparse.Namespace) -> int:
    """Analyse and print, write or emit the result."""
    analyse = {'identify': _identify, 'diagnose': _diagnose, 'compare': _compare}
    return analyse.get(args.command, _validate)(args)


def _identify(args: argparse.Namespace) -> int:
    from saddlering_ros import identify, load_rig
    from saddlering_ros.identification import IdentificationError, IdentificationSettings

    bounds, rig = {}, load_rig(args.rig)
    for text in args.bounds:
        name, _, ends = text.partition('=')
        low, _, high = ends.partition(':')
        try:
            bounds[name.strip()] = (plain_number(low), plain_number(high))
        except ValueError as problem:
            raise IdentificationError(
                f'--bounds {text!r} cannot be read: write NAME=LOW:HIGH, e.g. K1=2e7:1e9'
            ) from problem
    IdentificationSettings(bounds=bounds).bounds_for(rig)  # a fault is reported before any reading
    bags = arguments.bags_of(args, args.bags, rig)
    with Bar() as bar:
        result = identify(
            bags, rig=args.rig, method=args.method, bounds=bounds, particles=args.particles,
            iterations=args.iterations, accuracy=args.accuracy, stagnation=args.stagnation,
            log_stiffness=args.log_stiffness, use_delta_y=True if args.use_delta_y else None,
            seed=args.seed, trust_rig=args.trust_rig,
            on_progress=bar.tell)
    return finish_with_parameters(args, result)


def _diagnose(args: argparse.Namespace) -> int:
    from saddlering_ros import diagnose, load_rig

    arguments.take_effects(args)
    rig = load_rig(args.rig)
    fitted, held_out = (arguments.bags_of(args, bags, rig) for bags in (args.bags, args.hold_out))
    with Bar() as bar:
        result = diagnose(fitted, hold_out=held_out, rig=args.rig, parameters=args.params,
                         seed=args.seed, trust_rig=args.trust_rig,
                         on_progress=bar.tell)
    folder = args.propose
    if folder is None and args.json not in (None, '-'):
        file = Path(args.json)
        folder = file.with_name(f'{file.stem}_effects')
    if folder is not None:
        result = result.with_effect_files(folder)
    return finish_with_parameters(args, result)


def _compare(args: argparse.Namespace) -> int:
    from saddlering_ros import compare, load_rig

    rig = load_rig(args.rig)
    before, *between, after = (
        arguments.bags_of(args, bags, rig) for bags in (args.before, *args.after))
    with Bar() as bar:
        result = compare(before, after, between=between, rig=args.rig, seed=args.seed,
                         trust_rig=args.trust_rig, on_progress=bar.tell)
    return finish(args, result)


def _validate(args: argparse.Namespace) -> int:
    from saddlering_ros import load_rig, read_parameters, validate

    arguments.take_effects(args)
    read_parameters(args.params)  # a fault there is reported before any bag is read
    bags = arguments.bags_of(args, args.bags, load_rig(args.rig))
    with Bar() as bar:
        result = validate(bags, parameters=args.params, rig=args.rig,
                         trust_rig=args.trust_rig, on_progress=bar.tell)
    plots = getattr(args, 'plots', None)
    return finish(args, result, tuple if plots is None else lambda: result.save_plots(plots))
