"""`saddlering campaign`: diagnose all bags of a folder and compare the rings."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._terminal import Bar, stdout_console, tell_json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from saddlering_ros.campaign import Session, SessionTask, Store, Summary
    from saddlering_ros.fleet.attention import Fleet

STATUS = 'status'


EXAMPLES = (
    ('saddlering campaign bags --out campaign --plan', 'the bags, and the sessions that '
     'they form'),
    ('saddlering campaign bags --out campaign', 'a verdict for each; again: continue'),
    ('saddlering campaign status campaign', 'its progress'),
)
UNTRIED = 'test/campaign tests it'
"""Why no test types these examples."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'campaign', help='diagnose all bags of a folder and compare the rings',
        description='Group the bags of a folder into sessions, diagnose each session, and compare '
        'the rings. `saddlering campaign status STORE` shows how far a campaign is.')
    parser.add_argument('folder', type=arguments.bags_below, metavar='FOLDER',
                        help='folder of the bags, or the word status')
    parser.add_argument('store', nargs='?', type=arguments.file_read, metavar='STORE',
                        help='after the word status: folder of the campaign')
    parser.add_argument('--out', type=arguments.folder_filled, metavar='STORE',
                        help='folder for the results; a second run computes the missing ones')
    parser.add_argument('--scheduler', metavar='ADDRESS',
                        help='a Dask scheduler (default: processes of this machine)')
    parser.add_argument('--jobs', type=int, metavar='N',
                        help='sessions at a time on this machine (default: its processors)')
    arguments.add_rig_option(parser)
    parser.add_argument('--manifest', type=arguments.file_read, metavar='FILE.csv',
                        help='table that groups the bags into sessions (an edited manifest.csv)')
    parser.add_argument('--gap', type=float, default=24.0, metavar='HOURS',
                        help='a longer time without a test begins a new session (default 24)')
    parser.add_argument('--hold-out', type=float, metavar='DEG',
                        help='hold out the tests at this elevation')
    parser.add_argument('--plan', action='store_true', help='show the sessions and stop')
    parser.add_argument('--retry', action='store_true', help='repeat the sessions that failed')
    parser.add_argument('--time-limit', type=float, default=1800.0, metavar='S',
                        help='longest time for one session (default 1800)')
    parser.add_argument('--memory-limit', type=float, default=6.0, metavar='GB',
                        help='largest memory of one session (default 6)')
    parser.add_argument('--reports', choices=('flagged', 'none'), default='flagged',
                        help='a report for every session with a finding (default), or for none')
    arguments.add_json_option(parser, 'write the content of fleet.json as JSON; - for stdout')
    parser.add_argument('--limit', action='append', default=[], metavar='NAME=VALUE',
                        help='a limit of K or D, as K1=6e7 (SI): gives remaining life')


def run(args: argparse.Namespace) -> int:
    """Find, group, show, compute, compact, judge the fleet."""
    if str(args.folder) == STATUS and args.store is not None:
        return _show_status(args.store)
    import json

    from saddlering_ros import campaign
    from saddlering_ros.campaign import CampaignError
    from saddlering_ros.campaign.tables import write_fleet, write_tables
    from saddlering_ros.fleet import limits_from_text
    from saddlering_ros.rig import load_rig

    _check(args)
    load_rig(args.rig)
    limits = limits_from_text(args.limit)
    with Bar() as bar:
        bags = campaign.find_bags(
            args.folder, lambda count: bar.show('find', 0.0, f'{count} bags'))
    if not bags:
        raise CampaignError(f'{args.folder}: has no bags: give the folder of the bags')
    if args.manifest is not None:
        sessions = campaign.read_manifest(args.manifest, bags)
    else:
        sessions = campaign.group_sessions(bags, args.gap * 3600.0, args.hold_out)
    if args.json != '-':
        _print_plan(sessions)
    if args.plan:
        return 0
    store = campaign.Store(args.out)
    store.prepare()
    campaign.write_manifest(store.folder, sessions)
    session = campaign.SessionLimits(args.time_limit, int(args.memory_limit * 2**30))
    tasks = campaign.tasks_of(
        sessions, args.rig, session,
        reports=store.reports if args.reports == 'flagged' else None)
    summary = _compute(args, tasks, store)
    write_tables(store, tasks)
    fleet = write_fleet(store, tasks, limits)
    if not tell_json(args, json.loads((store.folder / 'fleet.json').read_text())):
        _print_fleet(fleet)
        print(_outcome(summary, store))
    return 1 if summary.faults else 0


