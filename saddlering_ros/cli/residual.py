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
    """Read, measure, simulate, subtract where both have a sample, deliver."""
    from saddlering_ros.cli._samples import (
        check_outputs,
        deliver,
        read_shown,
        residual_samples,
    )
    from saddlering_ros.rig import load_rig, read_parameters

    check_outputs(args)
    rig = load_rig(args.rig)
    parameters = read_parameters(args.params)
    test_run = read_shown(args, rig)
    samples, zero, notes = residual_samples(test_run, rig, parameters)
    deliver(args, test_run, samples, zero, 'measured minus simulated', notes)
    return 0
