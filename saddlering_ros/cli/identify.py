"""`saddlering identify`: contact parameters from bags, with their uncertainty."""

import argparse

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, finish, option
from saddlering_ros.errors import Interrupted, plain_number

COMMANDS = (Command(
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
         'by the published two-step swarm'))),)


def run(args: argparse.Namespace) -> int:
    """Identify and print, write or emit the result."""
    from saddlering_ros import identify, load_rig
    from saddlering_ros.identification.settings import IdentificationError, IdentificationSettings

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
    try:
        with Bar() as bar:
            result = identify(
                bags, rig=args.rig, method=args.method, bounds=bounds, particles=args.particles,
                iterations=args.iterations, accuracy=args.accuracy, stagnation=args.stagnation,
                log_stiffness=args.log_stiffness, use_delta_y=True if args.use_delta_y else None,
                seed=args.seed, trust_rig=args.trust_rig, on_progress=bar.tell)
    except Interrupted as stopped:
        finish(args, stopped.partial)
        raise
    return finish(args, result)
