"""Claims on steady lines of a few hertz, seen in whole runs while the load moves."""

from __future__ import annotations

from bench import LOAD, recorded, STEP, System, TIME
import numpy as np
import pytest

from saddlering_ros.discrepancy import diagnose_system, Effect, Parameter, Point, RestSegment

NOISE = 2e-3
FREQUENCY = 3.7


class Bench(System):
    """One channel straight in the load; it may pick up a line."""

    effects = (
        Effect('pickup', {'cosine': Parameter(-1.0, 1.0), 'sine': Parameter(-1.0, 1.0),
                          'frequency': Parameter(0.5, 500.0, scale='log')}, line=((0,),)),
        Effect('bend', {'size': Parameter(-0.5, 0.5)}),
    )

    def predict(self, name: str, point: Point) -> np.ndarray:
        bend = point.effects.get('bend', {'size': 0.0})['size']
        return (point.base[0] * LOAD + bend * LOAD**2)[None, :]


def two_runs(swing: np.ndarray, bend: float = 0.0) -> list:
    """Two runs with noise, what is added to both, and a bend."""
    runs = []
    for number, name in enumerate(('first', 'second')):
        noise = NOISE * np.random.default_rng(number).normal(size=(1, TIME.size))
        seen = LOAD + bend * LOAD**2 + swing + noise
        runs.append(recorded(name, seen, [RestSegment(seen[:, TIME < 4.0], STEP)]))
    return runs


def line() -> np.ndarray:
    """A line of 0.024, as means over steps show it."""
    shown = 0.024 * np.sinc(FREQUENCY * STEP)
    return shown * np.cos(2.0 * np.pi * FREQUENCY * TIME + 0.4)


def test_a_line_below_ten_hertz_is_named_while_the_load_moves() -> None:
    found = diagnose_system(Bench(), two_runs(line()))
    (cause,) = found.causes
    assert (found.verdict, cause.effect) == ('named', 'pickup')
    assert cause.parameters['frequency'].value == pytest.approx(FREQUENCY, abs=0.02)
    assert cause.parameters['cosine'].value == pytest.approx(0.024, rel=0.05)


def test_a_cause_beside_the_line_is_named_too() -> None:
    found = diagnose_system(Bench(), two_runs(line(), bend=0.1))
    assert found.verdict == 'named'
    assert {cause.effect for cause in found.causes} == {'pickup', 'bend'}


@pytest.mark.parametrize('swing', [
    line() * np.exp(-((TIME - 4.0) % 8.0) / 1.0),
    line() * (LOAD > 0.0) * 2.0,
    0.024 * np.cos(2.0 * np.pi * 0.4 * TIME),
], ids=['ringing after corners', 'under load only', 'slow sway'])
def test_a_swing_that_is_no_steady_line_is_not_named_one(swing: np.ndarray) -> None:
    found = diagnose_system(Bench(), two_runs(swing))
    assert 'pickup' not in {cause.effect for cause in found.causes}


def test_noise_alone_shows_no_line() -> None:
    assert diagnose_system(Bench(), two_runs(np.zeros(TIME.size))).verdict == 'none'
