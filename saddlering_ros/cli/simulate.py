"""`saddlering simulate`: the simulated motion of the ring under the load of a bag."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    from saddlering_ros.cli._samples import (
        add_bag_options,
        add_effects_option,
        add_output_options,
        add_parameter_option,
    )

    parser = subparsers.add_parser(
        'simulate', help='simulate the ring under the load of a bag')
    add_bag_options(parser)
    add_parameter_option(parser)
    add_effects_option(parser)
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read, simulate, deliver."""
    from saddlering_ros.cli._samples import (
        check_outputs,
        deliver,
        read_shown,
        simulated_samples,
        take_effects,
    )
    from saddlering_ros.rig import load_rig, read_parameters

    check_outputs(args)
    take_effects(args)
    rig = load_rig(args.rig)
    parameters = read_parameters(args.params)
    test_run = read_shown(args, rig)

    from saddlering_ros.ring import simulate

    simulated = simulate(rig, parameters, test_run.elevation, test_run.time, test_run.load)
    samples, notes = simulated_samples(test_run, simulated)
    deliver(args, test_run, samples, simulated.zero, 'simulated', notes)
    return 0
