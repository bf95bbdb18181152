"""All steps of the demo, in the order in which a test engineer would do them by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import json
from pathlib import Path
import sys
import tempfile
import time
from types import TracebackType
from typing import Any

import numpy as np

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_ros.bags import read_run
from saddlering_ros.demo.live import DemoError, LiveRig, placed, ReplayRecording
from saddlering_ros.diagnosis.ring_wording import headline, RunEntry, VerdictDocument
from saddlering_ros.files import temporary_folder
from saddlering_ros.quantities import percent
from saddlering_ros.record import Record
from saddlering_ros.record.batches import join
from saddlering_ros.record.simulation import simulated_stretches
from saddlering_ros.report.curves import Array, curves_of_run, RunCurves
from saddlering_ros.rig import CHANNELS, default_rig, ParameterSet, Rig, write_parameters
from saddlering_ros.ros.messages import parameters_from_message

STEPS = 8

SCRATCH_PREFIX = 'saddlering_demo_run_'
"""Of the folder for intermediate files; one of a killed demo is removed by the next."""


@dataclass(frozen=True)
class Replayed:
    """One replay: its bag, the parameters of the simulator, messages received and lost."""

    bag: str
    parameters: str
    messages: int
    lost: int
    seconds: float
    speed: float


@dataclass(frozen=True)
class DemoOutcome:
    """Everything the demo found."""

    plan: Plan
    rig: Rig
    identified: ParameterSet
    identification: dict[str, Any]
    extended: ParameterSet
    verdict: VerdictDocument
    curves: tuple[RunCurves, ...]
    replays: tuple[Replayed, ...]
    seconds: float

    @property
    def verified(self) -> list[RunCurves]:
        """The runs held out."""
        return [run for run in self.curves if run.held_out]

    @property
    def gain(self) -> float:
        """Share by which the misfit of the runs held out fell when they were replayed again."""
        before = overall_misfit(self.verified, extended=False)
        return 1.0 - overall_misfit(self.verified, extended=True) / max(before, 1e-300)


def tell(plan: Plan, console: Console) -> DemoOutcome:
    """Run the demo on live nodes; everything it started is gone when this returns or raises."""
    with temporary_folder(Path(tempfile.gettempdir()), SCRATCH_PREFIX) as scratch:
        return _Story(plan, console, scratch).run()


class _Story:
    """The steps, and the results that each passes to the next."""

    def __init__(self, plan: Plan, console: Console, scratch: Path) -> None:
        self.plan, self.console, self.scratch = plan, console, scratch
        self.rig = default_rig()
        self.replays: list[Replayed] = []
        self.first, self.second = (elevation_of(runs[0]) for runs in (plan.identify, plan.verify))

    def run(self) -> DemoOutcome:
        """All steps."""
        self.console.step('starting eight nodes, each in its own process')
        with LiveRig(self.plan.folder, self.scratch, self.first) as live:
            live.wait_for_nodes()
            self.console.say(f'      {live.nodes} nodes are up in ROS domain {live.domain}: '
                             f'ROS_DOMAIN_ID={live.domain} ros2 topic list shows them')
            return self._with(live)

    def _with(self, live: LiveRig) -> DemoOutcome:
        self.console.step(f'replaying the {self.first:g}° tests in lockstep, simulated with '
                          'true-to-scale parameters')
        first = {run.path.name: self._replay(live, run, 'true to scale')
                 for run in self.plan.identify}
        self.console.step(f'/identify_ring: contact parameters from {self.first:g}°')
        identified, identification = self._identify(live)
        before_file = self.scratch / 'identified.yaml'
        write_parameters(before_file, identified)
        live.wait_for_parameters(identified.contact.K1, 0)
        self.console.say('      the simulator follows /ring/parameters')
        self.console.step(f'replaying the {self.second:g}° tests, simulated with them')
        live.restart_simulator(self.second, before_file)
        before = {run.path.name: self._replay(live, run, 'identified')
                  for run in self.plan.verify}
        self._compare(before)
        self.console.step(f'/diagnose_ring: the missing cause ({self.second:g}° held out)')
        extended, verdict = self._diagnose(live, before_file)
        self.console.say(f'      {headline(verdict)}')
        live.wait_for_parameters(extended.contact.K1, len(extended.effects))
        self.console.step(f'replaying the {self.second:g}° tests again, with the extended model')
        after = {run.path.name: self._replay(live, run, 'extended') for run in self.plan.verify}
        self.console.step('ending the nodes, comparing')
        curves = [self._offline_curves(run, first, identified, extended, verdict)
                  for run in self.plan.identify]
        curves += [self._live_curves(run, before, after, verdict) for run in self.plan.verify]
        return DemoOutcome(
            plan=self.plan, rig=self.rig, identified=identified, identification=identification,
            extended=extended, verdict=verdict, curves=tuple(curves),
            replays=tuple(self.replays), seconds=self.console.seconds)

    # --- steps ---

    def _replay(self, live: LiveRig, run: Record, words: str) -> ReplayRecording:
        name, began = run.path.name, time.monotonic()
        interval = float(np.median(np.diff(run.time)))
        recording = live.replay(run.path, interval, lambda share, speed: self.console.show(
            share, f'{name}  {speed}'))
        seconds = time.monotonic() - began
        speed = float(run.time[-1]) / seconds
        lost = recording.lost(run)
        self.replays.append(Replayed(name, words, recording.messages, lost, seconds, speed))
        self.console.say(f'      {name}: {recording.messages} messages, {speed:.2g} times real '
                         f'time{f", {lost} more messages not received" if lost else ""}')
        return recording

    def _identify(self, live: LiveRig) -> tuple[ParameterSet, dict[str, Any]]:
        def show(feedback: IdentifyRing.Feedback) -> None:
            share = feedback.iteration / max(feedback.iterations, 1)
            self.console.stage(feedback.stage, share, f'best {feedback.best_objective:.4g}')

        result = live.identify(_names(self.plan.identify), _names(self.plan.verify), show)
        report = json.loads(result.report_json)
        report['validation'] = json.loads(result.validation_json)
        self.console.say(f'      {report["evaluations"]} simulations in {report["elapsed"]:.1f} s')
        return self._sourced(result.parameters, 'identify'), report

    def _diagnose(self, live: LiveRig, file: Path) -> tuple[ParameterSet, VerdictDocument]:
        def show(feedback: DiagnoseRing.Feedback) -> None:
            self.console.stage(feedback.stage, feedback.progress, '')

        result = live.diagnose(_names(self.plan.identify), _names(self.plan.verify), file, show)
        return self._sourced(result.parameters, 'diagnose'), json.loads(result.verdict_json)

    def _sourced(self, message: Any, method: str) -> ParameterSet:
        parameters = parameters_from_message(message)
        source = replace(parameters.source, method=method,
                         bags=tuple(_names(self.plan.identify)))
        return replace(parameters, source=source)

    # --- comparisons ---

    def _compare(self, recordings: dict[str, ReplayRecording]) -> None:
        for run in self.plan.verify:
            measured, simulated = recordings[run.path.name].at(run.stamps)
            seen = curves_of_replay(run, measured, simulated, simulated, None, held_out=True)
            parts = [f'{name} {percent(misfit_of(seen, name, extended=False))}'
                     for name in JUDGED]
            self.console.say(f'      {run.path.name} is missed by {", ".join(parts)} of range')

    def _live_curves(
        self, run: Record, before: dict[str, ReplayRecording], after: dict[str, ReplayRecording],
        verdict: VerdictDocument,
    ) -> RunCurves:
        name = run.path.name
        measured, first = before[name].at(run.stamps)
        _, last = after[name].at(run.stamps)
        return curves_of_replay(run, measured, first, last, _entry(verdict, run), held_out=True)

    def _offline_curves(
        self, run: Record, first: dict[str, ReplayRecording], identified: ParameterSet,
        extended: ParameterSet, verdict: VerdictDocument,
    ) -> RunCurves:
        """Measured live, simulated here with both parameter sets: the same code as the node's."""
        measured, _ = first[run.path.name].at(run.stamps)
        before, after = (simulated_offline(run, self.rig, item) for item in (identified, extended))
        return curves_of_replay(run, measured, before, after, _entry(verdict, run), held_out=False)


