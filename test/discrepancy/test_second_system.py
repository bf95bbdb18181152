"""Claims of the engine on a machine that is no ring."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
import sys

import numpy as np
import pytest

from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import Channel, check, diagnose, Effect, Model, Point, Problem, Run
from saddlering_ros.progress import Progress

sys.path.insert(0, str(Path(__file__).parents[2] / 'examples'))

import second_system


class Short(second_system.Axis):
    """The axis with some effects taken out of its catalogue."""

    def __init__(self, *missing: str) -> None:
        self.effects = tuple(item for item in second_system.Axis.effects if item.id not in missing)


@lru_cache(maxsize=8)
def diagnosed(hidden: str, size: float) -> discrepancy.Diagnosis:
    effects = {hidden: {effect_size(hidden): size}}
    runs = [second_system.measure(100 + k, effects, period) for k, period in enumerate((3.0, 6.0))]
    return discrepancy.diagnose_system(Problem(Short(), runs))


def effect_size(name: str) -> str:
    return next(item for item in second_system.Axis.effects if item.id == name).size.name


@pytest.mark.parametrize(('effect', 'size'), [('friction', 2.0), ('encoder_gain', 0.02)])
def test_a_hidden_effect_is_named_and_measured(effect: str, size: float) -> None:
    found = diagnosed(effect, size)
    assert found.verdict == 'named'
    assert [cause.effect for cause in found.causes] == [effect]
    estimate = found.causes[0].parameters[effect_size(effect)]
    assert abs(estimate.value - size) < max(5.0 * estimate.std, 0.05 * size)


def test_the_gain_holds_on_runs_left_out() -> None:
    gain = diagnosed('friction', 2.0).causes[0].gain
    assert gain.held_out is not None
    assert gain.held_out > 0.5


def test_a_simulator_of_the_wrong_shape_is_told_so() -> None:
    class Wrong(second_system.Axis):
        def predict_many(self, run: discrepancy.RunBlocks, points: Sequence[Point]) -> np.ndarray:
            return np.zeros((len(points), 1, run.time.size))

    with pytest.raises(ValueError, match='wrong shape'):
        discrepancy.diagnose_system(Problem(Wrong(), [second_system.measure(1, {}, 3.0)]))


class SlowAxis:
    """The axis as a declared model, of which a run takes so many seconds of a clock of its own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, each: float, *missing: str) -> None:
        self.now, self.each = 0.0, each
        monkeypatch.setattr('time.monotonic', lambda: self.now)
        axis = Short(*missing)
        self.model = Model(
            self.simulate, {item.name: item for item in axis.base_parameters},
            {item.id: Effect(item.title, item.parameters) for item in axis.effects},
            {name: Channel('m') for name in axis.channel_names})

    def simulate(self, values: Mapping[str, float], run: Run) -> dict[str, np.ndarray]:
        self.now += self.each
        effects: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            effect, _, parameter = name.rpartition('.')
            effects.setdefault(effect, {})[parameter] = value
        base = effects.pop('')
        point = Point(np.array([base['stiffness'], base['damping']]), effects)
        # Time and inputs are all that the axis reads of a run.
        seen = Short().predict_many(run, [point])[0]  # type: ignore[arg-type]
        return dict(zip(Short.channel_names, seen, strict=True))

    def runs(self, hidden: Mapping[str, Mapping[str, float]]) -> list[Run]:
        blocks = [second_system.measure(100 + k, dict(hidden), period)
                  for k, period in enumerate((3.0, 6.0))]
        return [Run(one.name, one.time, one.inputs, dict(zip(
            Short.channel_names, one.channels, strict=True))) for one in blocks]


@dataclass
class Timed:
    """What the check stated, and what the diagnosis took and reported by the clock of the axis."""

    stated: str
    taken: float
    verdict: str
    reports: list[tuple[float, float]]


@lru_cache(maxsize=1)
def timed(hidden: str, size: float, *missing: str) -> Timed:
    with pytest.MonkeyPatch.context() as patch:
        slow, reports = SlowAxis(patch, 0.3, *missing), list[tuple[float, float]]()
        runs = slow.runs({hidden: {effect_size(hidden): size}} if hidden else {})
        line = next(line for line in check(slow.model, runs) if ' s in all' in line)
        began = slow.now

        def hear(report: Progress) -> None:
            reports.append((slow.now - began, report.share))

        found = diagnose(slow.model, runs, on_progress=hear)
        return Timed(line, slow.now - began, found.verdict, reports)


@pytest.mark.parametrize(('asked', 'verdict'), [
    (('', 0.0), 'none'), (('friction', 2.0), 'named'), (('encoder_gain', 0.02), 'named'),
    (('friction', 4.0, 'friction'), 'unknown')])
def test_a_diagnosis_takes_about_the_time_that_the_check_states(asked, verdict) -> None:
    found = timed(*asked)
    words = {'named': 'about ', 'none': 'named, ', 'unknown': 'wrong, '}[verdict]
    stated = float(found.stated.split(words)[1].split(' s')[0])
    assert found.verdict == verdict
    assert 0.4 * stated < found.taken < 2.5 * stated


def test_a_search_without_a_cause_reports_every_few_simulations() -> None:
    found = timed('friction', 4.0, 'friction')
    times, shares = np.array([(0.0, 0.0), *found.reports, (found.taken, 1.0)]).T
    assert np.diff(times).max() < 2.0
    assert (np.diff(shares) >= 0.0).all()
    # No share stays for a tenth of the time.
    assert max(np.ptp(times[shares == share]) for share in shares) < 0.1 * found.taken
