"""A claim on effects that change nothing at the base fit: they are found where they act."""

import numpy as np

from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run
from saddlering_ros.discrepancy.diagnosis import problem_of
from saddlering_ros.discrepancy.search.evidence import SearchLog
from saddlering_ros.discrepancy.search.selection import select
from saddlering_ros.discrepancy.search.space import prepare
from saddlering_ros.discrepancy.search.valleys import silent_effects

TIME = np.linspace(0.0, 20.0, 400)
RIM = 10.0


def simulate(p: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    """A level nobody sees, and a gauge of unknown gain: only their product is known."""
    level = p['inflow'] * np.asarray(run.inputs['pump'])
    level = level - p['overflow.share'] * np.maximum(level - RIM, 0.0)
    return {'gauge': p['gain'] * level + p['curve.size'] * np.asarray(run.inputs['pump']) ** 2}


MODEL = Model(
    simulate,
    base={'inflow': Parameter(1.0, 30.0, start=2.0), 'gain': Parameter(0.02, 1.0, start=0.5)},
    effects={
        'overflow': Effect('Overflow', {'share': Parameter(0.0, 1.0)}),
        'curve': Effect('Curved pump', {'size': Parameter(-0.5, 0.5)})},
    channels={'gauge': Channel()})


def test_an_overflow_that_the_base_fit_does_not_reach_is_selected() -> None:
    random = np.random.default_rng(1)
    pump = 0.5 - 0.5 * np.cos(1.3 * TIME) * np.cos(0.17 * TIME)
    run = Run('tank', TIME, {'pump': pump}, {'gauge': TIME})
    true = {'inflow': 15.0, 'gain': 1.0 / 15.0, 'overflow.share': 0.6, 'curve.size': 0.0}
    seen = simulate(true, run)['gauge'] + 0.005 * random.normal(size=TIME.size)
    run = Run('tank', TIME, {'pump': pump}, {'gauge': seen})
    space = prepare(problem_of(MODEL, [run], start={'inflow': 2.0, 'gain': 0.5}))
    assert [effect.id for effect, _ in silent_effects(space.signatures)] == ['overflow']
    assert select(space, SearchLog()).candidate.ids == ('overflow',)