def _names(runs: tuple[Record, ...]) -> list[str]:
    return [run.path.name for run in runs]


def _entry(verdict: VerdictDocument, run: Record) -> RunEntry | None:
    """The run's part of the verdict."""
    found = [item for item in verdict['runs'] if Path(item['bag']).name == run.path.name]
    return found[0] if found else None


class Console:
    """The steps of the demo, printed one after another."""

    def __init__(self, steps: int) -> None:
        self._steps, self._step = steps, 0
        self._began = time.monotonic()
        self._progress: Any = None
        self._task: Any = None
        self._said = ''

    def __enter__(self) -> Console:
        if sys.stderr.isatty():
            from rich.console import Console as RichConsole
            from rich.progress import Progress

            self._progress = Progress(console=RichConsole(stderr=True), transient=True)
            self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        if self._progress is not None:
            self._progress.stop()

    @property
    def seconds(self) -> float:
        """Since the start."""
        return time.monotonic() - self._began

    def step(self, words: str) -> None:
        """Go on to the next step."""
        self._step += 1
        self.say(f'[{self._step}/{self._steps}] {words}')

    def say(self, words: str) -> None:
        """One line on standard output."""
        self._said = ''
        if self._task is not None:
            self._progress.remove_task(self._task)
            self._progress.refresh()
            self._task = None
        if self._progress is not None and sys.stdout.isatty():
            self._progress.console.file.flush()
        print(f'{self.seconds:5.1f} s  {words}', flush=True)

    def show(self, share: float, words: str) -> None:
        """How far the present step is; on a terminal only."""
        if self._progress is None:
            return
        if self._task is None:
            self._task = self._progress.add_task('', total=1.0)
        self._progress.update(self._task, completed=share, description=words)

    def stage(self, stage: str, share: float, words: str) -> None:
        """How far a stage is: a bar on a terminal; in a pipe one line when it begins."""
        if self._progress is not None:
            self.show(share, f'{stage}  {words}')
        elif stage != self._said:
            self._said = stage
            print(f'{self.seconds:5.1f} s        {stage}', flush=True)


