"""`saddlering diagnose`: the cause that the simulation lacks."""

import argparse
from pathlib import Path

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, finish, option

COMMANDS = (Command(
    'diagnose', 'name the cause that the simulation lacks',
    'Fit the model to the bags, and search the catalogue of effects for the cause of what is '
    'left. The verdict names a cause, states that several explain the misfit, or that none is '
    'known.', (
        arguments.bags_option('runs to diagnose'), *arguments.READING,
        option('--hold-out', 'held-out runs, on which the misfit reduction is measured',
               type=arguments.bag_read, nargs='+', default=[], metavar='BAG'),
        option('--params', 'parameter file to start from', type=arguments.file_read),
        arguments.json_option('write the verdict as JSON; - for stdout'), arguments.REPORT,
        option('--out', 'write the extended parameter file here', type=arguments.file_written),
        option('--seed', 'seed of the base fit (default 0)', type=int, default=0),
        option('--propose', 'folder for the effect file of a proposed law (default with --json '
               'FILE: FILE without its suffix, followed by _effects)',
               type=arguments.folder_filled, metavar='DIR'),
        arguments.EFFECTS), (
        ('saddlering diagnose bags/static_50 bags/dynamic_50 --hold-out bags/static_70 '
         '--out extended.yaml --report report.html',
         'name the missing cause, with a held-out run; write a report and parameters'),)),)


def run(args: argparse.Namespace) -> int:
    """Diagnose and print, write or emit the verdict."""
    from saddlering_ros import diagnose, load_rig

    arguments.take_effects(args)
    rig = load_rig(args.rig)
    fitted, held_out = (arguments.bags_of(args, bags, rig) for bags in (args.bags, args.hold_out))
    with Bar() as bar:
        result = diagnose(fitted, hold_out=held_out, rig=args.rig, parameters=args.params,
                          seed=args.seed, trust_rig=args.trust_rig,
                          on_progress=bar.tell)
    folder = args.propose
    if folder is None and args.json not in (None, '-'):
        file = Path(args.json)
        folder = file.with_name(f'{file.stem}_effects')
    if folder is not None:
        result = result.with_effect_files(folder)
    return finish(args, result)
