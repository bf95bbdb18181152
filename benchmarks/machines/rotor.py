"""A rotor on two bearings: records are beams and faults of ross, the model two discs."""

from __future__ import annotations

import numba as nb
import numpy as np
import ross
from ross import faults

from machines.machine import Array, Draw, Machine, noisy
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, EARLY, COUNT, PARTS = 1e-3, 150, 250, 4
"""Step [s] of the records, steps from the start before them, their samples, and steps of each."""

PROBES = {'x4': 24, 'y4': 25, 'x8': 48, 'y8': 49}
"""Places of both discs among the degrees of freedom of ross."""

SHAFT = np.array([[2.288, 1.914], [1.914, 2.288]])
"""What both discs yield [um/N] by the shaft alone, between bearings that are 0.6 m apart."""

LEVER = np.array([[0.7, 0.3], [0.3, 0.7]])
TRUE = {'near_x': 0.85, 'near_y': 1.2, 'far_x': 0.5, 'far_y': 0.6, 'mass': 3.1, 'damping': 200.0,
        'unbalance': 4.0, 'angle': 0.3}
NAMES = ('bow.force', 'bow.angle', 'misaligned.force', 'misaligned.angle', 'misaligned.axes',
         'misaligned.discs', 'crack.loss', 'crack.place', 'rub.stiffness', 'rub.gap',
         'loose.share')


@nb.njit(cache=True)
def whirl(speed, springs, mass, damping, heavy, angle, law):  # type: ignore[no-untyped-def]
    """Displacements (4, N) [um] of both discs from where they hang at rest."""
    bow, to, pull, way, tilt, mix, loss, place, push, gap, loose = law
    seen, q, v, dt = np.empty((4, COUNT)), np.zeros(4), np.zeros(4), STEP / PARTS
    whole = springs.sum(axis=1)
    for n in range((EARLY + COUNT) * PARTS):
        if n % PARTS == 0 and n >= EARLY * PARTS:
            seen[:, n // PARTS - EARLY] = q
        turn, x, y = speed * n * dt, 0.5 * (q[0] + q[2]), 0.5 * (q[1] + q[3])
        facing = turn + place
        moment = np.cos(facing) * (whole[0, 0] * q[0] + whole[0, 1] * q[2])
        moment += np.sin(facing) * (whole[1, 0] * q[1] + whole[1, 1] * q[3] - 19.62 * mass)
        hinge = 0.5 * loss * (1.0 - np.sin(facing)) * moment  # Its weight opens it below.
        pressed = push * max(1.0 - gap / max(np.hypot(x, y), 1e-9), 0.0)
        for axis in range(2):
            late = axis * np.pi / 2.0
            pushed = 0.5 * pressed * (y + 0.3 * x if axis else x - 0.3 * y)
            bent = hinge * np.cos(facing - late)
            twice = pull * np.cos(2.0 * turn + way - late) * np.cos(tilt - late)
            once = 1e-4 * heavy * speed**2 * np.cos(turn + angle - late)
            once += bow * np.cos(turn + to - late)
            held = 1.0 - loose if axis and y > 0.0 else 1.0
            for disc in range(2):
                force = np.sin(mix) * twice if disc else np.cos(mix) * twice + once
                near, far = springs[axis, disc]
                force -= pushed + held * (near * (q[axis] - bent) + far * (q[axis + 2] - bent))
                v[2 * disc + axis] += dt * (1e6 * force - damping * v[2 * disc + axis]) / mass
        q += dt * v
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    springs = np.array([
        np.linalg.inv(SHAFT + (LEVER / [p[f'near_{axis}'], p[f'far_{axis}']]) @ LEVER)
        for axis in 'xy'])
    seen = whirl(float(str(run.inputs['speed'])), springs, *(p[name] for name in list(TRUE)[4:]),
                 np.array([p[name] for name in NAMES]))
    return dict(zip(PROBES, seen, strict=True))


def effect(title: str, size: str, high: float, **shape: Parameter) -> Effect:
    return Effect(title, {size: Parameter(0.0, high), **shape})


MODEL = Model(
    simulate,
    base={**{name: Parameter(0.3 * value, 3.0 * value) for name, value in TRUE.items()},
          'damping': Parameter(20.0, 900.0, unit='N s/m'), 'angle': Parameter(-1.5, 1.5)},
    effects={
        'bow': effect('Bent shaft', 'force', 20, angle=Parameter.angle()),
        'misaligned': effect('Coupling out of line', 'force', 20, angle=Parameter.angle(),
                             axes=Parameter.angle(), discs=Parameter.angle()),
        'crack': effect('Crack that breathes', 'loss', 0.5, place=Parameter.angle()),
        'rub': effect('Rub at the middle', 'stiffness', 1, gap=Parameter(5, 200, unit='um')),
        'loose': effect('Loose foot', 'share', 0.8)},
    channels={probe: Channel('um', offset='free') for probe in PROBES},
)
HIDDEN = {'bow': {'force': 4.0}, 'misaligned': {'force': 8.0}, 'rub': {'stiffness': 0.1}}


def record(draw: Draw) -> Run:
    time, speed = STEP * np.arange(EARLY + COUNT), draw.random.uniform(70.0, 160.0)
    steel = ross.Material('Steel', rho=7850, E=2.17e11, G_s=81.2e9)
    shaft = [ross.ShaftElement(0.06, 0.0, 0.019, material=steel, alpha=20.0, beta=1e-5)
             for _ in range(12)]
    rotor = ross.Rotor(shaft, [ross.DiskElement(n, 2.6, 0.0036, 0.0068) for n in (4, 8)], [
        ross.BearingElement(n, kxx=1e6 * draw.true[f'{end}_x'], kyy=1e6 * draw.true[f'{end}_y'],
                            cxx=500, cyy=500) for n, end in ((1, 'near'), (11, 'far'))])
    force, turned, *_ = rotor.unbalance_force_over_time(
        [4], [1e-4 * draw.true['unbalance']], [draw.true['angle']], speed, time, return_all=True)
    force[24] += draw.size('bow.force') * np.cos(turned + 0.8)
    force[25] += draw.size('bow.force') * np.sin(turned + 0.8)
    apart, push = 5e-6 * draw.size('misaligned.force'), 1e6 * draw.size('rub.stiffness')
    if apart:
        coupling = faults.MisalignmentFlex(rotor, 0, 'parallel', apart, apart, 0.0, 4e4, 3.8e4)
        force += coupling.compute_reaction_force(turned)
    rub = faults.Rubbing(rotor, 6, 4e-5, push, 40.0 if push else 0.0, 0.3)
    rub.forces = np.zeros_like(force)

    def added(step: int, disp_resp: Array, velc_resp: Array, **_: object) -> Array:
        return rub._get_force_over_time(step, disp_resp, velc_resp, speed)

    found = rotor.run_time_response(speed, force.T, time, 'newmark', add_to_RHS=added)
    seen = 1e6 * found.yout[EARLY:, list(PROBES.values())].T
    return draw.run(time[EARLY:], {'speed': speed}, {
        probe: noisy(draw.random, one) for probe, one in zip(PROBES, seen, strict=True)})


MACHINE = Machine('rotor', 'ross-rotordynamics 2.3.0', 'MIT', MODEL, HIDDEN, record, TRUE)
