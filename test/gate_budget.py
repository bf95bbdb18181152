"""What each test of a run costs: processor seconds, those of the programs it starts included.

Wall time depends on what else the machine does; processor time is the commit's own.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
import os
from typing import Any

import pytest

SHOWN = 25
"""Slowest tests listed at the end of a run."""
MIN_SHOWN = 0.5
"""Tests below this cost [s] are not listed."""
COST = 'processor_seconds'
BESIDE: list[Callable[[], float]] = []
"""Processor seconds of programs that run beside the tests and have not ended."""


def processor_seconds() -> float:
    """Return what this process, its ended children and BESIDE have computed so far [s]."""
    times = os.times()
    return (times.user + times.system + times.children_user + times.children_system
            + sum(seconds() for seconds in BESIDE))


class GateBudget:
    """A pytest plugin that measures every test and prints the costliest."""

    def __init__(self) -> None:
        self.costs: dict[str, float] = {}
        self._counted = processor_seconds()

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Iterator[None]:
        """Write into a test's report what was computed since the last report."""
        outcome: Any = yield
        now = processor_seconds()
        outcome.get_result().user_properties.append((COST, now - self._counted))
        self._counted = now

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up set-up, call and end of each test; in the process that prints, too."""
        if report.when == 'call' or report.when == 'setup' or report.when == 'teardown':
            cost = [value for name, value in report.user_properties if name == COST]
            if cost:
                self.costs[report.nodeid] = self.costs.get(report.nodeid, 0.0) + cost[-1]

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Print the costliest tests and folders."""
        if not self.costs:
            return
        folders: dict[str, float] = defaultdict(float)
        for test, cost in self.costs.items():
            folders['/'.join(test.split('::')[0].split('/')[:-1])] += cost
        terminalreporter.section('processor seconds')
        ranked = sorted(self.costs.items(), key=lambda item: -item[1])
        for test, cost in ranked[:SHOWN]:
            if cost >= MIN_SHOWN:
                terminalreporter.write_line(f'{cost:7.1f}  {test}')
        terminalreporter.write_line('by folder: ' + ', '.join(
            f'{folder} {cost:.0f}' for folder, cost in
            sorted(folders.items(), key=lambda item: -item[1]) if cost >= MIN_SHOWN))
        terminalreporter.write_line(f'all {len(ranked)} tests: {sum(folders.values()):.0f} s')
