"""The engine on another machine: a motor-driven axis with something hidden in it, diagnosed.

A mass on a spring and damper, moved by a measured force; hidden may be dry friction, backlash, an
offset of the force, a late clock or a gain error of its second sensor. RunBlocks it: python
examples/second_system.py [effect [size]] [--seed N]
"""

import argparse
from types import MappingProxyType

from numba import njit
import numpy as np

from saddlering_ros.discrepancy import (
    diagnose_system,
    Effect,
    Parameter,
    Point,
    Problem,
    RestSegment,
    RunBlocks,
)

STEP = 0.02
"""Between two samples [s]."""
SLIP = 2e-5
"""Travel [m] within which dry friction builds up."""


@njit(cache=True)
def move(stiffness, damping, friction, cubic, offset, width, force, seen):
    """Write the positions of mass and motor of each point (P,) into seen (P, 2, N)."""
    for point in range(len(stiffness)):
        place = held = motor = 0.0                     # held: travel kept by the friction element
        for index in range(len(force)):
            drive = force[index] - offset[point]
            for _ in range(4):                         # overdamped: inertia is not felt
                grip = friction[point] * min(max((place - held) / SLIP, -1.0), 1.0)
                slope = (stiffness[point] + 3 * cubic[point] * place**2 + friction[point] / SLIP
                         + damping[point] / (STEP / 4))
                spring = stiffness[point] * place + cubic[point] * place**3
                place += (drive - grip - spring) / slope
                held = min(max(held, place - SLIP), place + SLIP)
            motor = min(max(motor, place - width[point] / 2), place + width[point] / 2)
            seen[point, 0, index], seen[point, 1, index] = place, motor


class Axis:
    """m x'' + d x' + k x + friction = force; channels: linear scale and motor encoder [m]."""

    channel_names = ('scale', 'encoder')
    views = MappingProxyType({'scale': np.array([1.0, 0.0]), 'encoder': np.array([0.0, 1.0])})
    base_parameters = (
        Parameter(2e3, 5e4, scale='log', unit='N/m', name='stiffness'),
        Parameter(50.0, 5e3, scale='log', unit='N s/m', name='damping'),
    )
    effects = (
        Effect('friction', {'force': Parameter(0.0, 40.0, unit='N')}),
        Effect('backlash', {'width': Parameter(0.0, 2e-3, unit='m')}),
        Effect('force_offset', {'force': Parameter(-40.0, 40.0, unit='N')}),
        Effect('delay', {'time': Parameter(0.0, 0.2, unit='s')}),
        Effect('encoder_gain', {'gain': Parameter(-0.1, 0.1)}),
        Effect('hardening', {'cubic': Parameter(-2e8, 2e8, unit='N/m^3')}),
    )

    def nuisances(self, runs: list[RunBlocks], point: Point) -> list[np.ndarray]:
        return [np.zeros((2, run.time.size, 0)) for run in runs]

    def predict_many(self, run: RunBlocks, points: list[Point]) -> np.ndarray:
        stiffness, damping = np.array([point.base for point in points]).T

        def values_of(effect: str, name: str) -> np.ndarray:
            return np.array([point.effects.get(effect, {}).get(name, 0.0) for point in points])

        friction, cubic = values_of('friction', 'force'), values_of('hardening', 'cubic')
        offset, width = values_of('force_offset', 'force'), values_of('backlash', 'width')
        seen = np.empty((len(points), 2, run.time.size))
        move(stiffness, damping, friction, cubic, offset, width, run.inputs['force'], seen)
        for row, late in enumerate(values_of('delay', 'time')):
            for channel in range(2):
                seen[row, channel] = np.interp(run.time - late, run.time, seen[row, channel])
        seen[:, 1] *= 1.0 + values_of('encoder_gain', 'gain')[:, None]
        return seen


def measure(seed: int, effects: dict, period: float, noise: float = 2e-6) -> RunBlocks:
    """A ramp up and down with AR(1) noise, at rest before and after, as a machine gives it."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, 2 * period + 8.0, STEP)
    force = np.interp(time, [0, 4, 4 + period, 4 + 2 * period], [0.0, 0.0, 200.0, 0.0])
    run = RunBlocks(f'ramp of {period:g} s', 'axis', time, np.full(time.size, STEP),
              np.zeros((2, time.size)), {'force': force}, direction=np.sign(np.gradient(force)))
    truth = Axis().predict_many(run, [Point(np.array([1.2e4, 6e2]), effects)])[0]
    white = random.normal(size=(2, time.size)) * noise
    for index in range(1, time.size):
        white[:, index] += 0.8 * white[:, index - 1]
    channels = truth + white
    rest = (RestSegment(channels[:, time < 4.0], STEP),)
    return RunBlocks(run.name, run.group, time, run.width, channels, run.inputs, rest,
                     direction=run.direction)


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('effect', nargs='?', default='friction')
    parser.add_argument('size', nargs='?', type=float)
    parser.add_argument('--seed', type=int, default=1)
    chosen = parser.parse_args()
    effect = next(item for item in Axis.effects if item.id == chosen.effect)
    size = 0.1 * effect.size.high if chosen.size is None else chosen.size
    hidden = {effect.id: {effect.size.name: size}}
    runs = [measure(chosen.seed + k, hidden, period)
            for k, period in enumerate((4.0, 8.0, 16.0))]
    found = diagnose_system(Problem(Axis(), runs))
    print(f'hidden: {hidden}\nverdict: {found.verdict}, {found.seconds:.1f} s')
    for cause in found.causes:
        print(cause.group, dict(cause.parameters), f'gain left out {cause.gain.held_out:.0%}')
