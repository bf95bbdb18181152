"""`saddlering demo`: all steps, from recorded bags to a named cause that live nodes confirm."""

from __future__ import annotations

import argparse
import contextlib
from dataclasses import dataclass
import json
import math
import os
from pathlib import Path
import sys
import tempfile
import time
from typing import Any, TYPE_CHECKING

from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.cli._arguments import Bar, Command, option, tell_json
from saddlering_ros.errors import BagError, counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from saddlering_ros import Bag, DiagnosisResult, IdentificationResult
    from saddlering_ros.report.figures import Array, RunCurves

IDENTIFY_AT = 50.0
"""Elevation [deg] of the published identification; the others verify."""

COMMANDS = (Command(
    'demo', 'run all steps with live nodes, and write a report',
    'Identify the parameters from bags, replay another test through live nodes, diagnose what the '
    'simulation lacks, and verify the result by another replay. The folder then holds a report '
    'that opens offline.', (
        option('--out', 'folder for report, pictures, numbers, parameters (default: out)',
               type=arguments.folder_filled, default=Path('out'), metavar='DIR'),
        option('--bags', 'folder of bags at two elevations (default: the shipped ones)',
               type=arguments.bags_below, metavar='DIR'),
        arguments.json_option('write all numbers as JSON; - for stdout (the steps then go to '
                              'stderr)')),
    (('saddlering demo --out out', 'all steps; then open out/report.html'),)),)


@dataclass(frozen=True)
class LiveReplay:
    """One replay through live nodes: what simulated, messages received and lost, its channels.

    measured, simulated (4, N) [m, m, rad, m]: at the stamps of the bag's loads.
    """

    bag: Bag
    parameters: str
    messages: int
    lost: int
    seconds: float
    measured: Array
    simulated: Array


@dataclass(frozen=True)
class Story:
    """What the demonstration found.

    curves: the held-out runs as the nodes published them; seconds: what the demonstration took.
    """

    identified: IdentificationResult
    diagnosed: DiagnosisResult
    replays: Sequence[LiveReplay]
    curves: Sequence[RunCurves]
    seconds: float

    @property
    def runs(self) -> list[dict[str, Any]]:
        """Rms misfits of the curves as shares of each channel's range, as a verdict has them."""
        from saddlering_ros.rig import CHANNELS

        runs = []
        for run in self.curves:
            spans = (run.measured.max(axis=1) - run.measured.min(axis=1)).clip(1e-12)
            before, after = (((run.measured - one)**2).mean(axis=1)**0.5 / spans
                             for one in (run.before, run.after))
            runs.append({
                'bag': run.name, 'test': run.test, 'elevation_deg': run.elevation_deg,
                'held_out': run.held_out, 'channels': {
                    name: {'nrmse_before': float(before[row]), 'nrmse_after': float(after[row]),
                           'noise_floor': float(run.noise[name] / spans[row])}
                    for row, name in enumerate(CHANNELS)}})
        return runs

    @property
    def misfit(self) -> tuple[float, float]:
        """Live misfit over runs and channels before and after the diagnosis, a share of range."""
        from saddlering_ros.rig import MOTION

        channels = [run['channels'][name] for run in self.runs for name in MOTION]
        before, after = (math.sqrt(sum(channel[key]**2 for channel in channels) / len(channels))
                         for key in ('nrmse_before', 'nrmse_after'))
        return before, after

    @property
    def gain(self) -> float:
        """Share by which the live misfit of the held-out runs falls."""
        before, after = self.misfit
        return 1.0 - after / max(before, 1e-300)


def run(args: argparse.Namespace) -> int:
    """Run the demo, write its folder, print a summary."""
    from saddlering_ros.files import share_directory, temporary_folder
    from saddlering_ros.quantities import percent
    from saddlering_ros.rig.description import RIG_VARIABLE

    os.environ.pop(RIG_VARIABLE, None)  # the demonstration is of the shipped rig
    fitted, held_out = planned(args.bags or share_directory() / 'bags')
    with (contextlib.redirect_stdout(sys.stderr if args.json == '-' else sys.stdout),
          temporary_folder(Path(tempfile.gettempdir()), 'saddlering_demo_run_') as scratch):
        story = tell(fitted, held_out, scratch)
        files = write_all(story, args.out, args.command_line)
    if tell_json(args, numbers_of(story)):
        return 0
    before, after = map(percent, story.misfit)
    print(f'\n{story.diagnosed.summary()}\n\nMisfit measured live on held-out runs: {before} -> '
          f'{after}, reduced by {percent(story.gain)}.\n{story.seconds:.0f} s. Open '
          f'{args.out / "report.html"} ({len(files)} files in {args.out}/)')
    return 0


