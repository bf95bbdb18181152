"""Action servers killed in the middle of a goal."""

from __future__ import annotations

import contextlib
from pathlib import Path
import random
import subprocess
import time
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_ros.ros.launcher import NodeGroup

from .stage import Outcome


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