def _check(args: argparse.Namespace) -> None:
    from saddlering_ros.campaign import CampaignError

    if args.out is None and not args.plan:
        raise CampaignError('no --out: give the folder for the results')
    if args.store is not None:
        raise CampaignError(f'{args.store}: give one folder of bags only; --out is the folder '
                            'for the results')
    for name in ('gap', 'time_limit', 'memory_limit'):
        if not getattr(args, name) > 0.0:
            raise CampaignError(f'--{name.replace("_", "-")} is {getattr(args, name):g}: '
                                'give a number above 0')
    if args.jobs is not None and args.jobs < 1:
        raise CampaignError(f'--jobs is {args.jobs}: give 1 or more')


def _print_plan(sessions: list[Session]) -> None:
    from rich.table import Table

    from saddlering_ros.campaign.sessions import session_table

    rows = session_table(sessions)
    table = Table(box=None, pad_edge=False)
    for name in rows[0]:
        table.add_column(name)
    for row in rows[:MAX_SHOWN]:
        table.add_row(*map(str, row.values()))
    console = stdout_console()
    console.print(table)
    if len(rows) > MAX_SHOWN:
        console.print(f'... and {len(rows) - MAX_SHOWN} more: see manifest.csv')
    bags = sum(len(session.members) for session in sessions)
    console.print(f'{len(sessions)} sessions of {len({item.ring for item in sessions})} rings, '
                  f'{bags} bags')


MAX_SHOWN = 40
"""Sessions listed before a campaign starts."""


def _compute(args: argparse.Namespace, tasks: Sequence[SessionTask], store: Store) -> Summary:
    import sys

    from saddlering_ros.campaign import run_campaign
    from saddlering_ros.campaign.running import dask_workers, local_workers

    workers = local_workers(args.jobs) if args.scheduler is None else dask_workers(args.scheduler)
    with workers as found, Bar() as bar:
        if found.warning:
            print(f'saddlering campaign: {found.warning}', file=sys.stderr)
        return run_campaign(
            tasks, store, found, retry=args.retry,
            on_status=lambda status: bar.show(
                'campaign', status.done / max(status.total, 1), str(status)))


def _show_status(folder: Path) -> int:
    import time

    from saddlering_ros.campaign import Store

    status = Store(folder).read_status()
    state = 'running' if status.running else (
        'finished' if status.done == status.total else 'stopped: repeat the command to continue')
    if status.running and time.time() - status.updated > STALE:
        state = 'no sign of life for a minute: repeat the command to continue'
    print(f'{status}; {state}')
    return 0


STALE = 60.0
"""A campaign whose status is older than this [s] was killed."""


def _print_fleet(fleet: Fleet) -> None:
    """The rings and rigs that need a person, a line each."""
    for drift in fleet.rigs:
        print(f'rig {drift.owner}: its rings drift together: {drift.next_test}')
    for item in [item for item in fleet.rings if item.reasons][:MAX_SHOWN]:
        print(f'ring {item.ring}: {"; ".join(item.reasons)}')


def _outcome(summary: Summary, store: Store) -> str:
    words = (f'{summary.done} of {summary.total} sessions have a result, {summary.computed} of '
             f'them new; written: {store.folder / "report.html"}')
    if summary.failed:
        words += f'; {summary.failed} failed: verdicts.parquet has the reasons'
    if summary.altered:
        words += (f'; {len(summary.altered)} result files were damaged or altered and are '
                  f'computed again, first {summary.altered[0]}')
    return words
