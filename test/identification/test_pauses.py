"""Claims about dynamic tests that pause: what a fit costs and learns does not depend on it."""

from dataclasses import replace

from identification_records import observe, record, RIG, sampled
import numpy as np
import pytest

from saddlering_ros.identification import observation
from saddlering_ros.rig import TONNE, TRUE_TO_SCALE


def held(seconds: float):
    """A test of 100 Hz that holds its highest load."""
    corners = np.cumsum([0.0, 1.5, 2.0, seconds, 2.0, 1.5])
    loads = [RIG.preload, RIG.preload, 25 * TONNE, 25 * TONNE, RIG.preload, RIG.preload]
    return record('dynamic', sampled(corners, loads, 100.0), load_noise=50.0, seed=3)


def silent(seconds: float):
    """The same without a sample in the middle of the hold."""
    run = held(2.0)
    time = run.time + seconds * (run.time > 4.5)
    return replace(run, time=time, stamps=(time * 1e9).astype(np.int64))


def observed(run):
    return observe([run], RIG, fit_rate=50.0, contact=TRUE_TO_SCALE)[0]


@pytest.mark.parametrize('paused', [held, silent])
def test_a_pause_of_ten_minutes_costs_a_fit_no_more_than_one_of_half_a_minute(paused):
    short, long = (observed(paused(seconds)) for seconds in (30.0, 600.0))
    assert long.fine_time.size <= short.fine_time.size
    assert np.ptp(long.fine_time) <= np.ptp(short.fine_time) + 0.1


def test_noise_of_the_load_cell_moves_the_readings_after_a_pause_as_without_one(monkeypatch):
    # The motion begins anew after the pause, so that the first readings there are left out. A
    # slow wander of the cell is independent of that at the zero after so long a time.
    monkeypatch.setattr(observation, 'LOAD_WANDER', 0.0)
    deviations = [
        np.sqrt((observed(silent(seconds)).load_errors.answers[:, :, -200:] ** 2).sum(axis=0))
        for seconds in (0.0, 600.0)]
    assert deviations[1] == pytest.approx(deviations[0], rel=0.1)
