"""A wheel and its share of the car over a road; records by the multibody program exudyn."""

from __future__ import annotations

from typing import Any

import exudyn
from exudyn.itemInterface import (
    CoordinateSpringDamper,
    CoordinateSpringDamperExt,
    MarkerNodeCoordinate,
    Mass1D,
    Node1D,
    NodeGenericData,
    NodePointGround,
)
import numba as nb
import numpy as np

from machines.machine import Array, Draw, Machine, noisy, swings
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, SUBSTEPS, FINE = 0.01, 4, 1e-3
COUNT = 800
BODY, WHEEL = 300.0, 40.0
TRUE = {'spring': 18.0, 'damper': 1.2, 'tyre': 180.0}
"""kN/m, kN s/m, kN/m."""


@nb.njit(cache=True)
def ride(road, law):  # type: ignore[no-untyped-def]
    """Travel of the suspension and rise of the body (2, N) by midpoint steps [m]."""
    spring, damper, tyre, friction, stiff, room, cubic, uneven = law
    seen = np.empty((2, road.size))
    b = v = w = u = 0.0
    dt = STEP / SUBSTEPS
    for n in range(road.size):
        seen[0, n], seen[1, n] = b - w, b
        begin, end = road[n], road[min(n + 1, road.size - 1)]
        for part in range(SUBSTEPS):
            b0, v0, w0, u0 = b, v, w, u
            for stage in range(2):
                share = 0.5 * (stage + 1)
                ground = begin + (end - begin) * (part + 0.5 * stage) / SUBSTEPS
                travel, speed = b - w, v - u
                force = spring * travel + cubic * travel**3
                force += damper * speed * (1.0 + uneven * np.tanh(speed / 0.01))
                force += friction * np.tanh(speed / 0.005)
                force += stiff * (max(travel - room, 0.0) + min(travel + room, 0.0))
                lift = (force - tyre * (w - ground)) / WHEEL
                b, w = b0 + share * dt * v, w0 + share * dt * u
                v, u = v0 - share * dt * force / BODY, u0 + share * dt * lift
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([1e3 * p['spring'], 1e3 * p['damper'], 1e3 * p['tyre'], p['friction.force'],
                    1e3 * p['stop.stiffness'], 1e-3 * p['stop.room'], 1e6 * p['progressive.size'],
                    p['uneven.share']])
    seen = 1e3 * ride(np.asarray(run.inputs['road']), law)
    return {'travel': seen[0], 'body': seen[1]}


MODEL = Model(
    simulate,
    base={'spring': Parameter(8, 40, unit='kN/m'), 'damper': Parameter(0.3, 4, unit='kN s/m'),
          'tyre': Parameter(80, 400, unit='kN/m')},
    effects={
        'friction': Effect('Dry friction of the strut', {'force': Parameter(0, 400, unit='N')}),
        'stop': Effect('Bump stops', {'stiffness': Parameter(0, 300, unit='kN/m'),
                                      'room': Parameter(5, 60, unit='mm')}),
        'progressive': Effect('Spring that hardens',
                              {'size': Parameter(0, 40, unit='N/mm^3 / 1000')}),
        'uneven': Effect('Damper unlike in both directions', {'share': Parameter(-0.9, 0.9)}),
    },
    channels={'travel': Channel(unit='mm'), 'body': Channel(unit='mm')},
)
HIDDEN = {'friction': {'force': 30.0}, 'stop': {'stiffness': 40.0, 'room': 25.0},
          'progressive': {'size': 2.5}, 'uneven': {'share': 0.15}}


def record(draw: Draw) -> Run:
    true, random = draw.true, draw.random
    time = STEP * np.arange(COUNT)
    road = 0.02 * swings(random, time, 0.4, 3.0)
    road -= road[0]
    container: Any = exudyn.SystemContainer()
    system = container.AddSystem()
    ground = system.AddNode(NodePointGround())
    fixed = system.AddMarker(MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
    markers = []
    for mass in (BODY, WHEEL):
        node = system.AddNode(Node1D(referenceCoordinates=[0.0]))
        system.AddObject(Mass1D(nodeNumber=node, physicsMass=mass))
        markers.append(system.AddMarker(MarkerNodeCoordinate(nodeNumber=node, coordinate=0)))
    body, wheel = markers
    cubic, uneven = 1e6 * draw.size('progressive.size'), draw.size('uneven.share')

    def strut(_: object, now: float, __: int, travel: float, speed: float, *rest: float) -> float:
        own = 1e3 * true['damper'] * speed * (1.0 + uneven * np.sign(speed))
        return 1e3 * true['spring'] * travel + cubic * travel**3 + own

    system.AddObject(CoordinateSpringDamper(
        markerNumbers=[wheel, body], springForceUserFunction=strut))
    if 'friction.force' in draw.hidden:
        system.AddObject(CoordinateSpringDamperExt(
            markerNumbers=[wheel, body], dynamicFrictionForce=draw.hidden['friction.force'],
            frictionProportionalZone=1e-3))
    if 'stop.stiffness' in draw.hidden:
        state = system.AddNode(NodeGenericData(
            numberOfDataCoordinates=3, initialCoordinates=[0.0, 0.0, 0.0]))
        room = 1e-3 * draw.hidden['stop.room']
        system.AddObject(CoordinateSpringDamperExt(
            markerNumbers=[wheel, body], nodeNumber=state, useLimitStops=True,
            limitStopsLower=-room, limitStopsUpper=room,
            limitStopsStiffness=1e3 * draw.hidden['stop.stiffness']))
    system.AddObject(CoordinateSpringDamper(
        markerNumbers=[fixed, wheel], stiffness=1e3 * true['tyre'],
        springForceUserFunction=lambda _, now, __, place, *rest: (
            1e3 * true['tyre'] * (place - float(np.interp(now, time, road))))))
    system.Assemble()
    path = [system.systemData.GetODE2Coordinates()]

    def keep(inner: Any, now: float) -> bool:
        if now > 0.0:
            path.append(inner.systemData.GetODE2Coordinates())
        return True

    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps = round(STEP / FINE) * (COUNT - 1)
    settings.timeIntegration.endTime = STEP * (COUNT - 1)
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.9
    settings.timeIntegration.adaptiveStep = False
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    system.SetPostStepUserFunction(keep)
    if not exudyn.SolveDynamic(system, settings):
        raise RuntimeError('exudyn did not reach the end')
    high, low = np.array(path).T[:, :: round(STEP / FINE)]
    seen = np.array([high - low, high])
    return draw.run(time, {'road': road},
                    {'travel': noisy(random, 1e3 * seen[0]), 'body': noisy(random, 1e3 * seen[1])})


MACHINE = Machine(
    'quarter_car', 'exudyn 1.13.6', 'EXUDYN General License', MODEL, HIDDEN, record, TRUE)
