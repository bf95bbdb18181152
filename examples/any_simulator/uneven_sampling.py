"""A cooling body read whenever somebody passes by: samples at uneven times, noise declared."""

import numpy as np

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Noise, Parameter, Run


def simulate(parameters, run):
    """Temperature [degC] from the law of cooling, in small steps between the readings."""
    temperature = np.zeros(run.time.size)
    now, last = run.inputs['start'], run.time[0]
    for index, moment in enumerate(run.time):
        for _ in range(4):
            excess = now - parameters['ambient']
            loss = parameters['rate'] * excess + parameters['radiation.size'] * excess**2
            loss -= parameters['heater.power'] * (now < 40.0)
            now -= (moment - last) / 4.0 * loss
        temperature[index], last = now, moment
    return {'temperature': temperature}


model = Model(
    simulate,
    base={
        'rate': Parameter(0.001, 0.01, unit='1/s'),
        'ambient': Parameter(10, 30, unit='degC'),
    },
    effects={
        'radiation': Effect('Loss by radiation', {'size': Parameter(0, 1e-4)}),
        'heater': Effect('A heater under 40 degC', {'power': Parameter(0, 0.1, unit='K/s')}),
    },
    channels={'temperature': Channel(unit='degC', noise=Noise.white(0.2))},
)
TRUE = {'rate': 0.003, 'ambient': 20.0, 'radiation.size': 0.0, 'heater.power': 0.0}
HIDDEN = {'radiation.size': 2e-5}


def record(name, seed, hidden):
    """150 readings at chance moments of 25 minutes."""
    chance = np.random.default_rng(seed)
    time = np.sort(chance.uniform(0.0, 1500.0, 150))
    run = Run(name, time, {'start': 70.0 + 10.0 * seed}, {'temperature': time})
    seen = simulate({**TRUE, **hidden}, run)['temperature']
    return Run(
        name, time, run.inputs, {'temperature': seen + 0.2 * chance.normal(size=time.size)}
    )


if __name__ == '__main__':
    runs = [record('first', 1, HIDDEN), record('second', 2, HIDDEN)]
    print(diagnose(model, runs, hold_out=[record('third', 3, HIDDEN)]).summary())
