"""Samples of `simulate` and `residual`, stretch by stretch, so that a long run is not kept."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator

from saddlering_ros.bags.samples import displacement_columns
from saddlering_ros.cli._arguments import take_effects
from saddlering_ros.cli._samples import check_outputs, deliver, read_shown
from saddlering_ros.cli._terminal import Bar
from saddlering_ros.record import Record
from saddlering_ros.record.samples import Displacements
from saddlering_ros.rig import load_rig, ParameterSet, read_parameters, Rig, ZeroReading

StretchesOf = Callable[[Rig, Record, ParameterSet, list[str], Callable[[float], None]],
                       tuple[Iterator[Displacements], ZeroReading]]


def deliver_simulation(args: argparse.Namespace, stretches_of: StretchesOf, what: str) -> int:
    """Read the bag, compute its samples stretch by stretch, and deliver them as `what`."""
    check_outputs(args)
    take_effects(args)
    rig, parameters = load_rig(args.rig), read_parameters(args.params)
    run = read_shown(args, rig)
    notes = list(run.notes)
    with Bar() as bar:
        stretches, zero = stretches_of(
            rig, run, parameters, notes, lambda share: bar.show('simulate', share))
        table = (displacement_columns(run, batch) for batch in stretches)
        deliver(args, run, table, zero, what, notes)
    return 0
