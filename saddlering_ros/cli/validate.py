"""`saddlering validate` and `report`: the prediction of bags by a parameter file."""

import argparse

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, finish, option

INPUTS = (arguments.bags_option('runs to predict'), *arguments.READING, *arguments.MODEL,
          arguments.json_option('write all figures as JSON; - for stdout'))

COMMANDS = (
    Command(
        'validate', 'check how well parameters predict bags',
        'Simulate tests with given parameters, and compare the prediction with the measurement '
        'by figures of merit for each channel.', (
            *INPUTS,
            option('--plots', 'write figures of simulated and measured over load and time, one '
                   'per run', type=arguments.folder_filled, metavar='DIR'),
            arguments.REPORT), (
            ('saddlering validate bags/static_70 bags/dynamic_70 --params params.yaml '
             '--plots pictures',
             'figures of merit for each channel, and a figure of each run'),)),
    Command(
        'report', 'write a report on parameters and their predictions',
        'Write one HTML file that opens offline: the parameters with their uncertainty, and '
        'simulation beside measurement for the given bags. saddlering diagnose --report writes '
        'the report of a diagnosis.', (
            *INPUTS,
            option('--out', 'the report to write', dest='report', type=arguments.page_written,
                   required=True, metavar='FILE.html')), (
            ('saddlering report bags/static_70 --params params.yaml --out parameters.html',
             'a report on the prediction of another test'),)))


def run(args: argparse.Namespace) -> int:
    """Validate and print, write or emit the figures."""
    from saddlering_ros import load_rig, read_parameters, validate

    arguments.take_effects(args)
    read_parameters(args.params)  # a fault there is reported before any bag is read
    bags = arguments.bags_of(args, args.bags, load_rig(args.rig))
    with Bar() as bar:
        result = validate(bags, parameters=args.params, rig=args.rig,
                          trust_rig=args.trust_rig, on_progress=bar.tell)
    return finish(args, result)
