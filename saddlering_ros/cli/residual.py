"""`saddlering residual`: what a bag's probes measured less what the model gives."""

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
        'residual', help='measured less simulated displacement, as the live node publishes it')
    add_bag_options(parser)
    add_parameter_option(parser)
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read, measure, simulate, subtract where both have a sample, deliver."""
    import numpy as np

    from saddlering_ros.bags import displacement_of_run
    from saddlering_ros.bags.samples import DisplacementSamples, measured_samples
    from saddlering_ros.cli._samples import check_outputs, deliver, read_shown, simulated_samples
    from saddlering_ros.rig import CHANNELS, Displacement, load_rig, read_parameters
    from saddlering_ros.bags import read_run
    from saddlering_ros.cli._samples import check_outputs, deliver, radians, residual_samples
    from saddlering_ros.rig import load_rig, read_parameters

    check_outputs(args)
    rig = load_rig(args.rig)
    parameters = read_parameters(args.params)
    test_run = read_shown(args, rig)

    from saddlering_ros.ring import simulate

    measured = displacement_of_run(rig, test_run)
    seen = measured_samples(measured)
    found, notes = simulated_samples(
        test_run,
        simulate(rig, parameters, test_run.elevation, test_run.time, test_run.load))
    _, here, there = np.intersect1d(
        seen.stamps, found.stamps, assume_unique=True, return_indices=True)
    left = Displacement(**{
        name: (np.asarray(getattr(seen.displacement, name))[here]
               - np.asarray(getattr(found.displacement, name))[there]) for name in CHANNELS})
    samples = DisplacementSamples(seen.stamps[here], seen.time[here], seen.load[here], left)
    deliver(args, test_run, samples, measured.zero, 'measured less simulated', notes)
    test_run = read_run(args.bag, test=args.test, elevation=radians(args.elevation), rig=rig)
    samples, zero, notes = residual_samples(test_run, rig, parameters)
    deliver(args, test_run, samples, zero, 'measured less simulated', notes)
    return 0
