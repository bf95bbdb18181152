"""Running nodes, a driver and a listener: the stage on which faults are put in."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from dataclasses import dataclass, field
import random
import subprocess
import time

from saddlering_ros.ros.launcher import NodeGroup, RING_NODES

from .driver import start_driver
from .listener import Listener, OUTPUTS, wrong_numbers
from .truth import CYCLE, ELEVATION, Truth

PARAMETERS = {'ring_simulator': {'elevation_deg': ELEVATION}}


@dataclass
class Outcome:
    """Of one scenario: what was put in, which promises were broken, figures worth showing."""

    put_in: int = 0
    faults: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)


@dataclass
class Stage:
    """The three ring nodes, a driver, and a listener."""

    group: NodeGroup
    listener: Listener
    truth: Truth
    driver: subprocess.Popen[str]
    start: int
    chance: random.Random
    faults: list[str] = field(default_factory=list)
    put_in: int = 0

    def expect(self, condition: Callable[[], bool], seconds: float, what: str) -> float:
        """Wait for a condition; a broken promise if it does not come true. How long it took."""
        began = time.monotonic()
        while not condition():
            if time.monotonic() - began > seconds:
                now = time.monotonic()
                words = sorted(set(self.listener.warned(now - 1.5, now)))
                self.faults.append(f'not within {seconds:g} s: {what} (said: {words})')
                print(f'        {what}: {self.listener.state()}', flush=True)
                break
            time.sleep(0.005)
        return time.monotonic() - began

    def others_run(self, *but: str) -> None:
        """Every process that was left alone still runs."""
        for name, node in self.group.processes.items():
            if name not in but and not node.running:
                self.faults.append(f'{name} ended with status {node.process.returncode}: '
                                   f'{node.said()[-200:]}')

    def in_flow(self, *names: str, seconds: float = 20.0) -> None:
        """The named nodes publish (again)."""
        now = time.monotonic()
        for name in names or tuple(OUTPUTS):
            self.expect(lambda topic=OUTPUTS[name]: self.listener.since(topic, now) > 0, seconds,
                        f'{name} publishes')

    def kill(self, name: str) -> None:
        """Kill -9."""
        self.group.processes[name].process.kill()
        self.group.processes[name].process.wait()

    def numbers(self) -> None:
        """Compare all that was heard with the truth, and forget it."""
        time.sleep(1.2)  # the diagnostics of the last second
        self.faults += wrong_numbers(self.listener, self.truth, [self.start])
        self.listener.forget()

    def zero_together(self) -> None:
        """A node that zeroed anew alone is said not to fit the other; one call puts that right."""
        began = time.monotonic()
        self.expect(lambda: self.listener.since('/ring/residual', began) > 0 or any(
            at > began and name.startswith('ring_residual') and level > 0
            for at, name, level, _ in list(self.listener.said)),
            3.0, 'residual, or a word about why there is none')
        for _ in range(5):
            if self.listener.since('/ring/residual', time.monotonic() - 0.3):
                return
            while not 0.2 < (time.time_ns() - self.start) / 1e9 % CYCLE < 0.5:
                time.sleep(0.02)  # at preload, as someone who knows the test would
            self.listener.call('/ring_displacement/zero')
            time.sleep(1.5)
        self.in_flow('ring_residual', seconds=2.0)

    def pause(self, low: float = 0.1, high: float = CYCLE) -> None:
        """A random while."""
        time.sleep(self.chance.uniform(low, high))


@contextlib.contextmanager
def stage(chance: random.Random, nodes: tuple[str, ...] = RING_NODES,
          domain: int | None = None) -> Iterator[Stage]:
    """Everything started, matched and in full swing; ended again whatever happens."""
    truth = Truth.make()
    with NodeGroup(domain_id=domain) as group:
        assert group.domain_id is not None
        listener = Listener(group.domain_id)
        for name in nodes:
            group.start(name, PARAMETERS.get(name))
        driver, start = start_driver(group)
        one = Stage(group, listener, truth, driver, start, chance)
        try:
            one.in_flow(*[name for name in nodes if name in OUTPUTS], seconds=60.0)
            one.listener.forget()
            yield one
        finally:
            one.driver.kill()
            one.driver.wait()
            listener.close()
