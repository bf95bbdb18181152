"""Rounding errors that readings at rest hide become noise; sound readings are not touched."""

from dataclasses import replace
import math
from pathlib import Path

import numpy as np
import pytest

from saddlering_ros.estimation.rest import hidden_rounding, probe_rounding, rounding_record
from saddlering_ros.record.quality import topic_quality
from saddlering_ros.record.record import Record
from saddlering_ros.record.topics import PROBE_TOPICS

TIME = np.arange(0.0, 8.0, 1e-3)
STAMPS = np.rint(1e9 * TIME).astype(np.int64)


def run(step, noise=1e-7):
    random = np.random.default_rng(0)
    motion = 1e-4 * np.clip(1.0 - np.abs(TIME - 4.5) / 3.0, 0.0, 1.0)
    gaps = 1e-3 + motion + random.normal(0.0, noise, (4, TIME.size))
    gaps = step * np.rint(gaps / step)
    quality = {name: topic_quality(STAMPS, row)
               for name, row in zip(PROBE_TOPICS, gaps, strict=True)}
    return Record('a', Path('a'), 'dynamic', math.radians(50.0), '', '', STAMPS, TIME,
                  np.zeros_like(TIME), gaps, quality=quality)


def test_readings_that_do_not_move_hide_the_whole_error_and_dithered_ones_none():
    assert hidden_rounding(5e-6, 0.0) == pytest.approx(5e-6 / math.sqrt(12.0))
    assert hidden_rounding(3e-8, 3e-7) < 1e-12
    assert hidden_rounding(0.0, 3e-7) == 0.0


def test_a_sound_run_gets_no_error_and_a_coarse_one_the_same_every_time():
    assert probe_rounding(run(3e-8)) is None
    first, second = probe_rounding(run(5e-6)), probe_rounding(run(5e-6))
    assert np.array_equal(first, second)
    # The error is new after each step crossed: 40 of them here, so within a fifth.
    assert first.std(axis=1).mean() == pytest.approx(5e-6 / math.sqrt(12.0), rel=0.2)


def test_a_run_without_known_quality_gets_no_error():
    assert probe_rounding(replace(run(5e-6), quality={})) is None


def test_an_error_lasts_as_long_as_asked():
    values = rounding_record(1e-6, 0.1, 1e-3, 10_000, 0)
    assert values.size == 10_000
    assert np.count_nonzero(np.diff(values)) == pytest.approx(100, abs=1)
