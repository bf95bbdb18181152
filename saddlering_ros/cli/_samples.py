"""Common parts of `displacement`, `simulate` and `residual`: reading, samples, output."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from saddlering_ros.cli._arguments import radians, take_effects
from saddlering_ros.cli._terminal import Bar, stdout_console, tell_json
from saddlering_ros.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from saddlering_ros import Bag, Rig
    from saddlering_ros.bags.samples import Columns, SamplesSummary
    from saddlering_ros.record import Record
    from saddlering_ros.record.samples import Displacements
    from saddlering_ros.rig import ParameterSet, ZeroReading

    StretchesOf = Callable[[Rig, Record, ParameterSet, list[str], Callable[[float], None]],
                           tuple[Iterator[Displacements], ZeroReading]]

PER_MILLION = 1e6


def bags_of(args: argparse.Namespace, paths: Sequence[str], rig: Rig) -> list[Bag]:
    """The bags at these paths, read once, with the metadata of the options."""
    from saddlering_ros import read_bag

    with Bar() as bar:
        return [read_bag(path, rig=rig, test=args.test, elevation_deg=args.elevation,
                         on_progress=bar.tell)
                for path in paths]


def read_shown(args: argparse.Namespace, bag: str, rig: Rig) -> Record:
    """The test of one bag of a command, with a bar of how much was read.

    BagError if the bag states another rig, unless --trust-rig.
    """
    from saddlering_ros.bags import read_run
    from saddlering_ros.doubts import refuse_other_rig

    with Bar() as bar:
        run = read_run(bag, test=args.test, elevation=radians(args.elevation), rig=rig,
                       on_progress=bar.reading(bag))
    if not args.trust_rig:
        refuse_other_rig([run], rig)
    return run


def read_model(args: argparse.Namespace) -> tuple[Rig, ParameterSet]:
    """The rig and the parameters of a command; RigError if these belong to another rig."""
    from saddlering_ros.doubts import refuse_parameters_of_other_rig
    from saddlering_ros.rig import load_rig, read_parameters

    rig, parameters = load_rig(args.rig), read_parameters(args.params)
    if not args.trust_rig:
        refuse_parameters_of_other_rig(parameters, rig)
    return rig, parameters


def check_outputs(args: argparse.Namespace) -> None:
    """Refuse outputs that cannot be, before any work is done."""
    from saddlering_ros.bags.samples import check_table_path

    if args.out == '-' and args.json == '-':
        raise BagError('--out - and --json -: give stdout to one of them only')
    if args.out is not None and args.out != '-':
        check_table_path(Path(args.out))


def deliver(
    args: argparse.Namespace, run: Record,
    table: Iterable[Columns], zero: ZeroReading,
    what: str, notes: list[str],
) -> None:
    """Write the requested files; without --out or --json on stdout, print a summary."""
    from collections import deque
    import sys

    from saddlering_ros.bags.samples import csv_lines, SamplesSummary, write_samples
    from saddlering_ros.files import origins_of, Provenance

    made = Provenance((run.origin,), origins_of(args.rig, getattr(args, 'params', None)))
    seen = SamplesSummary()
    parts = seen.watch(table)
    if args.out == '-':
        sys.stdout.writelines(csv_lines(parts))
    elif args.out is not None:
        write_samples(Path(args.out), parts, made)
    deque(parts, maxlen=0)
    summary = {**_summary(run, seen, zero, notes), 'provenance': made.as_dict()}
    if tell_json(args, summary):
        return
    if args.out == '-':
        for note in notes:
            print(f'saddlering {args.command}: note: {note}', file=sys.stderr)
    else:
        _print_summary(args, run, seen, zero, what, notes)


def deliver_simulation(args: argparse.Namespace, stretches_of: StretchesOf, what: str) -> int:
    """Read the bag, compute its samples stretch by stretch, and deliver them as `what`."""
    from saddlering_ros.bags.samples import displacement_columns

    check_outputs(args)
    take_effects(args)
    rig, parameters = read_model(args)
    run = read_shown(args, args.bag, rig)
    notes = list(run.notes)
    with Bar() as bar:
        stretches, zero = stretches_of(
            rig, run, parameters, notes, lambda share: bar.show('simulate', share))
        table = (displacement_columns(run, batch) for batch in stretches)
        deliver(args, run, table, zero, what, notes)
    return 0


def _summary(
    run: Record, seen: SamplesSummary, zero: ZeroReading, notes: list[str],
) -> dict[str, Any]:
    import math

    from saddlering_ros.record.scratch import extremes
    from saddlering_ros.rig import CHANNELS

    channels = {
        name: {'min': _or_none(seen.lowest[name]), 'max': _or_none(seen.highest[name]),
               'last': _or_none(seen.last[name])}
        for name in CHANNELS} if seen.count else {}
    return {
        'bag': str(run.path), 'test': run.test, 'elevation_deg': math.degrees(run.elevation),
        'samples': seen.count, 'load_samples': len(run.stamps),
        'duration': float(run.time[-1]), 'load_max': float(extremes(run.load)[1]),
        'zero': {'load': zero.load, 'near_preload': zero.near_preload},
        'validity': seen.validity, 'channels': channels, 'notes': notes}


def _or_none(value: float) -> float | None:
    return value if value == value else None


def _shown(value: float) -> str:
    return f'{value:.2f}' if value == value else 'not known'


def _print_summary(
    args: argparse.Namespace, run: Record, seen: SamplesSummary, zero: ZeroReading,
    what: str, notes: list[str],
) -> None:
    import math

    from rich import box
    from rich.table import Table

    from saddlering_ros.rig import load_rig, MICRO_UNITS

    console = stdout_console()
    console.print(
        f'{run.name}: {run.test} test at {math.degrees(run.elevation):g} deg, {what} at '
        f'{seen.count} of {len(run.stamps)} load stamps over {run.time[-1]:.3f} s')
    console.print(f'zero at {load_rig(args.rig).force_words(zero.load, 3)} ({zero.load:.1f} N)'
                  f'{"" if zero.near_preload else " (not near the preload)"}')
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column('channel')
    for title in ('lowest', 'highest', 'at peak load', 'last'):
        table.add_column(title, justify='right')
    table.add_column('unit')
    for name, unit in MICRO_UNITS.items():
        if seen.count:
            shown = (seen.lowest, seen.highest, seen.at_peak, seen.last)
            table.add_row(name, *(_shown(of[name] * PER_MILLION) for of in shown), unit)
    console.print(table)
    doubtful = ', '.join(f'{count} {words}' for words, count in seen.validity.items()
                         if count and words != 'sound')
    if doubtful:
        notes = [*notes, f'column validity marks {doubtful} of {seen.count} samples']
    for note in notes:
        console.print(f'note: {note}', highlight=False)
    if args.out is not None:
        console.print(f'written: {args.out}', highlight=False)