def planned(folder: Path) -> tuple[list[Bag], list[Bag]]:
    """The bags of `folder` to fit and to verify with, static ones first."""
    from saddlering_ros import read_bag

    if not folder.is_dir():
        raise BagError(f'{folder}: no such folder: give one that holds bags (--bags)')
    by_elevation: dict[float, list[Bag]] = {}
    for path in sorted(folder.iterdir()):
        if (path / 'metadata.yaml').is_file() or path.suffix == '.mcap':
            bag = read_bag(path.resolve())
            by_elevation.setdefault(bag.elevation_deg, []).append(bag)
    if not by_elevation:
        raise BagError(f'{folder}: holds no bags: give a folder that does (--bags)')
    for bags in by_elevation.values():
        bags.sort(key=lambda bag: (bag.test != 'static', -float(bag.run.time[-1])))
    first = IDENTIFY_AT if IDENTIFY_AT in by_elevation else min(by_elevation)
    fitted = by_elevation.pop(first)
    missing = {'static', 'dynamic'} - {bag.test for bag in fitted}
    if missing:
        raise BagError(f'{folder}: no {missing.pop()} bag at {first:g} deg: add one')
    if not by_elevation:
        raise BagError(f'{folder}: every bag is at {first:g} deg: add some at another elevation '
                       'to verify on')
    return fitted, by_elevation[max(by_elevation)]


def tell(fitted: list[Bag], held_out: list[Bag], scratch: Path) -> Story:
    """All steps in the order in which a test engineer does them by hand."""
    from saddlering_ros import diagnose, identify
    from saddlering_ros.report.figures import curves_of_run
    from saddlering_ros.ros.launcher import own_domain

    began = time.monotonic()
    first, second = (', '.join(bag.name for bag in bags) for bags in (fitted, held_out))

    def say(words: str) -> None:
        print(f'{time.monotonic() - began:5.1f} s  {words}', flush=True)

    def replayed(parameters: str, domain: int) -> list[LiveReplay]:
        done = []
        for bag in held_out:
            done.append(replay(bag, parameters, scratch, domain))
            say(f'      {bag.name}: {counted(done[-1].messages, "message")}, '
                f'{done[-1].lost or "none"} lost')
        return done

    with own_domain() as domain:
        say(f'[1/5] identify: contact parameters from {first}')
        with Bar() as bar:
            identified = identify(fitted, on_progress=bar.tell)
        identified.save_parameters(scratch / 'identified.yaml')
        say(f'[2/5] replay: {second} to live nodes in ROS domain {domain}, simulated '
            'with these parameters')
        before = replayed('identified', domain)
        say(f'[3/5] diagnose: the cause that the simulation lacks; {second} held out')
        with Bar() as bar:
            diagnosed = diagnose(
                fitted, hold_out=held_out, parameters=identified, on_progress=bar.tell)
        diagnosed.save_parameters(scratch / 'extended.yaml')
        say('[4/5] replay: the same, with the extended model')
        after = replayed('extended', domain)
    say('[5/5] comparing, writing the report')
    noise = {Path(run['bag']).name: {
        name: figures['noise_floor'] for name, figures in run['channels'].items()}
        for run in diagnosed.document['runs']}
    curves = [curves_of_run(
        first.bag.rig, first.bag.run, first.measured, first.simulated, last.simulated,
        noise.get(first.bag.name, {}), held_out=True)
        for first, last in zip(before, after, strict=True)]
    return Story(identified, diagnosed, (*before, *after), curves, time.monotonic() - began)


