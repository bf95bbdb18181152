"""`saddlering identify`: contact parameters from bags, with how far they can be trusted."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from saddlering_ros.identification import IdentificationSettings, Progress


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
    parser.add_argument('--seed', type=int, default=0, help='seed of the swarm (default 0)')
    parser.add_argument('--bounds', nargs='+', default=[], metavar='NAME=LOW:HIGH',
                        help='bounds of a parameter in SI units, e.g. K1=2e7:1e9')
    parser.add_argument('--particles', type=int, default=20)
    parser.add_argument('--iterations', type=int, default=50)
    parser.add_argument('--log-stiffness', action='store_true',
                        help="search K on a logarithmic scale in the paper's method too")
    parser.add_argument('--use-delta-y', action='store_true',
                        help="use delta_y in the paper's method too")
    parser.add_argument('--profiles', action='store_true', help='profile likelihoods as well')
    add_fact_options(parser)


def run(args: argparse.Namespace) -> int:
    """Identify and print, write or emit the result."""
    import json

    from saddlering_ros.bags import read_run
    from saddlering_ros.cli._samples import radians
    from saddlering_ros.identification import identify
    from saddlering_ros.identification.summary import identification_text
    from saddlering_ros.rig import load_rig, write_parameters, write_text_atomically

    settings = _settings(args)
    rig = load_rig(args.rig)
    settings.bounds_for(rig)
    elevation = radians(args.elevation)
    runs = [read_run(bag, test=args.test, elevation=elevation) for bag in args.bags]
    with _Bar() as bar:
        found = identify(runs, rig, settings, on_progress=bar.show, profiles=args.profiles)
    if args.out is not None:
        write_parameters(args.out, found.parameters)
    document = json.dumps(found.to_json(), indent=2)
    if args.json == '-':
        print(document)
        return 0
    if args.json is not None:
        write_text_atomically(Path(args.json), document + '\n')
    print(identification_text(found))
    if args.out is not None:
        print(f'written: {args.out}')
    return 0


def _settings(args: argparse.Namespace) -> IdentificationSettings:
    from saddlering_ros.identification import IdentificationSettings, SwarmSettings

    return IdentificationSettings(
        method=args.method,
        bounds=parse_bounds(args.bounds),
        swarm=SwarmSettings(particles=args.particles, iterations=args.iterations),
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


class _Bar:
    """A progress bar on stderr, if that is a terminal; otherwise nothing at all."""

    def __enter__(self) -> _Bar:
        import sys

        self._progress: Any = None
        self._tasks: dict[str, Any] = {}
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress as RichProgress

            self._progress = RichProgress(console=Console(stderr=True), transient=True)
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def show(self, progress: Progress) -> None:
        """Show one step of the identification."""
        if self._progress is None:
            return
        if progress.stage not in self._tasks:
            self._tasks[progress.stage] = self._progress.add_task(
                progress.stage, total=progress.iterations
            )
        self._progress.update(
            self._tasks[progress.stage], completed=progress.iteration,
            description=f'{progress.stage}  best {progress.best_objective:.4g}',
        )
