"""A shaft that never rests: torque over the angle, with a cogging whose phase is an angle."""

import numpy as np

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Parameter, Run


def simulate(parameters, run):
    """Torque of a shaft that turns with a speed that swings."""
    angle, speed, gained = run.inputs['angle'], run.inputs['speed'], run.inputs['acceleration']
    torque = parameters['inertia'] * gained + parameters['viscous'] * speed
    torque = torque + parameters['drag.size'] * speed * np.abs(speed)
    wave = np.cos(parameters['cogging.teeth'] * angle - parameters['cogging.phase'])
    return {'torque': torque + parameters['cogging.size'] * wave}


model = Model(
    simulate,
    base={'inertia': Parameter(0.5, 4, unit='kg m^2'), 'viscous': Parameter(0, 5)},
    effects={
        'cogging': Effect(
            'Cogging', {'size': Parameter(0, 4, unit='N m'), 'phase': Parameter.angle()},
            variants=({'teeth': 3.0}, {'teeth': 4.0}),
        ),
        'drag': Effect('Drag of the fan', {'size': Parameter(0, 1)}),
    },
    channels={'torque': Channel(unit='N m', offset='free')},
)
TRUE = {
    'inertia': 1.5, 'viscous': 1.0, 'drag.size': 0.0,
    'cogging.size': 0.0, 'cogging.phase': 0.0, 'cogging.teeth': 3.0,
}
HIDDEN = {'cogging.size': 0.6, 'cogging.phase': 6.2}


def record(name, seed, hidden, noise=0.1):
    """Noise that is correlated over a few samples, and nowhere a rest to measure it at."""
    chance = np.random.default_rng(seed)
    time = 0.01 * np.arange(1000)
    speed = 2.0 + 1.5 * np.sin((1.0 + 0.3 * seed) * time)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.01)])
    inputs = {'angle': angle, 'speed': speed, 'acceleration': np.gradient(speed, time)}
    run = Run(name, time, inputs, {'torque': time})
    white = noise * chance.normal(size=time.size)
    torque = simulate({**TRUE, **hidden}, run)['torque'] + 0.7 * white + 0.7 * np.roll(white, 1)
    coordinates = {'angle': angle % (2 * np.pi), 'speed': speed}
    return Run(name, time, inputs, {'torque': torque}, coordinates)


if __name__ == '__main__':
    runs = [record('first', 1, HIDDEN), record('second', 2, HIDDEN)]
    print(diagnose(model, runs, hold_out=[record('third', 3, HIDDEN)]).summary())
