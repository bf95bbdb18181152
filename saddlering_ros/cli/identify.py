"""`saddlering identify`: contact parameters from bags, with their uncertainty."""

from __future__ import annotations

import argparse
from typing import Any

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._terminal import Bar, finish
from saddlering_ros.errors import plain_number

EXAMPLES = (
    ('saddlering identify bags/static_50 bags/dynamic_50 --out params.yaml',
     'contact parameters with their uncertainty'),
    ('saddlering identify bags/static_50 bags/dynamic_50 --method paper --seed 3',
     'by the published two-step swarm'),
)


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'identify', help='identify the contact parameters from bags',
        description='Fit the six contact parameters to static and dynamic tests, and print '
                    'them with their uncertainty. The parameter file is read by simulator, '
                    'nodes and diagnosis.')
    arguments.add_bags_options(parser, 'runs to fit, static and dynamic')
    parser.add_argument('--method', default='default', choices=('default', 'paper'),
                        help="'paper': two swarm steps as published; 'default': joint fit of all")
    parser.add_argument('--out', type=arguments.file_written, help='write the parameter file here')
    arguments.add_json_option(parser, 'write all figures as JSON; - for stdout')
    arguments.add_report_option(parser)
    parser.add_argument('--seed', type=int, default=0, help='seed of the swarm (default 0)')
    parser.add_argument('--bounds', nargs='+', default=[], metavar='NAME=LOW:HIGH',
                        help='bounds of a parameter in SI units, e.g. K1=2e7:1e9')
    parser.add_argument('--particles', type=int, default=20, help='size of the swarm (default 20)')
    parser.add_argument('--iterations', type=int, default=50,
                        help='most steps of the swarm (default 50)')
    parser.add_argument('--accuracy', type=float, metavar='J',
                        help='the swarm stops when its best objective is at most this')
    parser.add_argument('--stagnation', type=int, metavar='N',
                        help='the swarm stops after N iterations without progress')
    parser.add_argument('--log-stiffness', action='store_true',
                        help="search K on a logarithmic scale in the paper's method too")
    parser.add_argument('--use-delta-y', action='store_true',
                        help="use delta_y in the paper's method too")
    parser.add_argument('--profiles', action='store_true', help='also compute profile likelihoods')


def run(args: argparse.Namespace) -> int:
    """Identify and print, write or emit the result."""
    from saddlering_ros import identify, load_rig
    from saddlering_ros.identification import IdentificationSettings

    bounds, rig = parse_bounds(args.bounds), load_rig(args.rig)
    IdentificationSettings(bounds=bounds).bounds_for(rig)  # a fault is reported before any reading
    bags = arguments.bags_of(args, args.bags, rig)
    with Bar() as bar:
        found = identify(
            bags, rig=args.rig, method=args.method, bounds=bounds, particles=args.particles,
            iterations=args.iterations, accuracy=args.accuracy, stagnation=args.stagnation,
            log_stiffness=args.log_stiffness, use_delta_y=True if args.use_delta_y else None,
            profiles=args.profiles, seed=args.seed, trust_rig=args.trust_rig,
            on_progress=bar.tell)
    if args.out is not None:
        found.save_parameters(args.out)
    return finish(args, found, args.out)


def parse_bounds(texts: list[str]) -> dict[str, tuple[float, float]]:
    """Bounds from NAME=LOW:HIGH texts; IdentificationError names a text that cannot be read."""
    from saddlering_ros.identification import IdentificationError

    bounds = {}
    for text in texts:
        name, _, ends = text.partition('=')
        low, _, high = ends.partition(':')
        try:
            bounds[name.strip()] = (plain_number(low), plain_number(high))
        except ValueError as problem:
            raise IdentificationError(
                f'--bounds {text!r} cannot be read: write NAME=LOW:HIGH, e.g. K1=2e7:1e9'
            ) from problem
    return bounds
