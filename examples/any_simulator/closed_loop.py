"""A servo drive under position control: the controller reacts to what is missing in the model."""

import numpy as np

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Parameter, Run

STEP = 0.01


def simulate(parameters, run):
    """Position under a PD controller; friction and a spring act on the load."""
    target = run.inputs['target']
    position = np.zeros(target.size)
    place = speed = 0.0
    for index in range(target.size):
        position[index] = place
        force = 900.0 * (target[index] - place) - 60.0 * speed
        force -= parameters['viscous'] * speed + parameters['spring.rate'] * place
        force -= parameters['friction.force'] * np.tanh(speed / 0.01)
        speed += STEP * force / parameters['mass']
        place += STEP * speed
    return {'position': position}


model = Model(
    simulate,
    base={'mass': Parameter(1, 5, unit='kg'), 'viscous': Parameter(0, 40, unit='N s/m')},
    effects={
        'friction': Effect('Dry friction', {'force': Parameter(0, 40, unit='N')}),
        'spring': Effect('Spring beside the load', {'rate': Parameter(0, 300, unit='N/m')}),
    },
    channels={'position': Channel(unit='m')},
)
TRUE = {'mass': 2.5, 'viscous': 12.0, 'friction.force': 0.0, 'spring.rate': 0.0}
HIDDEN = {'friction.force': 8.0}


def record(name, seed, hidden, noise=5e-4):
    """A run as a drive gives it: the target is known, the position is measured."""
    time = STEP * np.arange(600)
    target = 0.2 * np.sign(np.sin((1.0 + 0.4 * seed) * time)) + 0.1 * np.sin(3.1 * time + seed)
    run = Run(name, time, {'target': target}, {'position': np.zeros(time.size)})
    seen = simulate({**TRUE, **hidden}, run)['position']
    seen = seen + noise * np.random.default_rng(seed).normal(size=time.size)
    return Run(name, time, run.inputs, {'position': seen})


if __name__ == '__main__':
    runs = [record('first', 1, HIDDEN), record('second', 2, HIDDEN)]
    print(diagnose(model, runs, hold_out=[record('third', 3, HIDDEN)]).summary())
