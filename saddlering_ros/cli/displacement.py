"""`saddlering displacement`: the measured motion of the ring from a bag."""

from __future__ import annotations

import argparse
from typing import Any

from saddlering_ros.cli._arguments import add_bag_options, add_output_options
from saddlering_ros.cli._samples import check_outputs, deliver, read_shown
from saddlering_ros.cli._terminal import Bar

EXAMPLES = (
    ('saddlering displacement bags/static_50', 'the motion of the ring, in a few lines'),
    ('saddlering displacement bags/static_50 --out ring.csv', 'every sample as a table'),
)


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'displacement', help='compute the measured motion of the ring from a bag',
        description='Compute the motion of the ring from the four probe gaps, at the stamps '
                    'of the load, as the node ring_displacement does live.')
    add_bag_options(parser)
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read, zero, compute and deliver stretch by stretch."""
    from saddlering_ros.bags.samples import displacement_columns
    from saddlering_ros.record.displacement import measured_blocks, zero_of_run
    from saddlering_ros.rig import load_rig

    check_outputs(args)
    rig = load_rig(args.rig)
    test_run = read_shown(args, args.bag, rig)
    zero = zero_of_run(rig, test_run)
    notes = list(test_run.notes)
    if not zero.reading.near_preload:
        notes.append('the record has no steady start near the preload; its zero is at another '
                     'load')
    with Bar() as bar:
        stretches = measured_blocks(rig, test_run, zero, lambda share: bar.show('compute', share))
        deliver(args, test_run, (displacement_columns(test_run, batch) for batch in stretches),
                zero.reading, 'measured', notes)
    return 0
