"""`saddlering identify`: contact parameters from bags, with how far they can be trusted."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from saddlering_ros.cli._json import tell_json

if TYPE_CHECKING:
    from saddlering_ros.identification import IdentificationSettings


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    from saddlering_ros.cli._samples import add_fact_options

    parser = subparsers.add_parser('identify', help='find the contact parameters from bags')
    parser.add_argument('bags', nargs='+', metavar='BAG', help='runs to fit, static and dynamic')
    parser.add_argument('--rig', type=Path, help='rig file (default: the shipped rig)')
    parser.add_argument('--method', default='default', choices=('default', 'paper'),
                        help="'paper': two swarm steps as published; 'default': joint fit of all")
    parser.add_argument('--out', type=Path, help='write the parameter file here')
    parser.add_argument('--json', metavar='FILE', help='write all figures as JSON; - for stdout')
    parser.add_argument('--report', type=Path, metavar='FILE.html', help='write a report')
    parser.add_argument('--seed', type=int, default=0, help='seed of the swarm (default 0)')
    parser.add_argument('--bounds', nargs='+', default=[], metavar='NAME=LOW:HIGH',
                        help='bounds of a parameter in SI units, e.g. K1=2e7:1e9')
    parser.add_argument('--particles', type=int, default=20)
    parser.add_argument('--iterations', type=int, default=50)
    parser.add_argument('--accuracy', type=float, metavar='J',
                        help='the swarm stops once its best objective is at or under this')
    parser.add_argument('--stagnation', type=int, metavar='N',
                        help='the swarm stops once N iterations have gained nothing')
    parser.add_argument('--log-stiffness', action='store_true',
                        help="search K on a logarithmic scale in the paper's method too")
    parser.add_argument('--use-delta-y', action='store_true',
                        help="use delta_y in the paper's method too")
    parser.add_argument('--profiles', action='store_true', help='profile likelihoods as well')
    add_fact_options(parser)


def run(args: argparse.Namespace) -> int:
    """Identify and print, write or emit the result."""
    from saddlering_ros.bags import read_run
    from saddlering_ros.cli._progress import Bar
    from saddlering_ros.cli._samples import radians
    from saddlering_ros.identification import identify
    from saddlering_ros.identification.summary import identification_text
    from saddlering_ros.provenance import name_files
    from saddlering_ros.rig import load_rig, write_parameters

    settings = _settings(args)
    rig = load_rig(args.rig)
    settings.bounds_for(rig)
    elevation = radians(args.elevation)
    runs = [read_run(bag, test=args.test, elevation=elevation, rig=rig) for bag in args.bags]
    with Bar() as bar:
        found = identify(runs, rig, settings, on_progress=lambda step: bar.show(
            step.stage, step.iteration / max(step.iterations, 1),
            f'best {step.best_objective:.4g}'), profiles=args.profiles)
    if args.out is not None:
        write_parameters(args.out, found.parameters)
    if args.report is not None:
        from saddlering_ros.identification import validate
        from saddlering_ros.report import write_validation_report

        write_validation_report(args.report, validate(runs, rig, found.parameters), runs, rig,
                                found.to_json(), args.command_line)
    if tell_json(args, name_files(found.to_json(), args.rig)):
        return 0
    print(identification_text(found))
    for path in (args.out, args.report):
        if path is not None:
            print(f'written: {path}')
    return 0


def _settings(args: argparse.Namespace) -> IdentificationSettings:
    from saddlering_ros.identification import IdentificationSettings, SwarmSettings

    return IdentificationSettings(
        method=args.method,
        bounds=parse_bounds(args.bounds),
        swarm=SwarmSettings(
            particles=args.particles, iterations=args.iterations,
            accuracy=args.accuracy, stagnation=args.stagnation),
        logarithmic_stiffness=args.log_stiffness,
        use_delta_y=True if args.use_delta_y else None,
        seed=args.seed,
    )


def parse_bounds(texts: list[str]) -> dict[str, tuple[float, float]]:
    """Bounds from NAME=LOW:HIGH texts; IdentificationError says which one cannot be read."""
    from saddlering_ros.identification import IdentificationError

    bounds = {}
    for text in texts:
        name, _, ends = text.partition('=')
        low, _, high = ends.partition(':')
        try:
            bounds[name.strip()] = (float(low), float(high))
        except ValueError as problem:
            raise IdentificationError(
                f'--bounds {text!r} cannot be read: write NAME=LOW:HIGH, e.g. K1=2e7:1e9'
            ) from problem
    return bounds
