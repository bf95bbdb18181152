"""`saddlering campaign`: diagnose all bags of a folder and compare the rings."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys
import time
from typing import TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, option, show_table, tell_json, Within

if TYPE_CHECKING:
    from collections.abc import Sequence

    from saddlering_ros.campaign.sessions import Session
    from saddlering_ros.campaign.store import Status, Store
    from saddlering_ros.campaign.task import SessionTask

MAX_SHOWN = 40
"""Sessions listed before a campaign starts."""

STALE = 60.0
"""A campaign whose status is older than this [s] was killed."""

COMMANDS = (Command(
    'campaign', 'diagnose all bags of a folder and compare the rings',
    'Group the bags of a folder into sessions, diagnose each session, and compare the rings. '
    '`saddlering campaign status STORE` shows how far a campaign is.', (
        option('folder', 'folder of the bags, or the word status', type=arguments.bags_below,
               metavar='FOLDER'),
        option('store', 'after the word status: folder of the campaign', nargs='?',
               type=arguments.file_read, metavar='STORE'),
        option('--out', 'folder for the results; a second run computes the missing ones',
               type=arguments.folder_filled, metavar='STORE'),
        option('--scheduler', 'a Dask scheduler (default: processes of this machine)',
               metavar='ADDRESS'),
        option('--jobs', 'sessions at a time on this machine (default: its processors)',
               type=Within(int, 1), metavar='N'),
        arguments.RIG,
        option('--manifest', 'table that groups the bags into sessions (an edited manifest.csv)',
               type=arguments.file_read, metavar='FILE.csv'),
        option('--gap', 'a longer time without a test begins a new session (default 24)',
               type=Within(float, 1e-3), default=24.0, metavar='HOURS'),
        option('--hold-out', 'hold out the tests at this elevation', type=float, metavar='DEG'),
        option('--plan', 'show the sessions and stop', action='store_true'),
        option('--retry', 'repeat the sessions that failed', action='store_true'),
        option('--time-limit', 'longest time for one session (default 1800)',
               type=Within(float, 1e-3), default=1800.0, metavar='S'),
        option('--memory-limit', 'largest memory of one session (default 6)',
               type=Within(float, 1e-3), default=6.0, metavar='GB'),
        option('--reports', 'a report for every session with a finding (default), or for none',
               choices=('flagged', 'none'), default='flagged'),
        arguments.json_option('write the content of fleet.json as JSON; - for stdout'),
        option('--limit', 'a limit of K or D, as K1=6e7 (SI): gives remaining life',
               action='append', default=[], metavar='NAME=VALUE')), (
        ('saddlering campaign bags --out campaign --plan',
         'the bags, and the sessions that they form'),
        ('saddlering campaign bags --out campaign', 'a verdict for each; again: continue'),
        ('saddlering campaign status campaign', 'its progress')),
    'test/campaign tests it'),)


def run(args: argparse.Namespace) -> int:
    """Find, group, show, compute, compact, judge the fleet."""
    if str(args.folder) == 'status' and args.store is not None:
        return _show_status(args.store)

    from saddlering_ros.campaign import sessions, task
    from saddlering_ros.campaign.store import CampaignError, Store
    from saddlering_ros.campaign.tables import write_fleet, write_tables
    from saddlering_ros.fleet.attention import limits_from_text
    from saddlering_ros.rig import load_rig

    if args.out is None and not args.plan:
        raise CampaignError('no --out: give the folder for the results')
    if args.store is not None:
        raise CampaignError(f'{args.store}: give one folder of bags only; --out is the folder '
                            'for the results')
    load_rig(args.rig)
    limits = limits_from_text(args.limit)
    with Bar() as bar:
        bags = sessions.find_bags(
            args.folder, lambda count: bar.show('find', 0.0, f'{count} bags'))
    if not bags:
        raise CampaignError(f'{args.folder}: has no bags: give the folder of the bags')
    if args.manifest is not None:
        grouped = sessions.read_manifest(args.manifest, bags)
    else:
        grouped = sessions.group_sessions(bags, args.gap * 3600.0, args.hold_out)
    if args.json != '-':
        _print_plan(grouped)
    if args.plan:
        return 0
    store = Store(args.out)
    store.prepare()
    sessions.write_manifest(store.folder, grouped)
    limits_of_one = task.SessionLimits(args.time_limit, int(args.memory_limit * 2**30))
    tasks = task.tasks_of(
        grouped, args.rig, limits_of_one,
        reports=store.reports if args.reports == 'flagged' else None)
    summary = _compute(args, tasks, store)
    write_tables(store, tasks)
    fleet = write_fleet(store, tasks, limits)
    if not tell_json(args, json.loads((store.folder / 'fleet.json').read_text())):
        for drift in fleet.rigs:
            print(f'rig {drift.owner}: its rings drift together: {drift.next_test}')
        for ring in [ring for ring in fleet.rings if ring.reasons][:MAX_SHOWN]:
            print(f'ring {ring.ring}: {"; ".join(ring.reasons)}')
        words = (f'{summary.done} of {summary.total} sessions have a result, {summary.computed} '
                 f'of them new; written: {store.folder / "report.html"}')
        if summary.failed:
            words += f'; {summary.failed} failed: verdicts.parquet has the reasons'
        if summary.altered:
            words += (f'; {len(summary.altered)} result files were damaged or altered and are '
                      f'computed again, first {summary.altered[0]}')
        print(words)
    return 1 if summary.faults else 0


def _print_plan(sessions: list[Session]) -> None:
    show_table(['session', 'ring', 'rig', 'date', 'tests', 'note'], [
        (session.name, session.ring, session.bench, session.date, session.tests,
         session.problem or '; '.join(f'{bag.path.name}: {bag.note}'
                                      for bag in session.bags if bag.note))
        for session in sessions[:MAX_SHOWN]], texts=6)
    if len(sessions) > MAX_SHOWN:
        print(f'... and {len(sessions) - MAX_SHOWN} more: see manifest.csv')
    print(f'{len(sessions)} sessions of {len({item.ring for item in sessions})} rings, '
          f'{sum(len(session.bags) for session in sessions)} bags')


def _compute(args: argparse.Namespace, tasks: Sequence[SessionTask], store: Store) -> Status:
    from saddlering_ros.campaign.running import dask_workers, local_workers, run_campaign

    workers = local_workers(args.jobs) if args.scheduler is None else dask_workers(args.scheduler)
    with workers as found, Bar() as bar:
        if found.warning:
            print(f'saddlering campaign: {found.warning}', file=sys.stderr)
        return run_campaign(
            tasks, store, found, retry=args.retry,
            on_status=lambda status: bar.show(
                'campaign', status.done / max(status.total, 1), str(status)))


def _show_status(folder: Path) -> int:
    from saddlering_ros.campaign.store import Store

    status = Store(folder).read_status()
    state = 'running' if status.running else (
        'finished' if status.done == status.total else 'stopped: repeat the command to continue')
    if status.running and time.time() - status.updated > STALE:
        state = 'no sign of life for a minute: repeat the command to continue'
    print(f'{status}; {state}')
    return 0
