"""Claims on what is left: swift swings are seen, noise is not; sizes carry their law's spread."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import sys

import numpy as np
import pytest

from saddlering_ros.discrepancy import diagnose_system, RunBlocks

sys.path.insert(0, str(Path(__file__).parents[2] / 'examples'))

import second_system


def runs(seed: int, **effects: dict[str, float]) -> list[RunBlocks]:
    return [second_system.measure(100 * seed + k, effects, period)
            for k, period in enumerate((1.5, 3.0))]


def swinging(run: RunBlocks, frequency: float, share: float) -> RunBlocks:
    """The same run with a swing that grows with the drive, by a share of the range at its peak."""
    drive = run.inputs['force'] / run.inputs['force'].max()
    swing = share * np.ptp(run.channels) * drive * np.sin(2.0 * np.pi * frequency * run.time)
    return replace(run, channels=run.channels + swing)


def test_noise_alone_gives_no_verdict_and_no_material_swing() -> None:
    found = diagnose_system(second_system.Axis(), runs(7))
    assert found.verdict == 'none'
    assert found.residual_after.fast.visible < 1e-3


def test_a_swing_too_fast_for_the_drive_is_unknown_and_told_by_its_frequency() -> None:
    found = diagnose_system(second_system.Axis(), [swinging(run, 4.0, 0.02) for run in runs(7)])
    assert found.verdict == 'unknown'
    assert found.residual_after.fast.visible > 1e-3
    assert found.residual_after.fast.frequency == pytest.approx(4.0, rel=0.2)
    assert 'Hz' in ' '.join(found.warnings)


def test_an_idealised_law_widens_the_interval_of_its_size() -> None:
    class Idealised(second_system.Axis):
        effects = tuple(
            replace(item, form=0.1) for item in second_system.Axis.effects
            if item.id == 'friction'
        )

    found = diagnose_system(Idealised(), runs(3, friction={'force': 2.0}))
    force = found.causes[0].parameters['force']
    assert 0.1 < force.std / force.value < 0.15
