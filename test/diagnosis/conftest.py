"""Bags of a virtual rig, short but whole, written once for all tests of this folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from saddlering_ros.virtual_rig.campaign import (
    draw_truth,
    DrawSettings,
    RecordSettings,
    RUNS,
    write_campaign,
)

SHORT = RecordSettings(hold=2.0, static_rate=25.0, duration=8.0, dynamic_rate=500.0)

Bags = Callable[..., list[Path]]


@pytest.fixture(scope='session')
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Bags:
    """campaign(effect, value, runs=..., seed=...) -> bags of one rig with that effect, or none."""
    made: dict[tuple[object, ...], list[Path]] = {}

    def make(
        effect: str | None = None,
        value: float = 0.0,
        parameter: str = '',
        runs: tuple[str, ...] = tuple(RUNS),
        seed: int = 4,
    ) -> list[Path]:
        key = (effect, value, runs, seed)
        if key not in made:
            settings = DrawSettings()
            if effect is not None:
                settings = DrawSettings((effect,), fixed={effect: {parameter: value}})
            truth = draw_truth(seed, 'clean' if effect is None else 'single', settings)
            made[key] = write_campaign(truth, tmp_path_factory.mktemp('rig'), runs, SHORT)
        return made[key]

    return make
