"""A bench of one channel for tests: a load that rises and falls, and what is seen of it."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from saddlering_ros.discrepancy import Effect, Parameter, Point, RestSegment, RunBlocks

STEP = 0.05
TIME = np.arange(0.0, 20.0, STEP)
LOAD = np.interp(TIME, [0, 4, 12, 20], [0.0, 0.0, 1.0, 0.0])


class System:
    """What systems without nuisances share; `predict` (C, N) is theirs, of run and point."""

    channel_names: tuple[str, ...] = ('one',)
    views: Mapping[str, np.ndarray] = MappingProxyType({'one': np.array([1.0])})
    base_parameters: tuple[Parameter, ...] = (Parameter(0.5, 2.0, name='slope'),)

    def nuisances(self, runs: Sequence[RunBlocks], point: Point) -> list[np.ndarray]:
        return [np.zeros((len(self.channel_names), run.time.size, 0)) for run in runs]

    def predict_many(self, run: RunBlocks, points: Sequence[Point]) -> np.ndarray:
        return np.array([self.predict(run.name, point) for point in points])

    def predict(self, name: str, point: Point) -> np.ndarray:
        raise NotImplementedError


class Shapes(System):
    """One channel straight in the load, and effects that each add a size times a shape (N,)."""

    def __init__(self, high: float = 0.5, **shapes: np.ndarray) -> None:
        self.shapes = shapes
        self.effects = tuple(Effect(name, {'size': Parameter(-high, high)}) for name in shapes)

    def predict(self, name: str, point: Point) -> np.ndarray:
        bent = [values['size'] * self.shapes[name] for name, values in point.effects.items()]
        return (point.base[0] * LOAD + sum(bent))[None, :]


def measured(system: System, noise: float, effects: Mapping[str, Mapping[str, float]],
             seed: int = 1, rest: Sequence[RestSegment] = (), base: Sequence[float] = (1.0,),
             ) -> RunBlocks:
    """A run of a system under effects, with white noise."""
    seen = system.predict('slow', Point(np.array(base), effects))
    seen = seen + noise * np.random.default_rng(seed).normal(size=seen.shape)
    return recorded('slow', seen, rest)


def recorded(name: str, seen: np.ndarray, rest: Sequence[RestSegment] = ()) -> RunBlocks:
    """A run of `seen` (C, N); at rest before the load comes, if not at `rest`."""
    quiet = tuple(rest) or (RestSegment(seen[:, TIME < 4.0], STEP),)
    return RunBlocks(name, 'bench', TIME, np.full(TIME.size, STEP), seen, {'load': LOAD}, quiet,
                     direction=np.sign(np.gradient(LOAD)))
