"""The bags from which the demo identifies, and the held-out bags on which it verifies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from saddlering_ros.bags import read_run
from saddlering_ros.demo.errors import DemoError
from saddlering_ros.record import Record

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
