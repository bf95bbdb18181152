"""The ring in a multibody program (exudyn): one body, one spring-damper per roller.

This model shares no sum, Jacobian or time stepping with the reference; only the force law of one
roller is repeated. The model verifies the reference in place of ADAMS.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.errors import SaddleringError
from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.rig.geometry import resolve_load

Floats = NDArray[np.float64]
UserForce = Callable[..., list[float]]


class MultibodyError(SaddleringError):
    """The multibody program is not installed or found no solution."""


def _exudyn() -> Any:
    try:
        import exudyn
    except ImportError as problem:
        raise MultibodyError('exudyn is not installed: pip install "saddlering_ros[test]"') \
            from problem
    return exudyn


def _unit(stiffness: float, exponent: float, damping: float) -> Callable[[float, float], float]:
    """F(p, dp/dt) of one contact unit [N]: max(0, K p^n + s(p) D dp/dt), s a C1 ramp over 1 µm."""
    def force(depth: float, rate: float) -> float:
        if depth <= 0.0:
            return 0.0
        u = min(depth / 1e-6, 1.0)
        fade = u * u * (3.0 - 2.0 * u)
        return max(0.0, float(stiffness * depth**exponent + fade * damping * rate))
    return force


def _axial(unit: Callable[[float, float], float], sense: float, gap: float) -> UserForce:
    def pull(mbs: Any, t: float, item: int, move: list[float], rate: list[float],
             *_: Any) -> list[float]:
        return [0.0, sense * unit(sense * move[1] - gap, sense * rate[1]), 0.0]
    return pull


def _radial(unit: Callable[[float, float], float], cosine: float, gap: float) -> UserForce:
    def pull(mbs: Any, t: float, item: int, move: list[float], rate: list[float],
             *_: Any) -> list[float]:
        return [cosine * unit(cosine * move[0] - gap, cosine * rate[0]), 0.0, 0.0]
    return pull


class MultibodyRing:
    """One test in exudyn: the upper ring a rigid body in the load plane, the lower the ground.

    The rotation is right-handed and therefore minus gamma. Forces act at C with fixed lever arms,
    as in the ring model. The kinematics are finite and differ from those of the model by gamma^2.
    """

    def __init__(self, rig: Rig, contact: ContactParameters, elevation: float,
                 load_at: Callable[[float], float], start: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        self._exudyn = _exudyn()
        items = import_module('exudyn.itemInterface')
        self._system = self._exudyn.SystemContainer()
        self._mbs = self._system.AddSystem()
        x, y, gamma = (float(value) for value in np.asarray(start))
        self._node = self._mbs.AddNode(items.NodeRigidBody2D(initialCoordinates=[x, y, -gamma]))
        self._body = self._mbs.AddObject(items.ObjectRigidBody2D(
            mass=rig.carriage.mass, inertia=rig.carriage.inertia, nodeNumber=self._node))
        self._ground = self._mbs.AddObject(items.ObjectGround())
        self._add_rollers(items, rig, contact)
        self._add_loads(items, rig, elevation, load_at)
        self._mbs.Assemble()

    def _add_rollers(self, items: Any, rig: Rig, contact: ContactParameters) -> None:
        unit = _unit(contact.K1, contact.n1, contact.D1)
        gap, radius = 0.5 * rig.axial_rows.clearance, rig.axial_rows.pitch_radius
        for angle in 2.0 * np.pi * np.arange(rig.axial_rows.rollers) / rig.axial_rows.rollers:
            place = [radius * np.cos(angle), 0.0, radius * np.sin(angle)]
            self._add_connector(items, place, _axial(unit, 1.0, gap))
            self._add_connector(items, place, _axial(unit, -1.0, gap))
        unit = _unit(contact.K2, contact.n2, contact.D2)
        gap, radius = 0.5 * rig.radial_row.clearance, rig.radial_row.pitch_radius
        for angle in 2.0 * np.pi * np.arange(rig.radial_row.rollers) / rig.radial_row.rollers:
            place = [0.0, rig.radial_row.height, 0.0]
            self._add_connector(items, place, _radial(unit, float(np.cos(angle)), gap))

    def _add_connector(self, items: Any, place: list[float], force: UserForce) -> None:
        markers = [self._mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=body,
                                                                localPosition=place))
                   for body in (self._ground, self._body)]
        self._mbs.AddObject(items.ObjectConnectorCartesianSpringDamper(
            markerNumbers=markers, springForceUserFunction=force))

    def _add_loads(self, items: Any, rig: Rig, elevation: float,
                   load_at: Callable[[float], float]) -> None:
        weight, arm = rig.carriage.weight, rig.carriage.weight_x

        def force(mbs: Any, t: float, _: Any) -> list[float]:
            resolved = resolve_load(rig, load_at(t), elevation)
            return [float(resolved.force_x), float(resolved.force_y) - weight, 0.0]

        def moment(mbs: Any, t: float, _: Any) -> list[float]:
            resolved = resolve_load(rig, load_at(t), elevation)
            return [0.0, 0.0, -float(resolved.moment) - weight * arm]

        centre = self._mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=self._body))
        self._mbs.AddLoad(items.LoadForceVector(markerNumber=centre, loadVectorUserFunction=force))
        self._mbs.AddLoad(items.LoadTorqueVector(markerNumber=centre,
                                                 loadVectorUserFunction=moment))

    def _settings(self) -> Any:
        settings = self._exudyn.SimulationSettings()
        for solver in (settings.staticSolver, settings.timeIntegration):
            solver.verboseMode = 0
            solver.newton.relativeTolerance = 1e-9
            solver.newton.absoluteTolerance = 1e-6
            solver.newton.useModifiedNewton = False
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = 1e9
        settings.show.statistics = False
        settings.show.computationTime = False
        return settings

    def _motion(self) -> Floats:
        x, y, turn = self._mbs.systemData.GetODE2Coordinates()
        return np.array([x, y, -turn])

    def static(self) -> Floats:
        """Motion (3,) at equilibrium under the load at t = 0; MultibodyError if none is found."""
        settings = self._settings()
        settings.staticSolver.useLoadFactor = False
        settings.staticSolver.numberOfLoadSteps = 1
        if not self._exudyn.SolveStatic(self._mbs, settings):
            raise MultibodyError('exudyn found no equilibrium: start it nearer to one')
        return self._motion()

    def dynamic(self, end: float, steps: int) -> Floats:
        """Motion (3, steps + 1) from t = 0 to `end` [s], starting at rest; generalised alpha."""
        settings = self._settings()
        integration = settings.timeIntegration
        integration.endTime, integration.numberOfSteps = end, steps
        integration.generalizedAlpha.spectralRadius = 0.9
        integration.adaptiveStep = False
        path = [self._motion()]

        def keep(mbs: Any, t: float) -> bool:
            if t > 0.0:
                path.append(self._motion())
            return True

        self._mbs.SetPostStepUserFunction(keep)
        if not self._exudyn.SolveDynamic(self._mbs, settings):
            raise MultibodyError('exudyn did not reach the end: shorten the step')
        return np.asarray(np.array(path).T, dtype=np.float64)
