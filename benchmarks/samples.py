"""Cost of whitening and of a diagnosis against the number of samples a run, in one process.

    python benchmarks/samples.py [--most 100000]

The dense Cholesky factor, the oracle of the tests, is timed beside up to 4 000 samples.
"""

from __future__ import annotations

import argparse
import resource
import time as clock

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.signal import lfilter

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Noise, Parameter, Run
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.estimation.whitening import build_whitener

NOISE = ChannelNoise(1e-3, np.ones(8), 0.0, 100)
COLUMNS = 50
MAX_DENSE = 4000


def seconds(task) -> float:
    began = clock.process_time()
    task()
    return clock.process_time() - began


def whitening(count: int) -> tuple[float, float]:
    """Processor seconds of factor and 50 columns: in O(N), and dense (NaN if too large)."""
    time, width = np.arange(count) * 1e-3, np.full(count, 1e-3)
    columns = np.random.default_rng(1).normal(size=(count, COLUMNS))
    fast = seconds(lambda: build_whitener(NOISE, time, width).whiten(columns))
    if count > MAX_DENSE:
        return fast, np.nan
    return fast, seconds(
        lambda: solve_triangular(
            cholesky(NOISE.covariance(time, width), lower=True), columns, lower=True
        )
    )


def axis(count: int, fitted: int = 1, channels: int = 1) -> float:
    """Processor seconds of a diagnosis of an axis with dry friction, `fitted` runs to fit.

    Every channel measures the same force in another unit, with noise of its own.
    """
    names = [f'force {number}' for number in range(1, channels + 1)]
    time = np.linspace(0.0, 100.0, count)
    speed = np.sin(0.7 * time) + 0.4 * np.sin(2.3 * time)

    def simulate(p: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        v = np.asarray(run.inputs['speed'])
        force = p['viscous'] * v + p['dry.force'] * np.tanh(v / 0.02)
        force = force + p['stiff.cubic'] * v**3
        return {name: number * force for number, name in enumerate(names, start=1)}

    model = Model(
        simulate,
        base={'viscous': Parameter(0.0, 20.0)},
        effects={'dry': Effect('Dry friction', {'force': Parameter(0.0, 5.0)}),
                 'stiff': Effect('Cubic drag', {'cubic': Parameter(0.0, 5.0)})},
        channels={name: Channel(unit='N', noise=Noise.unknown()) for name in names},
    )
    runs = []
    for seed in range(1, fitted + 2):
        random = np.random.default_rng(seed)
        own = speed + 0.1 * np.sin((1.0 + seed) * time)
        outputs = {}
        for number, name in enumerate(names, start=1):
            slow = lfilter([0.02], [1.0, -0.98], random.normal(size=count))
            truth = 8.0 * own + np.tanh(own / 0.02)
            outputs[name] = number * (truth + 0.2 * random.normal(size=count) + 0.3 * slow)
        runs.append(Run(f'run {seed}', time, inputs={'speed': own}, outputs=outputs,
                        coordinates={'speed': own}))
    spent = []

    def task() -> None:
        spent.append(diagnose(model, runs[:-1], hold_out=runs[-1:]))

    used = seconds(task)
    print(f'    {spent[0].verdict}: {[cause.effect for cause in spent[0].causes]}')
    return used


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--most', type=int, default=100_000)
    most = parser.parse_args().most
    whitening(100)  # compile
    print('samples  whitening [s]  dense [s]  ratio')
    for count in (1000, 4000, 10_000, 30_000, 100_000):
        if count <= most:
            fast, dense = whitening(count)
            print(f'{count:7d}  {fast:13.4f}  {dense:9.3f}  {dense / fast:5.1f}')
    print('samples  diagnosis [s of processor]')
    for count in (1000, 10_000, 100_000):
        if count <= most:
            print(f'{count:7d}  {axis(count):.1f}')
    used = axis(most, fitted=4, channels=3)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    print(f'4 runs of 3 channels and {most} samples: {used:.1f} s, at most {peak:.1f} GB')


if __name__ == '__main__':
    main()
