"""`saddlering identify`, `diagnose`, `compare`, `validate` and `report`: results of the API."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any, TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, option, tell_json
from saddlering_ros.errors import plain_number

if TYPE_CHECKING:
    from collections.abc import Callable

    from saddlering_ros import Rig

VALIDATED = (arguments.bags_option('runs to predict'), *arguments.READING, *arguments.MODEL,
             arguments.json_option('write all figures as JSON; - for stdout'))

COMMANDS = (
    Command(
        'identify', 'identify the contact parameters from bags',
        'Fit the six contact parameters to static and dynamic tests, and print them with their '
        'uncertainty. The parameter file is read by simulator, nodes and diagnosis.', (
            arguments.bags_option('runs to fit, static and dynamic'), *arguments.READING,
            option('--method', "'paper': two swarm steps as published; 'default': joint fit of "
                   'all', default='default', choices=('default', 'paper')),
            option('--out', 'write the parameter file here', type=arguments.file_written),
            arguments.json_option('write all figures as JSON; - for stdout'), arguments.REPORT,
            option('--seed', 'seed of the swarm (default 0)', type=int, default=0),
            option('--bounds', 'bounds of a parameter in SI units, e.g. K1=2e7:1e9', nargs='+',
                   default=[], metavar='NAME=LOW:HIGH'),
            option('--particles', 'size of the swarm (default 20)', type=int, default=20),
            option('--iterations', 'most steps of the swarm (default 50)', type=int, default=50),
            option('--accuracy', 'the swarm stops when its best objective is at most this',
                   type=float, metavar='J'),
            option('--stagnation', 'the swarm stops after N iterations without progress', type=int,
                   metavar='N'),
            option('--log-stiffness', "search K on a logarithmic scale in the paper's method too",
                   action='store_true'),
            option('--use-delta-y', "use delta_y in the paper's method too",
                   action='store_true')), (
            ('saddlering identify bags/static_50 bags/dynamic_50 --out params.yaml',
             'contact parameters with their uncertainty'),
            ('saddlering identify bags/static_50 bags/dynamic_50 --method paper --seed 3',
             'by the published two-step swarm'))),
    Command(
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
            option('--propose', 'folder for the effect file of a proposed law (default with '
                   '--json FILE: FILE without its suffix, followed by _effects)',
                   type=arguments.folder_filled, metavar='DIR'),
            arguments.EFFECTS), (
            ('saddlering diagnose bags/static_50 bags/dynamic_50 --hold-out bags/static_70 '
             '--out extended.yaml --report report.html',
             'name the missing cause, with a held-out run; write a report and parameters'),)),
    Command(
        'compare', 'name what changed in one ring between two sessions',
        'Name what changed in one ring between two sessions. What both sessions have cancels, so '
        'that smaller causes show than in one session.', (
            option('--before', 'bags of the earlier session, such as the base measurement',
                   type=arguments.bag_read, nargs='+', required=True, metavar='BAG'),
            option('--after', 'bags of the later session; given several times, in order of time: '
                   'a series of sessions', type=arguments.bag_read, nargs='+', required=True,
                   metavar='BAG', action='append'),
            *arguments.READING,
            arguments.json_option('write the verdict on the change as JSON; - for stdout'),
            arguments.REPORT,
            option('--seed', 'seed of the base fit (default 0)', type=int, default=0)), (
            ('saddlering compare --before 2025/static_50 2025/dynamic_50 --after 2026/static_50 '
             '2026/dynamic_50 --report change.html',
             'name what changed since the base measurement; write a report'),)),
    Command(
        'validate', 'check how well parameters predict bags',
        'Simulate tests with given parameters, and compare the prediction with the measurement '
        'by figures of merit for each channel.', (
            *VALIDATED,
            option('--plots', 'write figures of simulated and measured over load and time, one '
                   'per run', type=arguments.folder_filled, metavar='DIR'),
            arguments.REPORT), (
            ('saddlering validate bags/static_70 bags/dynamic_70 --params params.yaml '
             '--plots pictures',
             'figures of merit for each channel, and a figure of each run'),)),
    Command(
        'report', 'write a report on parameters and their predictions',
        'Write one HTML file that opens offline: the parameters with their uncertainty, and '
        'simulation beside measurement for the given bags. saddlering diagnose --report writes '
        'the report of a diagnosis.', (
            *VALIDATED,
            option('--out', 'the report to write', dest='report', type=arguments.page_written,
                   required=True, metavar='FILE.html')), (
            ('saddlering report bags/static_70 --params params.yaml --out parameters.html',
             'a report on the prediction of another test'),)))


def run(args: argparse.Namespace) -> int:
    """Read the bags once, with the metadata of the options; compute, and finish the result."""
    from saddlering_ros import load_rig, read_bag

    arguments.take_effects(args)
    rig = load_rig(args.rig)
    given, function = _prepared(args, rig)
    with Bar() as bar:
        bags = [[read_bag(path, rig=rig, test=args.test, elevation_deg=args.elevation,
                          on_progress=bar.tell) for path in paths] for paths in given]
    with Bar() as bar:
        result = function(*bags, rig=args.rig, trust_rig=args.trust_rig, on_progress=bar.tell)
    return finish(args, result)


def finish(args: argparse.Namespace, result: Any) -> int:
    """Print a result as JSON or as summary, then write and list its files; the status.

    It is told first, so that it is not lost if a file cannot be written.
    """
    is_json_alone, reader_gone = args.json == '-', None
    try:
        if is_json_alone:
            tell_json(args, result.to_json())
        else:
            print(result.summary(), flush=True)
    except BrokenPipeError as problem:  # as with `| head`: the files are wanted all the same
        reader_gone = problem
    if args.json is not None and not is_json_alone:
        tell_json(args, result.to_json())
    plots, out = (getattr(args, name, None) for name in ('plots', 'out'))
    written = [] if plots is None else result.save_plots(plots)
    if out is not None:
        result.save_parameters(out)
        written.append(out)
    if args.report is not None:
        written += result.write_report(args.report, command=args.command_line)
    if reader_gone is not None:
        raise reader_gone
    for path in [] if is_json_alone else written:
        print(f'written: {path}')
    return 0


def _prepared(args: argparse.Namespace, rig: Rig) -> tuple[list[list[str]], Callable[..., Any]]:
    """The groups of bags of a command, and the function that computes its result from them.

    A fault of the other arguments is reported before any bag is read.
    """
    from saddlering_ros import compare, diagnose, identify, read_parameters, validate
    from saddlering_ros.identification.settings import IdentificationError, IdentificationSettings

    def diagnosed(fitted: Any, held_out: Any, **options: Any) -> Any:
        result = diagnose(fitted, hold_out=held_out, parameters=args.params, seed=args.seed,
                          **options)
        folder = args.propose
        if folder is None and args.json not in (None, '-'):
            file = Path(args.json)
            folder = file.with_name(f'{file.stem}_effects')
        return result if folder is None else result.with_effect_files(folder)

    def compared(before: Any, *later: Any, **options: Any) -> Any:
        return compare(before, later[-1], between=later[:-1], seed=args.seed, **options)

    if args.command == 'diagnose':
        return [args.bags, args.hold_out], diagnosed
    if args.command == 'compare':
        return [args.before, *args.after], compared
    if args.command != 'identify':
        read_parameters(args.params)
        return [args.bags], partial(validate, parameters=args.params)
    bounds = {}
    for text in args.bounds:
        name, _, ends = text.partition('=')
        low, _, high = ends.partition(':')
        try:
            bounds[name.strip()] = (plain_number(low), plain_number(high))
        except ValueError as problem:
            raise IdentificationError(
                f'--bounds {text!r} cannot be read: write NAME=LOW:HIGH, e.g. K1=2e7:1e9'
            ) from problem
    IdentificationSettings(bounds=bounds).bounds_for(rig)
    return [args.bags], partial(
        identify, method=args.method, bounds=bounds, particles=args.particles,
        iterations=args.iterations, accuracy=args.accuracy, stagnation=args.stagnation,
        log_stiffness=args.log_stiffness, use_delta_y=True if args.use_delta_y else None,
        seed=args.seed)
