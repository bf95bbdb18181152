"""Faults of nodes, subscribers and messages beside a driver."""

from __future__ import annotations

from collections.abc import Callable
import random
import signal
import subprocess
import sys
import time

import numpy as np

from saddlering_ros.bags.wire import encode_samples
from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.record.batches import Samples
from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.ros.raw_topics import RawPublisher, stream_qos

from .driver import CYCLE, RATE, start_driver
from .stage import Outcome, OUTPUTS, PARAMETERS, Stage, stage, TOLERANCE, wrong_numbers

IN_STEP = 1.0
DRIVEN = ('kills', 'stops', 'stalled', 'rubbish', 'ten_times')


def kill_and_restart(one: Stage, name: str) -> float:
    """Kill a node at a random moment, start it again; how long until it is in step or says why."""
    one.put_in += 1
    one.pause()
    killed = time.monotonic()
    one.kill(name)
    time.sleep(0.3)
    others = [other for other in OUTPUTS if other != name and other != 'ring_residual']
    one.in_flow(*others, seconds=6.0)  # at most the rest of a cycle, should it wait for preload
    one.others_run(name)
    one.listener.alive.pop(name, None)
    one.group.start(name, PARAMETERS.get(name))
    one.expect(lambda: one.listener.alive.get(name, 0.0) > killed, 30.0, f'{name} lives')
    alive = one.listener.alive.get(name, time.monotonic())
    topic = OUTPUTS[name]

    def accounted() -> bool:
        return one.listener.last(topic) > alive or any(
            at > alive - 1.0 and said.startswith(name) and (level > 0 or 'waiting' in words)
            for at, said, level, words in list(one.listener.said))

    one.expect(accounted, IN_STEP + 0.3, f'{name} in step, or says what it waits for')
    took = time.monotonic() - alive
    if name != 'ring_residual':
        one.in_flow(name, seconds=2.5 * CYCLE)
    one.zero_together()
    one.numbers()
    return took


def stall_a_subscriber(one: Stage) -> None:
    """A process that subscribes to everything reliably, and then stands still."""
    one.put_in += 1
    code = ('import rclpy, sys, time\n'
            'from saddlering_interfaces.msg import RingDisplacement\n'
            'from geometry_msgs.msg import WrenchStamped\n'
            'from saddlering_ros.ros.raw_topics import stream_qos\n'
            'rclpy.init(); node = rclpy.create_node("stalled")\n'
            'for topic, kind in (("/ring/displacement", RingDisplacement), '
            '("/ring/residual", RingDisplacement), ("/rig/hydraulic_load", WrenchStamped)):\n'
            '    node.create_subscription(kind, topic, lambda m: None, stream_qos())\n'
            'print("ready", flush=True)\n'
            'end = time.monotonic() + 2\n'
            'while time.monotonic() < end: rclpy.spin_once(node, timeout_sec=0.1)\n'
            'print("spun", flush=True); time.sleep(600)\n')
    stalled = subprocess.Popen([sys.executable, '-c', code], env=one.group.environment,
                               stdout=subprocess.PIPE, text=True)
    assert stalled.stdout is not None
    try:
        stalled.stdout.readline()
        stalled.stdout.readline()
        stalled.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        time.sleep(8.0)
        count = one.listener.since('/ring/displacement', began)
        if count < 0.9 * 8.0 * RATE:
            one.faults.append(f'beside a stalled subscriber {count} of {8 * RATE:.0f} came')
        one.others_run()
        one.numbers()
    finally:
        stalled.kill()
        stalled.wait()


def stop_a_node(one: Stage, name: str) -> None:
    """A node stands still for three seconds, as on a machine that has something else to do."""
    one.put_in += 1
    one.pause()
    process = one.group.processes[name].process
    process.send_signal(signal.SIGSTOP)
    time.sleep(3.0)
    one.others_run()
    process.send_signal(signal.SIGCONT)
    one.in_flow(seconds=2.5 * CYCLE)
    one.numbers()


def send_rubbish(one: Stage) -> None:
    """NaN, infinite, absurd readings, stamps of far past and future, from a second source."""
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import Range
    one.put_in += 1
    with one.listener.lock:
        node = one.listener.node
        load = RawPublisher(node, LOAD_TOPIC, WrenchStamped, stream_qos())
        probe = RawPublisher(node, PROBE_TOPICS[0], Range, stream_qos())
    one.expect(lambda: load.subscriptions() >= 2, 5.0, 'the second source is matched')
    now = time.time_ns()
    far = [0, 1, now - 10 ** 12, now + 10 ** 12, 2 ** 31 * 10 ** 9 - 1]
    stamps = np.array([now, now + 1, *far], np.int64)
    for value in (np.nan, np.inf, -np.inf, 1e38, -1e38, 0.0):
        samples = Samples(stamps, np.full(len(stamps), value), np.nan, np.inf)
        with np.errstate(all='ignore'):
            load.send(encode_samples(samples, LOAD, 'x' * 1000), now)
            probe.send(encode_samples(samples, PROBES[0], ''), now)
    load.send([b'', b'\0\1\0\0', b'\0\1\0\0' + b'\xff' * 40, bytes(100_000)], now)
    time.sleep(2.0)
    with one.listener.lock:
        load.close()
        probe.close()
    one.others_run()
    one.in_flow(seconds=3.0 * CYCLE)
    one.numbers()


def ten_times(one: Stage) -> None:
    """Ten times the nominal rate for a while: what is lost must be said; then all is as before."""
    one.put_in += 1
    one.driver.kill()
    one.driver.wait()
    time.sleep(1.0)
    one.numbers()
    one.driver, one.start = start_driver(one.group, 10.0)
    began = time.monotonic()
    one.in_flow('ring_displacement', seconds=30.0)
    time.sleep(max(0.0, began + 10.0 - time.monotonic()))
    one.others_run()
    one.driver.kill()
    one.driver.wait()
    time.sleep(3.0)
    # Between two samples of one cycle the driver repeats the former ten times.
    one.faults += wrong_numbers(one.listener, one.truth, [one.start], 5 * TOLERANCE)
    one.listener.forget()
    one.driver, one.start = start_driver(one.group)
    one.in_flow(seconds=5.0 * CYCLE)
    one.numbers()


def beside_a_driver(chance: random.Random, rounds: int, only: set[str]) -> Outcome:
    """All faults that need a driver and the ring nodes, on one stage."""
    out = Outcome()
    took = []

    def kills(one: Stage) -> None:
        for name in OUTPUTS:
            took.append(kill_and_restart(one, name))

    def stops(one: Stage) -> None:
        stop_a_node(one, chance.choice(list(OUTPUTS)))

    scenarios: dict[str, Callable[[Stage], None]] = {
        'kills': kills, 'stops': stops, 'stalled': stall_a_subscriber, 'rubbish': send_rubbish,
        'ten_times': ten_times}
    with stage(chance) as one:
        for _ in range(rounds):
            for name, scenario in scenarios.items():
                if only and name not in only:
                    continue
                before = len(one.faults)
                scenario(one)
                one.faults[before:] = [f'{name}: {fault}' for fault in one.faults[before:]]
                verdict = 'ok' if len(one.faults) == before else 'BROKEN'
                print('\n    '.join([f'  {name:12} {verdict}', *one.faults[before:]]), flush=True)
        out.put_in, out.faults = one.put_in, one.faults
    if took:
        out.figures['slowest in step or said so after [s]'] = max(took)
    return out
