"""`saddlering displacement`: the ring displacement that a bag's probes measured."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    from saddlering_ros.cli._samples import add_bag_options, add_output_options

    parser = subparsers.add_parser(
        'displacement', help='measured ring displacement of a bag, as the live node computes it')
    add_bag_options(parser)
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read, zero, compute, deliver."""
    from saddlering_ros.bags import displacement_of_run
    from saddlering_ros.bags.samples import measured_samples
    from saddlering_ros.cli._samples import check_outputs, deliver, read_shown
    from saddlering_ros.rig import load_rig

    check_outputs(args)
    rig = load_rig(args.rig)
    test_run = read_shown(args, rig)
    measured = displacement_of_run(rig, test_run)
    notes = list(test_run.notes)
    if not measured.zero.near_preload:
        notes.append('the record has no steady start near the preload; its zero is elsewhere')
    deliver(args, test_run, measured_samples(measured), measured.zero, 'measured', notes)
    return 0
