"""`saddlering demo`: all steps on live nodes, from recorded bags to a named cause."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from saddlering_ros.cli._arguments import add_json_option, bags_below, folder_filled
from saddlering_ros.cli._terminal import tell_json

if TYPE_CHECKING:
    from saddlering_ros.demo.story import DemoOutcome


EXAMPLES = (
    ('saddlering demo --out out', 'all steps; then open out/report.html'),
)
UNTRIED = 'test/cli/test_demo.py runs it'
"""Why no test types these examples."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'demo', help='run all steps with live nodes, and write a report',
        description='Replay bags through live nodes, identify the parameters, diagnose what '
                    'the simulation lacks, and verify the result on another test. The folder '
                    'then holds a report that opens offline.')
    parser.add_argument('--out', type=folder_filled, default=Path('out'), metavar='DIR',
                        help='folder for report, pictures, numbers, parameters (default: out)')
    parser.add_argument('--bags', type=bags_below, metavar='DIR',
                        help='folder of bags at two elevations (default: the shipped ones)')
    add_json_option(parser, 'write all numbers as JSON; - for stdout (the steps then go to '
                             'stderr)')


def run(args: argparse.Namespace) -> int:
    """Run the demo, write its folder, print a summary."""
    import contextlib
    import os
    import sys

    from saddlering_ros.demo.output import check_folder, numbers_of, write_all
    from saddlering_ros.demo.story import Console, plan, STEPS, tell
    from saddlering_ros.files import share_directory
    from saddlering_ros.rig import RIG_VARIABLE

    os.environ.pop(RIG_VARIABLE, None)  # the demonstration is of the shipped rig
    check_folder(args.out)
    chosen = plan(args.bags or share_directory() / 'bags')
    told = contextlib.redirect_stdout(sys.stderr if args.json == '-' else sys.stdout)
    with told, Console(STEPS) as console:
        outcome = tell(chosen, console)
        console.step(f'writing {args.out}/')
        files = write_all(outcome, args.out, args.command_line)
        seconds = console.seconds
    if tell_json(args, numbers_of(outcome)):
        return 0
    print(summary(outcome))
    print(f'\n{seconds:.0f} s. Open {args.out / "report.html"} '
          f'({len(files)} files in {args.out}/)')
    return 0


def summary(outcome: DemoOutcome) -> str:
    """The findings in at most one screen of lines."""
    from saddlering_ros.demo.story import JUDGED, misfit_table, overall_misfit
    from saddlering_ros.diagnosis.ring_wording import (
        causes_of,
        gain_sentence,
        headline,
        parameter_words,
    )
    from saddlering_ros.quantities import percent

    verdict = outcome.verdict
    lines = ['', f'Verdict: {verdict["verdict"]}. {headline(verdict)}']
    if verdict.get('next_test'):
        lines.append(f'Next test: {verdict["next_test"]}')
    lines += [f'  {cause["effect"]}: {parameter_words(cause)}' for cause in causes_of(verdict)]
    lines += [gain_sentence(verdict), '',
              "Misfit in % of the channel's range, from the zero of the live nodes (diagnose also "
              'fits offsets):',
              f'  {"run":24s} {"channel":8s} {"identified":>11s} {"extended":>9s} {"noise":>7s}']
    for entry in misfit_table(outcome.curves):
        for name in JUDGED:
            item = entry['channels'][name]
            shares = (item['nrmse_before'], item['nrmse_after'], item['noise_floor'])
            shown = ['-' if share is None else f'{100.0 * share:.2f}' for share in shares]
            lines.append(f'  {entry["bag"]:24s} {name:8s} {shown[0]:>11s} {shown[1]:>9s} '
                         f'{shown[2]:>7s}')
    second = outcome.verified[0].elevation_deg
    before, after = (overall_misfit(outcome.verified, extended=item) for item in (False, True))
    lines += ['', f'Misfit measured live at {second:g} deg, held out before: {percent(before)} '
                  f'-> {percent(after)}, reduced by {percent(outcome.gain)}.']
    return '\n'.join(line for line in lines if line is not None)