def replay(bag: Bag, parameters: str, scratch: Path, domain: int) -> LiveReplay:
    """Replay a bag through live nodes by `saddlering replay`, and read what they published."""
    from mcap.reader import make_reader
    import numpy as np

    from saddlering_ros.bags.wire import decode_displacements
    from saddlering_ros.cli.main import build_parser
    from saddlering_ros.cli.replay import play
    from saddlering_ros.record.displacement import a_pair_reads
    from saddlering_ros.record.topics import LOAD_TOPIC
    from saddlering_ros.ros.names import DISPLACEMENTS

    recording, run = scratch / f'{bag.name}_{parameters}', bag.run
    told = play(build_parser()[0].parse_args([
        'replay', str(bag.path), '--params', str(scratch / f'{parameters}.yaml'), '--rate', '0',
        '--domain', str(domain), '--record', str(recording), '--json', '-']))
    topics = [f'/{name}' for name in DISPLACEMENTS]
    counts = told['messages']
    messages = sum(counts[topic] for topic in (*topics, LOAD_TOPIC))
    # Every load has a simulation; where a pair of probes reads, a displacement and a residual.
    due = 2 * (len(run.time) + int(np.count_nonzero(a_pair_reads(run.gaps))))
    kept: dict[str, list[bytes]] = {topic: [] for topic in topics}
    with next(recording.glob('*.mcap')).open('rb') as file:
        for _, channel, message in make_reader(file).iter_messages(topics):
            kept[channel.topic].append(message.data)
    channels = []
    for topic in topics[:2]:
        batch, placed = decode_displacements(kept[topic]), np.full((4, len(run.stamps)), np.nan)
        _, here, there = np.intersect1d(run.stamps, batch.stamps, return_indices=True)
        placed[:, here] = batch.channels[:, there]
        channels.append(placed)
    return LiveReplay(bag, parameters, messages, due - messages, told['seconds'], *channels)


def numbers_of(story: Story) -> dict[str, Any]:
    """All numbers of the demo, for a program."""
    return {
        'bags': {'identify': [bag.name for bag in story.identified.bags],
                 'verify': [run.name for run in story.curves]},
        'identification': story.identified.to_json(), 'verdict': story.diagnosed.to_json(),
        'live': {
            'replays': [{
                'bag': one.bag.name, 'parameters': one.parameters, 'messages': one.messages,
                'lost': one.lost, 'seconds': one.seconds,
                'speed': float(one.bag.run.time[-1]) / one.seconds} for one in story.replays],
            'runs': story.runs, 'gain': story.gain},
        'seconds': story.seconds}


def live_chapter(story: Story) -> str:
    """Chapter: the replays through live nodes, and the misfits that they measured."""
    from saddlering_ros.pages import html
    from saddlering_ros.pages.html import number
    from saddlering_ros.quantities import percent
    from saddlering_ros.report import chapters, figures

    lost = sum(one.lost for one in story.replays)
    before, after = map(percent, story.misfit)
    return html.section(
        'Measured by live nodes',
        html.tiles([
            (before, 'misfit of held-out runs, contact law alone'),
            (after, 'with the extended model, replayed again'),
            (percent(story.gain), 'misfit reduction measured live'),
            (f'{sum(one.messages for one in story.replays):,}'.replace(',', ' '),
             'messages received live, ' + (f'{lost} lost' if lost else 'none lost')),
            (f'{story.seconds:.0f} s', 'for the whole demonstration')]),
        html.picture(figures.comparison(story.curves[:3]), 'live', 'Held-out runs as the nodes '
                     'published them: measured, and simulated before and after the diagnosis. '
                     + chapters.FROM_ZERO),
        html.folded('Replays', html.table(
            ['bag', 'simulated with', *map(number, ('messages received', 'lost', 'seconds'))],
            [[one.bag.name, one.parameters, str(one.messages), str(one.lost or '–'),
              f'{one.seconds:.1f}'] for one in story.replays],
            'In lockstep: the clock waits until every node has processed all messages.')))


def write_all(story: Story, folder: Path, command: str) -> list[Path]:
    """Write everything beside `folder` first, then move it in, at one go; the paths."""
    from saddlering_ros.files import temporary_folder
    from saddlering_ros.pages.html import pictures_of
    from saddlering_ros.report import chapters
    from saddlering_ros.report.reports import write_diagnosis_report
    from saddlering_ros.ros.launcher import signals_held

    folder.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(folder.parent, f'.{folder.name}.') as staging:
        page, _ = write_diagnosis_report(
            story.diagnosed.found, staging / 'report.html', command,
            (live_chapter(story),
             chapters.identified(story.identified.to_json(), 'Before the diagnosis. The missing '
                                 'cause biases these contact parameters.')))
        for name, data in pictures_of(page.read_text(encoding='utf-8')).items():
            (staging / f'{name}.png').write_bytes(data)
        (staging / 'numbers.json').write_text(
            json.dumps(numbers_of(story), indent=2) + '\n', encoding='utf-8')
        story.identified.save_parameters(staging / 'parameters_identified.yaml')
        story.diagnosed.save_parameters(staging / 'parameters_extended.yaml')
        files = sorted(staging.iterdir())
        with signals_held():  # Ctrl-C waits until the files are in place
            folder.mkdir(exist_ok=True)
            for file in files:
                file.replace(folder / file.name)
    return [folder / file.name for file in files]
