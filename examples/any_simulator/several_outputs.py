"""Two tanks in a row, both levels measured in units of their own; the lower one leaks."""

import numpy as np

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Parameter, Run

STEP = 1.0


def simulate(parameters, run):
    """Levels of the upper tank [mm] and of the lower one [m]."""
    levels = np.zeros((2, run.time.size))
    upper, lower = 0.1, 0.1
    for index, pump in enumerate(run.inputs['pump']):
        levels[:, index] = 1000.0 * upper, lower
        between = parameters['outlet'] * np.sqrt(max(upper, 0.0))
        out = parameters['drain'] * np.sqrt(max(lower, 0.0))
        upper += STEP * (parameters['gain'] * pump - between)
        lower += STEP * (between - out - parameters['leak.size'] * max(lower - 0.1, 0.0))
        upper = min(upper, parameters['overflow.height'])
    return {'upper': levels[0], 'lower': levels[1]}


model = Model(
    simulate,
    base={
        'gain': Parameter(0.002, 0.01),
        'outlet': Parameter(0.005, 0.02),
        'drain': Parameter(0.005, 0.02),
    },
    effects={
        'leak': Effect('Leak above 0.1 m', {'size': Parameter(0, 0.02, unit='1/s')}),
        'overflow': Effect(
            'Upper tank overflows', {'height': Parameter(0.1, 1.0, unit='m', neutral=1.0)}
        ),
    },
    channels={'upper': Channel(unit='mm'), 'lower': Channel(unit='m', offset=0.001)},
)
TRUE = {'gain': 0.005, 'outlet': 0.01, 'drain': 0.011, 'leak.size': 0.0, 'overflow.height': 1.0}
HIDDEN = {'leak.size': 0.005}


def record(name, seed, hidden):
    """The pump goes up and down in steps; noise of 1 mm in both."""
    chance = np.random.default_rng(seed)
    time = STEP * np.arange(600)
    run = Run(name, time, {'pump': np.repeat(chance.uniform(0.4, 1.3, 12), 50)}, {'upper': time})
    seen = simulate({**TRUE, **hidden}, run)
    upper = seen['upper'] + chance.normal(size=time.size)
    return Run(
        name, time, run.inputs,
        {'upper': upper, 'lower': seen['lower'] + 1e-3 * chance.normal(size=time.size)},
    )


if __name__ == '__main__':
    runs = [record('first', 1, HIDDEN), record('second', 2, HIDDEN)]
    print(diagnose(model, runs, hold_out=[record('third', 3, HIDDEN)]).summary())
