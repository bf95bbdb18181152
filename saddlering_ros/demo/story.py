"""All steps of the demo, in the order in which a test engineer would do them by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
import json
from pathlib import Path
import tempfile
import time
from typing import Any

import numpy as np

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_ros.demo import figures
from saddlering_ros.demo.console import Console
from saddlering_ros.demo.live import LiveRig
from saddlering_ros.demo.plan import elevation_of, Plan
from saddlering_ros.demo.recorder import ReplayRecording
from saddlering_ros.diagnosis.wording import headline, RunEntry, VerdictDocument
from saddlering_ros.files import temporary_folder
from saddlering_ros.quantities import percent
from saddlering_ros.record import Record
from saddlering_ros.report.curves import RunCurves
from saddlering_ros.rig import default_rig, ParameterSet, Rig, write_parameters
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
        before = figures.overall(self.verified, extended=False)
        return 1.0 - figures.overall(self.verified, extended=True) / max(before, 1e-300)


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
                         f'time{f", {lost} lost" if lost else ""}')
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
            seen = figures.curves(run, measured, simulated, simulated, None, held_out=True)
            parts = [f'{name} {percent(figures.misfit(seen, name, extended=False))}'
                     for name in figures.JUDGED]
            self.console.say(f'      {run.path.name} is missed by {", ".join(parts)} of range')

    def _live_curves(
        self, run: Record, before: dict[str, ReplayRecording], after: dict[str, ReplayRecording],
        verdict: VerdictDocument,
    ) -> RunCurves:
        name = run.path.name
        measured, first = before[name].at(run.stamps)
        _, last = after[name].at(run.stamps)
        return figures.curves(run, measured, first, last, _entry(verdict, run), held_out=True)

    def _offline_curves(
        self, run: Record, first: dict[str, ReplayRecording], identified: ParameterSet,
        extended: ParameterSet, verdict: VerdictDocument,
    ) -> RunCurves:
        """Measured live, simulated here with both parameter sets: the same code as the node's."""
        measured, _ = first[run.path.name].at(run.stamps)
        before, after = (figures.offline(run, self.rig, item) for item in (identified, extended))
        return figures.curves(run, measured, before, after, _entry(verdict, run), held_out=False)


def _names(runs: tuple[Record, ...]) -> list[str]:
    return [run.path.name for run in runs]


def _entry(verdict: VerdictDocument, run: Record) -> RunEntry | None:
    """The run's part of the verdict."""
    found = [item for item in verdict['runs'] if Path(item['bag']).name == run.path.name]
    return found[0] if found else None
