"""Faults in a replay and in a goal: lost nodes, two replays at once, a day, killed servers."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
import random
import signal
import subprocess
import tempfile
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_ros.ros.launcher import NodeGroup, RING_NODES, start_nodes

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


def children_of(pid: int) -> list[int]:
    with contextlib.suppress(OSError):
        return [int(word) for task in Path(f'/proc/{pid}/task').iterdir()
                for word in (task / 'children').read_text().split()]
    return []


def lives(pid: int) -> bool:
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


def kill_action_servers(chance: random.Random) -> Outcome:
    """Action servers killed in the middle of a goal: their workers go too, new ones serve."""
    bags = ['dynamic_50_fast']
    out = Outcome()
    with NodeGroup() as group:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=group.domain_id)
        node = rclpy.create_node('client', context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        for server, topic, action, goal in (
                ('ring_identification', '/identify_ring', IdentifyRing,
                 IdentifyRing.Goal(bags=bags, particles=200, iterations=100_000)),
                ('ring_diagnosis', '/diagnose_ring', DiagnoseRing, DiagnoseRing.Goal(bags=bags))):
            client = ActionClient(node, action, topic)
            for _ in range(2):
                out.put_in += 1
                group.start(server)
                process = group.processes[server].process
                out.faults += [f'{server}: {fault}' for fault in kill_in_a_goal(
                    process, client, executor, goal, chance)]
            client.destroy()
        executor.shutdown(timeout_sec=0.0)
        node.destroy_node()
        rclpy.shutdown(context=context)
    return out


def kill_in_a_goal(process: subprocess.Popen[bytes], client: ActionClient,
                   executor: SingleThreadedExecutor, goal: Any, chance: random.Random,
                   ) -> list[str]:
    """Kill -9 of a server while it works on a goal; broken promises."""
    if not client.wait_for_server(60.0):
        return ['the server does not serve']
    faults = []
    running: list[Any] = []
    sent = client.send_goal_async(goal, feedback_callback=running.append)
    asked, end = time.monotonic(), time.monotonic() + 90.0
    while not running and time.monotonic() < end:
        executor.spin_once(0.1)
        # A server killed without a word stays known for a while: what went to it is lost.
        if not sent.done() and time.monotonic() - asked > 5.0:
            asked = time.monotonic()
            sent = client.send_goal_async(goal, feedback_callback=running.append)
    if not running:
        faults.append('no feedback')
    time.sleep(chance.uniform(0.0, 1.0))
    workers = children_of(process.pid)
    process.kill()
    process.wait()
    end = time.monotonic() + 3.0
    while any(map(lives, workers)) and time.monotonic() < end:
        time.sleep(0.05)
    if not workers or any(map(lives, workers)):
        faults.append(f'workers {workers} outlive their server')
    return faults
