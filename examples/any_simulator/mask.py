"""A position sensor that drops out: missing samples are NaN in the outputs."""

import numpy as np

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Parameter, Run

STEP = 0.02


def simulate(parameters, run):
    """Position of a mass on a spring, pushed by a known force."""
    position = np.zeros(run.time.size)
    place = speed = 0.0
    for index, push in enumerate(run.inputs['force']):
        position[index] = place
        pull = parameters['stiffness'] * place + parameters['hardening.cubic'] * place**3
        damping = parameters['damping'] + parameters['late_damping.size'] * abs(speed)
        speed += STEP * (push - pull - damping * speed)
        place += STEP * speed
    return {'position': position}


model = Model(
    simulate,
    base={'stiffness': Parameter(1, 50, unit='1/s^2'), 'damping': Parameter(0.1, 5, unit='1/s')},
    effects={
        'hardening': Effect('Hardening spring', {'cubic': Parameter(-10, 40)}),
        'late_damping': Effect('Damping by the square of speed', {'size': Parameter(0, 3)}),
    },
    channels={'position': Channel(unit='m')},
)
TRUE = {'stiffness': 9.0, 'damping': 0.8, 'hardening.cubic': 0.0, 'late_damping.size': 0.0}
HIDDEN = {'hardening.cubic': 4.0}


def record(name, seed, hidden, noise=2e-3):
    """One reading in ten is missing, and a gap of two seconds."""
    chance = np.random.default_rng(seed)
    time = STEP * np.arange(700)
    force = 6.0 * np.sin((1.5 + 0.2 * seed) * time) + 3.0 * np.sin(0.6 * time)
    run = Run(name, time, {'force': force}, {'position': time})
    seen = simulate({**TRUE, **hidden}, run)['position'] + noise * chance.normal(size=time.size)
    seen[chance.random(time.size) < 0.1] = np.nan
    seen[300:400] = np.nan
    return Run(name, time, run.inputs, {'position': seen})


if __name__ == '__main__':
    runs = [record('first', 1, HIDDEN), record('second', 2, HIDDEN)]
    print(diagnose(model, runs, hold_out=[record('third', 3, HIDDEN)]).summary())
