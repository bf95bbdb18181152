"""`saddlering residual`: measured minus simulated motion for a bag."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    from saddlering_ros.cli._samples import (
        add_bag_options,
        add_output_options,
        add_parameter_option,
    )

    parser = subparsers.add_parser(
        'residual', help='compute measured minus simulated motion for a bag')
    add_bag_options(parser)
    add_parameter_option(parser)
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read, simulate, subtract and deliver stretch by stretch."""
    from saddlering_ros.cli._progress import Bar
    from saddlering_ros.cli._samples import check_outputs, deliver, read_shown
    from saddlering_ros.rig import load_rig, read_parameters

    check_outputs(args)
    rig = load_rig(args.rig)
    parameters = read_parameters(args.params)
    test_run = read_shown(args, rig)

    from saddlering_ros.cli._simulated import residual_samples

    notes = list(test_run.notes)
    with Bar() as bar:
        samples, zero = residual_samples(
            rig, test_run, parameters, notes, lambda share: bar.show('simulate', share))
        deliver(args, test_run, samples, zero, 'measured minus simulated', notes)
    return 0
