"""Claims on what is left: swift swings are seen, noise is not; sizes carry their law's spread."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
import sys

from bench import LOAD, recorded, System, TIME
import numpy as np
import pytest

from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import Effect, Parameter, Point, Problem, RunBlocks
from saddlering_ros.discrepancy.problem.system import Estimate
from saddlering_ros.discrepancy.verdict.published import with_form_error

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
    found = discrepancy.diagnose_system(Problem(second_system.Axis(), runs(7)))
    assert found.verdict == 'none'
    assert found.residual_after.fast.visible < 1e-3


def test_a_swing_too_fast_for_the_drive_is_unknown_and_told_by_its_frequency() -> None:
    swung = [swinging(run, 4.0, 0.02) for run in runs(7)]
    found = discrepancy.diagnose_system(Problem(second_system.Axis(), swung))
    assert found.verdict == 'unknown'
    assert found.residual_after.fast.visible > 1e-3
    assert found.residual_after.fast.frequency == pytest.approx(4.0, rel=0.2)
    assert 'Hz' in ' '.join(found.warnings)


def test_an_idealised_law_widens_the_interval_of_its_size() -> None:
    class Idealised(second_system.Axis):
        effects = tuple(
            replace(item, form=0.1) for item in second_system.Axis.effects
            if item.id == 'friction')

    found = discrepancy.diagnose_system(Problem(Idealised(), runs(3, friction={'force': 2.0})))
    force = found.causes[0].parameters['force']
    assert 0.1 < force.std / force.value < 0.15


def test_the_form_error_counts_in_every_amplitude() -> None:
    """Friction of two coordinates had a force of 2.128 +- 0.014 kN where 2.049 kN were true."""
    law = Effect('friction', {
        'moment': Parameter(0, 9), 'force': Parameter(0, 9, neutral=0.0),
        'sharpness': Parameter(0, 1)}, form=0.1)
    told = with_form_error(law, {name: Estimate(2.0, 0.01, '') for name in law.parameters})
    assert {name: round(size.std, 2) for name, size in told.items()} == {
        'moment': 0.2, 'force': 0.2, 'sharpness': 0.01}


def test_a_limit_of_a_hundredth_of_the_one_that_cuts_nothing_off_errs_by_its_own_share() -> None:
    """A limit of 110 µm was published with a deviation of 44 µm."""
    cut = Effect('cut', {'limit': Parameter(2.0, 1000.0, neutral=1000.0, scale='log')})
    told = with_form_error(cut, {'limit': Estimate(110.0, 0.3, '')}, 0.05)
    assert told['limit'].std == pytest.approx(5.5, rel=0.01)


class Imitated(System):
    """A slope, and a nuisance parameter with a wave and a narrow peak in its column."""

    base_parameters = (Parameter(0.5, 2.0, name='slope'),)
    effects = (Effect('bend', {'size': Parameter(-1.0, 1.0)}),)

    def predict(self, name: str, point: Point) -> np.ndarray:
        bend = point.effects.get('bend', {}).get('size', 0.0)
        return (point.base[0] * LOAD + bend * LOAD**2)[None, :]

    def nuisances(self, runs: Sequence[RunBlocks], point: Point) -> list[np.ndarray]:
        column = 0.1 * np.cos(2.5 * np.pi * TIME / TIME[-1]) + PEAK
        return [column[None, :, None] for _ in runs]


PEAK = 0.02 * np.exp(-((TIME - 12.0) / 0.15) ** 2)


def test_a_structure_is_not_larger_than_the_residual_in_which_it_is_seen() -> None:
    noise = 2e-4 * np.random.default_rng(5).standard_normal((2, TIME.size))
    measured = [recorded(f'run {k}', (LOAD + PEAK + own)[None, :]) for k, own in enumerate(noise)]
    found = discrepancy.diagnose_system(Problem(Imitated(), measured))
    assert found.residual_before.slow.visible < 0.0143  # rms of the residual; the wave is 0.07
