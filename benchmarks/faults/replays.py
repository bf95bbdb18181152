"""Faults in a replay: lost nodes, two replays at once, a whole day in lockstep."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
import random
import signal
import tempfile
import time

import numpy as np

from saddlering_ros.ros.launcher import RING_NODES, start_nodes

from .driver import CYCLE, cycle_bag, Truth
from .stage import Listener, Outcome, Stage, wrong_numbers


def lose_replay_nodes(chance: random.Random) -> Outcome:
    """Each node of a replay is killed and started again; the replay goes on, or begins anew."""
    out = Outcome()
    truth = Truth.make()
    names = ('hydraulic_load', 'eddy_current', 'replay_clock', 'ring_displacement',
             'ring_simulator')
    with tempfile.TemporaryDirectory() as folder:
        bag, start = cycle_bag(Path(folder), truth, 40)
        replay = {'replay_clock': {'timeout': 1.0}}
        with start_nodes(bag, rate=2.0, exit_at_end=False, parameters=replay) as group:
            listener = Listener(group.domain_id)
            one = Stage(group, listener, truth, None, start, chance)  # type: ignore[arg-type]
            one.in_flow(seconds=60.0)
            given = {'ring_displacement': None, 'replay_clock': {
                'bag': str(bag), 'lockstep': True, 'rate': 2.0, 'timeout': 1.0,
                'participants': ['hydraulic_load', 'eddy_current', *RING_NODES]}}
            for name in names:
                out.put_in += 1
                one.pause(0.2, 2.0)
                one.kill(name)
                time.sleep(2.0)
                one.others_run(name)
                group.start(name, given.get(name, {'bag': str(bag)}))
                one.in_flow(seconds=30.0)
            out.put_in += 1  # a paused clock
            if not listener.call('/replay_clock/pause'):
                one.faults.append('the replay cannot be paused')
            time.sleep(0.5)
            standing = time.monotonic()
            time.sleep(2.0)
            if listener.since('/ring/residual', standing):
                one.faults.append('samples came from a paused replay')
            if not listener.call('/replay_clock/play'):
                one.faults.append('the replay does not go on')
            one.in_flow(seconds=10.0)
            out.put_in += 1  # a clock that hangs
            clock = group.processes['replay_clock'].process
            clock.send_signal(signal.SIGSTOP)
            since = time.monotonic()
            time.sleep(4.5)
            if not any('silent' in words for words in listener.warned(since, time.monotonic())):
                one.faults.append('nobody says that /clock is silent')
            clock.send_signal(signal.SIGCONT)
            one.in_flow(seconds=10.0)
            time.sleep(1.2)
            one.others_run()
            out.faults += one.faults + wrong_numbers(listener, truth, [start])
            listener.close()
    return out


def two_replays(chance: random.Random) -> Outcome:
    """Two replays of bags recorded at different times, on one domain: mixed up, and said so."""
    out = Outcome(put_in=1)
    truth = Truth.make()
    with tempfile.TemporaryDirectory() as name:
        bag, start = cycle_bag(Path(name), truth, 12)
        with start_nodes(bag, lockstep=False, rate=1.0, exit_at_end=False) as group:
            listener = Listener(group.domain_id)
            one = Stage(group, listener, truth, None, start, chance)  # type: ignore[arg-type]
            one.in_flow(seconds=60.0)
            one.pause(0.5, 2.0)
            with start_nodes(bag, nodes=(), lockstep=False, rate=1.0, exit_at_end=False,
                             domain_id=group.domain_id) as second:
                began = time.monotonic()
                one.expect(lambda: any('publishers on' in words for words in listener.warned(
                    began, time.monotonic())), 30.0, 'someone says that there are two sources')
                time.sleep(6.0)
                for process in second.processes.values():
                    if not process.running:
                        one.faults.append(f'{process.name} of the second replay ended')
            one.others_run()
            one.in_flow(seconds=4.0 * CYCLE)
            time.sleep(1.2)
            out.faults += one.faults + wrong_numbers(listener, truth, [start])
            listener.close()
    return out


def resident(pid: int) -> int:
    """Memory of a process [bytes]."""
    with contextlib.suppress(OSError, IndexError):
        return int(Path(f'/proc/{pid}/statm').read_text().split()[1]) * os.sysconf('SC_PAGE_SIZE')
    return 0


def a_day(hours: float) -> Outcome:
    """`hours` of recorded time in lockstep as fast as the nodes follow: memory stays flat."""
    out = Outcome(put_in=1)
    rate, cycle = 10.0, 40.0
    truth = Truth.make(rate, cycle)
    cycles = round(hours * 3600.0 / cycle)
    with tempfile.TemporaryDirectory() as name:
        bag, start = cycle_bag(Path(name), truth, cycles, rate)
        parameters: dict[str, dict[str, object]] = {
            'replay_clock': {'window': 1.0},
            'ring_simulator': {'max_step': 0.05, 'bag': str(bag)}}
        with start_nodes(bag, parameters=parameters) as group:
            listener = Listener(group.domain_id)
            sizes: dict[str, list[int]] = {node: [] for node in group.processes}
            began = time.monotonic()
            newest = 0
            while group.processes['replay_clock'].running:
                time.sleep(1.0)
                with listener.lock:
                    for items in listener.heard.values():
                        if items:
                            newest = max(newest, int(items[-1].batch.stamps[-1]))
                        items.clear()
                    listener.said.clear()
                for node, process in group.processes.items():
                    if process.running:
                        sizes[node].append(resident(process.process.pid))
            listener.close()
            took = time.monotonic() - began
            status = group.processes['replay_clock'].process.returncode
    if status:
        out.faults.append(f'the replay ended with status {status}')
    seen = (newest - start) / 3.6e12
    if seen < 0.999 * hours - 0.01:
        out.faults.append(f'{seen:.2f} of {hours:g} h came through')
    for node, series in sizes.items():
        settled = series[len(series) // 5:]
        growth = (np.mean(settled[-5:]) - np.mean(settled[:5])) / 1e6 if len(settled) > 9 else 0.0
        out.figures[f'growth of {node} [MB]'] = float(growth)
        if growth > 8.0:
            out.faults.append(f'{node} grew by {growth:.1f} MB')
    out.figures['hours'], out.figures['times real time'] = hours, hours * 3600.0 / took
    return out
