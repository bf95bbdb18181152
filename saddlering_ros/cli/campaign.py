"""`saddlering campaign`: diagnose all bags of a folder and compare the rings."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
from pathlib import Path
import sys
import time
from typing import TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, option, show_table, tell_json, Within
from saddlering_ros.errors import counted

if TYPE_CHECKING:
    from saddlering_ros.campaign.sessions import Session
    from saddlering_ros.campaign.store import Status, Store
    from saddlering_ros.fleet.attention import Fleet

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
        ('saddlering campaign status campaign', 'its progress'))),)


def run(args: argparse.Namespace) -> int:
    """Find, group, show, compute, compact, judge the fleet; or show the status of a store."""
    from saddlering_ros.campaign.store import CampaignError, Store

    if str(args.folder) == 'status' and args.store is not None:
        return _show_status(args.store)

    from saddlering_ros.campaign import running, sessions, task
    from saddlering_ros.campaign.tables import write_fleet, write_tables
    from saddlering_ros.fleet.attention import limits_from_text
    from saddlering_ros.rig import load_rig

    if args.out is None and not args.plan:
        raise CampaignError('no --out: give the folder for the results, or show those of a '
                            'campaign by: saddlering campaign status STORE')
    if args.plan and args.json is not None:
        raise CampaignError('--plan shows the sessions and makes no fleet.json: leave out one of '
                            '--plan and --json')
    if args.store is not None:
        raise CampaignError(f'{args.store}: give one folder of bags only; --out is the folder '
                            'for the results')
    load_rig(args.rig)
    limits = limits_from_text(args.limit)
    grouped = _sessions_of(args)
    if args.json != '-':
        _show_sessions(grouped)
    if args.plan:
        return 0
    store = Store(args.out)
    store.prepare()
    sessions.write_manifest(store.folder, grouped, args.manifest)
    tasks = task.tasks_of(
        grouped, args.rig, seconds=args.time_limit, memory=int(args.memory_limit * 2**30),
        reports=store.reports if args.reports == 'flagged' else None)
    workers = (running.local_workers(args.jobs) if args.scheduler is None else
               running.dask_workers(args.scheduler))
    with workers as slots, Bar() as bar:
        if slots.warning:
            print(f'saddlering campaign: {slots.warning}', file=sys.stderr)
        summary = running.run_campaign(
            tasks, store, slots, retry=args.retry,
            on_status=lambda status: bar.show(
                'campaign', status.done / max(status.total, 1), str(status)))
    write_tables(store, tasks)
    fleet = write_fleet(store, tasks, limits)
    if not tell_json(args, json.loads((store.folder / 'fleet.json').read_text())):
        _show_results(fleet, summary, store)
    return 1 if summary.faults else 0


def _show_status(folder: Path) -> int:
    from saddlering_ros.campaign.store import Store

    status = Store(folder).read_status()
    state = 'running' if status.running else 'finished' if status.done == status.total else (
        'stopped: repeat the command to continue')
    if status.running and time.time() - status.updated > STALE:
        state = 'no sign of life for a minute: repeat the command to continue'
    print(f'{status}; {state}')
    return 0


def _sessions_of(args: argparse.Namespace) -> list[Session]:
    """The bags of the folder as sessions, by the manifest or by their gaps in time."""
    from saddlering_ros.campaign import sessions
    from saddlering_ros.campaign.store import CampaignError

    with Bar() as bar:
        bags = sessions.find_bags(
            args.folder, lambda count: bar.show('find', 0.0, counted(count, 'bag')))
    if not bags:
        raise CampaignError(f'{args.folder}: has no bags: give the folder of the bags')
    if args.manifest is not None:
        return sessions.read_manifest(args.manifest, bags)
    grouped = sessions.group_sessions(bags, args.gap * 3600.0, args.hold_out)
    if args.hold_out is not None and not any(one.of_role(sessions.HOLD_OUT) for one in grouped):
        raise CampaignError(f'--hold-out {args.hold_out:g}: no session has a test at this '
                            'elevation beside one at another: correct it, or leave it out')
    return grouped


def _show_sessions(grouped: Sequence[Session]) -> None:
    show_table(['session', 'ring', 'rig', 'date', 'tests', 'note'], [
        (one.name, one.ring, one.bench, one.date, one.tests, one.problem or '; '.join(
            f'{bag.path.name}: {bag.note}' for bag in one.bags if bag.note))
        for one in grouped[:MAX_SHOWN]], texts=6)
    if len(grouped) > MAX_SHOWN:
        print(f'... and {len(grouped) - MAX_SHOWN} more: see manifest.csv')
    print(', '.join([
        f'{counted(len(grouped), "session")} of '
        f'{counted(len({one.ring for one in grouped}), "ring")}',
        counted(sum(len(one.bags) for one in grouped), 'bag')]))


def _show_results(fleet: Fleet, summary: Status, store: Store) -> None:
    for drift in fleet.rigs:
        print(f'rig {drift.owner}: its rings drift together: {drift.next_test}')
    for ring in [ring for ring in fleet.rings if ring.reasons][:MAX_SHOWN]:
        print(f'ring {ring.ring}: {"; ".join(ring.reasons)}')
    words = (f'{summary.done} of {counted(summary.total, "session")} with a result, '
             f'{summary.computed} of them new; written: {store.folder / "report.html"}')
    if summary.failed:
        words += f'; {summary.failed} failed: verdicts.parquet has the reasons'
    if summary.altered:
        words += (f'; {len(summary.altered)} result files were damaged or altered and are '
                  f'computed again, first {summary.altered[0]}')
    print(words)
