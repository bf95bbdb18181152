"""`saddlering simulate`: the simulated motion of the ring under the load of a bag."""

from __future__ import annotations

import argparse
from typing import Any

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._samples import deliver_simulation

EXAMPLES = (
    ('saddlering simulate bags/static_70 --params params.yaml --out simulated.csv',
     'the motion of the model under the load of a bag'),
)


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'simulate', help='simulate the ring under the load of a bag',
        description='Integrate the model of the ring under the load of a bag, as the node '
                    'ring_simulator does live.')
    arguments.add_bag_options(parser)
    arguments.add_parameter_options(parser)
    arguments.add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read, simulate and deliver stretch by stretch."""
    from saddlering_ros.record.simulation import simulated_stretches

    return deliver_simulation(args, simulated_stretches, 'simulated')
