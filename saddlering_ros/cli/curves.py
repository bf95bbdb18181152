"""`saddlering displacement`, `simulate` and `residual`: the motion of the ring in a bag."""

from __future__ import annotations

import argparse
from collections import deque
import math
from pathlib import Path
import sys
from typing import Any, TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import AddOption, Bar, Command, option, show_table, tell_json
from saddlering_ros.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable

    from saddlering_ros.bags.samples import SamplesSummary
    from saddlering_ros.record.record import Record
    from saddlering_ros.rig import ParameterSet, Rig
    from saddlering_ros.rig.geometry import ZeroReading


def _command(name: str, words: str, description: str, *examples: tuple[str, str],
             model: tuple[AddOption, ...] = arguments.MODEL) -> Command:
    return Command(name, words, description, (
        option('bag', 'rosbag2 directory or .mcap file', type=arguments.bag_read, metavar='BAG'),
        *arguments.READING, *model,
        option('--out', 'write the samples here (.csv or .parquet); - for CSV on stdout',
               type=arguments.text_written, metavar='FILE'),
        arguments.json_option()), examples)


COMMANDS = (
    _command(
        'displacement', 'compute the measured motion of the ring from a bag',
        'Compute the motion of the ring from the four probe gaps, at the stamps of the load, as '
        'the node ring_displacement does live.',
        ('saddlering displacement bags/static_50', 'the motion of the ring, in a few lines'),
        ('saddlering displacement bags/static_50 --out ring.csv', 'every sample as a table'),
        model=()),
    _command(
        'simulate', 'simulate the ring under the load of a bag',
        'Integrate the model of the ring under the load of a bag, as the node ring_simulator does '
        'live.',
        ('saddlering simulate bags/static_70 --params params.yaml --out simulated.csv',
         'the motion of the model under the load of a bag')),
    _command(
        'residual', 'compute measured minus simulated motion for a bag',
        'Subtract the simulated motion of the ring from the measured one where both have a '
        'sample, as the node ring_residual does live.',
        ('saddlering residual bags/static_70 --params params.yaml --out residual.parquet',
         'measured minus simulated, sample by sample')))


def run(args: argparse.Namespace) -> int:
    """Read, compute and write stretch by stretch; without --out or --json -, print a summary."""
    from saddlering_ros.bags import samples
    from saddlering_ros.files import origins_of, Provenance
    from saddlering_ros.record.displacement import measured_stretches
    from saddlering_ros.record.residual import residual_stretches, simulated_stretches
    from saddlering_ros.record.scratch import extremes
    from saddlering_ros.rig import CHANNELS, load_rig

    if args.out == '-' and args.json == '-':
        raise BagError('--out - and --json -: give stdout to one of them only')
    if args.out is not None and args.out != '-':
        samples.check_table_path(Path(args.out))
    kinds: dict[str, tuple[str, Callable[..., Any]]] = {
        'displacement': ('measured', measured_stretches),
        'simulate': ('simulated', simulated_stretches),
        'residual': ('measured minus simulated', residual_stretches)}
    kind, stretches_of = kinds[args.command]
    model: list[ParameterSet] = []
    if args.command == 'displacement':
        rig = load_rig(args.rig)
    else:
        arguments.take_effects(args)
        rig, *model = arguments.read_model(args)
    run = arguments.read_shown(args, args.bag, rig)
    notes, seen = list(run.notes), samples.SamplesSummary()
    made = Provenance((run.origin,), origins_of(args.rig, getattr(args, 'params', None)))
    with Bar() as bar:
        stretches, zero = stretches_of(
            rig, run, *model, notes, lambda share: bar.show('compute', share))
        parts = seen.watch(samples.displacement_columns(run, batch) for batch in stretches)
        if args.out == '-':
            sys.stdout.writelines(samples.csv_lines(parts))
        elif args.out is not None:
            samples.write_samples(Path(args.out), parts, made)
        deque(parts, maxlen=0)
    shown = {'min': seen.lowest, 'max': seen.highest, 'last': seen.last}
    if tell_json(args, {
            'bag': str(run.path), 'test': run.test,
            'elevation_deg': math.degrees(run.elevation), 'samples': seen.count,
            'load_samples': len(run.stamps), 'duration': float(run.time[-1]),
            'load_max': float(extremes(run.load)[1]),
            'zero': {'load': zero.load, 'near_preload': zero.near_preload},
            'validity': seen.validity, 'channels': {
                name: {words: None if math.isnan(of[name]) else of[name]
                       for words, of in shown.items()}
                for name in CHANNELS} if seen.count else {},
            'notes': notes, 'provenance': made.as_dict()}):
        return 0
    if args.out == '-':
        for note in notes:
            print(f'saddlering {args.command}: note: {note}', file=sys.stderr)
        return 0
    doubtful = _show_curves(run, rig, kind, zero, seen)
    if doubtful:
        notes = [*notes, f'column validity marks {doubtful} of {seen.count} samples']
    console = arguments.stdout_console()
    for note in notes:
        console.print(f'note: {note}')
    if args.out is not None:
        console.print(f'written: {args.out}')
    return 0


def _show_curves(run: Record, rig: Rig, kind: str, zero: ZeroReading,
                 seen: SamplesSummary) -> str:
    """Print the extent of the curves; the number of doubtful samples by kind, in words."""
    from saddlering_ros.rig import MICRO_UNITS

    console = arguments.stdout_console()
    console.print(
        f'{run.name}: {run.test} test at {math.degrees(run.elevation):g} deg, '
        f'{kind} at {seen.count} of {len(run.stamps)} load stamps over '
        f'{run.time[-1]:.3f} s')
    console.print(f'zero at {rig.force_words(zero.load, 3)} ({zero.load:.1f} N)'
                  f'{"" if zero.near_preload else " (not near the preload)"}')
    show_table(
        ('channel', 'lowest', 'highest', 'at peak load', 'last', 'unit'),
        [(name, *('not known' if math.isnan(of[name]) else f'{1e6 * of[name]:.2f}'
                  for of in (seen.lowest, seen.highest, seen.at_peak, seen.last)), unit)
         for name, unit in MICRO_UNITS.items() if seen.count])
    return ', '.join(f'{count} {words}' for words, count in seen.validity.items()
                     if count and words != 'sound')
