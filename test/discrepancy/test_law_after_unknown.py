"""Claims on the law that a diagnosis proposes once its verdict is unknown."""

from dataclasses import replace
from types import MappingProxyType

from bench import LOAD, recorded, System, TIME
import numpy as np
import pytest

from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import diagnose_system, Diagnosis, Point, Problem, RunBlocks

NOISE = 0.003


class Bench(System):
    """A load seen through a slope; no effect is known."""

    effects = ()

    def predict(self, name: str, point: Point) -> np.ndarray:
        return (point.base[0] * LOAD)[None, :]


def runs(size: float, seed: int = 3) -> list[RunBlocks]:
    """Three runs, the last held out, with a step at 0.6 of the load that no effect makes."""
    random = np.random.default_rng(seed)
    law = size * (0.5 + 0.5 * np.tanh((LOAD - 0.6) / 0.02))
    seen = [(1.2 * LOAD + law + random.normal(size=TIME.size) * NOISE)[None, :] for _ in range(3)]
    made = [recorded(f'run {k}', item) for k, item in enumerate(seen)]
    held = made[2]
    return [*made[:2], RunBlocks(held.name, held.group, held.time, held.width, held.channels,
                                 held.inputs, held.rest, True)]


@pytest.fixture(scope='module')
def found() -> Diagnosis:
    return diagnose_system(Problem(Bench(), runs(0.05)))


def test_the_verdict_stays_unknown_and_carries_the_law(found: Diagnosis) -> None:
    assert found.verdict == 'unknown'
    assert found.law is not None
    assert (found.law.terms[0].coordinate, found.law.terms[0].law) == ('load', 'step')
    assert found.law.terms[0].parameters['size'].value == pytest.approx(0.05, rel=0.05)


def test_the_law_is_worth_as_much_on_the_run_held_out(found: Diagnosis) -> None:
    assert found.law.fit > 0.7
    assert found.law.held_out > 0.7


def test_a_clean_rig_gets_no_proposal() -> None:
    clean = diagnose_system(Problem(Bench(), runs(0.0)))
    assert clean.verdict == 'none'
    assert clean.law is None


class BenchWithTheLaw(Bench):
    """The same bench with the proposed law in its catalogue, its size free."""

    def __init__(self, law) -> None:
        self.law, peak = law, float(np.abs(law.terms[0].values).max())
        size = discrepancy.Parameter(-3.0 * peak, 3.0 * peak)
        self.effects = (discrepancy.Effect('proposed', {'size': size}),)

    def predict(self, name: str, point: Point) -> np.ndarray:
        size = point.effects.get('proposed', {}).get('size', 0.0)
        term = self.law.terms[0]
        shape = term.evaluate({'load': LOAD}) / np.abs(term.values).max()
        return (point.base[0] * LOAD + size * shape)[None, :]


def test_the_law_put_into_the_catalogue_is_named_on_fresh_data(found: Diagnosis) -> None:
    again = diagnose_system(Problem(BenchWithTheLaw(found.law), runs(0.05, seed=17)))
    assert again.verdict == 'named'
    assert again.causes[0].effect == 'proposed'
    assert again.causes[0].parameters['size'].value == pytest.approx(0.05, rel=0.05)


class Squared(Bench):
    """The square of a load is seen; an addition may be one to the load."""

    def predict(self, name: str, point: Point) -> np.ndarray:
        return (point.base[0] * LOAD**2)[None, :]

    def targets(self, run: RunBlocks, point: Point) -> dict[str, np.ndarray]:
        return {'drive': (2.0 * point.base[0] * LOAD)[None, :]}

    def start_of(self, run: RunBlocks) -> float:
        return float(run.time[0])


def test_a_law_may_act_on_a_target_that_the_system_names() -> None:
    random = np.random.default_rng(3)
    felt = LOAD + 0.03 * np.sin(2.0 * np.pi * LOAD / 0.3)
    seen = [(1.2 * felt**2 + NOISE * random.normal(size=TIME.size))[None, :] for _ in range(2)]
    found = diagnose_system(Problem(Squared(), [recorded(f'run {k}', own)
                                                for k, own in enumerate(seen)]))
    assert found.law is not None
    assert (found.law.terms[0].target, found.law.terms[0].law) == ('drive', 'sine')


class TwoChannels(System):
    """A load seen bent in two channels, by the same base parameter."""

    channel_names = ('one', 'two')
    views = MappingProxyType({'one': np.array([1.0, 0.0]), 'two': np.array([0.0, 1.0])})
    base_parameters = (discrepancy.Parameter(0.2, 6.0, name='bend'),
                       discrepancy.Parameter(0.5, 2.0, name='slope'))
    effects = ()

    def predict(self, name: str, point: Point) -> np.ndarray:
        bend, slope = point.base
        bent = np.expm1(bend * LOAD) / np.expm1(bend)
        return np.stack([slope * bent, LOAD + bent])


def test_a_law_that_bent_the_base_fit_counts_with_the_base_fitted_beside_it() -> None:
    bench, random = TwoChannels(), np.random.default_rng(5)
    law = -0.5 * np.exp(-(((LOAD - 0.8) / 0.1) ** 2)) * [[1.0], [0.0]]
    exact = bench.predict('', Point(np.array([4.0, 1.2]), {})) + law
    made = [recorded(f'run {k}', exact + random.normal(size=exact.shape) * NOISE)
            for k in range(3)]
    found = diagnose_system(Problem(bench, [*made[:2], replace(made[2], held_out=True)]))
    without = found.runs[2].before - made[2].channels
    assert found.law is not None
    assert found.law.terms[0].coordinate == 'load'
    assert 1.0 - found.law.held_out < 1.15 * NOISE / np.sqrt(np.mean(without**2))