IDENTIFY_AT = 50.0
"""Elevation [deg] of the published identification; the others verify."""


@dataclass(frozen=True)
class Plan:
    """Runs to identify and to verify with, each list at one elevation [deg], static ones first."""

    folder: Path
    identify: tuple[Record, ...]
    verify: tuple[Record, ...]

    @property
    def runs(self) -> tuple[Record, ...]:
        """All of them."""
        return self.identify + self.verify


def plan(folder: Path) -> Plan:
    """Read the bags of `folder` and assign them to the steps; DemoError if one is missing."""
    if not folder.is_dir():
        raise DemoError(f'{folder}: no such folder: give one that holds bags (--bags)')
    bags = sorted(path for path in folder.iterdir()
                  if (path / 'metadata.yaml').is_file() or path.suffix == '.mcap')
    if not bags:
        raise DemoError(f'{folder}: holds no bags: give a folder that does (--bags)')
    by_elevation: dict[float, list[Record]] = {}
    for bag in bags:
        run = read_run(bag)
        by_elevation.setdefault(elevation_of(run), []).append(run)
    first = IDENTIFY_AT if IDENTIFY_AT in by_elevation else min(by_elevation)
    identify = by_elevation.pop(first)
    missing = {'static', 'dynamic'} - {run.test for run in identify}
    if missing:
        raise DemoError(f'{folder}: no {missing.pop()} bag at {first:g} deg: add one')
    if not by_elevation:
        raise DemoError(f'{folder}: every bag is at {first:g} deg: add some at another elevation '
                        'to verify on')
    return Plan(folder.resolve(), _sorted(identify), _sorted(by_elevation[max(by_elevation)]))


def elevation_of(run: Record) -> float:
    """Elevation [deg] as a person writes it."""
    return round(float(np.degrees(run.elevation)), 2)


def _sorted(runs: list[Record]) -> tuple[Record, ...]:
    return tuple(sorted(runs, key=lambda run: (run.test != 'static', -float(run.time[-1]))))


JUDGED = CHANNELS[:3]


def curves_of_replay(
    run: Record, measured: Array, before: Array, after: Array, verdict: RunEntry | None,
    *, held_out: bool,
) -> RunCurves:
    """A run's curves from its channels (4, samples) at the load's stamps."""
    floors = {} if verdict is None else {
        name: item['noise_floor'] for name, item in verdict['channels'].items()}
    return curves_of_run(run, measured, before, after, floors, held_out=held_out)


def simulated_offline(run: Record, rig: Rig, parameters: ParameterSet) -> Array:
    """Simulated channels (4, samples) of a run, as published live; NaN before the zero."""
    stretches, _ = simulated_stretches(rig, run, parameters, [], lambda share: None)
    return placed(join(list(stretches)), run.stamps)


def misfit_of(run: RunCurves, channel: str, *, extended: bool) -> float:
    """Rms misfit as a share of the channel's measured range."""
    values = run.measured[CHANNELS.index(channel)]
    residual = run.residual(channel, extended=extended)
    return float(np.sqrt(np.mean(residual**2)) / max(float(np.ptp(values)), 1e-12))


def overall_misfit(runs: Sequence[RunCurves], *, extended: bool) -> float:
    """Root mean square of the misfits over runs and channels."""
    parts = [misfit_of(run, name, extended=extended) ** 2 for run in runs for name in JUDGED]
    return float(np.sqrt(np.mean(parts)))


def misfit_table(runs: Sequence[RunCurves]) -> list[RunEntry]:
    """The misfits as a verdict's `runs` have them."""
    return [
        {'bag': run.name, 'test': run.test, 'elevation_deg': run.elevation_deg,
         'held_out': run.held_out, 'channels': {
             name: {'nrmse_before': misfit_of(run, name, extended=False),
                    'nrmse_after': misfit_of(run, name, extended=True),
                    'noise_floor': run.noise[name] / max(float(np.ptp(run.measured[row])), 1e-12)}
             for row, name in enumerate(CHANNELS)}}
        for run in runs
    ]
