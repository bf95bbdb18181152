"""`saddlering residual`: measured minus simulated motion for a bag."""

from __future__ import annotations

import argparse
from typing import Any

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._samples import deliver_simulation

EXAMPLES = (
    ('saddlering residual bags/static_70 --params params.yaml --out residual.parquet',
     'measured minus simulated, sample by sample'),
)


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'residual', help='compute measured minus simulated motion for a bag',
        description='Subtract the simulated motion of the ring from the measured one where '
                    'both have a sample, as the node ring_residual does live.')
    arguments.add_bag_options(parser)
    arguments.add_parameter_options(parser)
    arguments.add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read, simulate, subtract and deliver stretch by stretch."""
    from saddlering_ros.record.residual import residual_stretches

    return deliver_simulation(args, residual_stretches, 'measured minus simulated')
