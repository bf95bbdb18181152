"""Identification against what a user would put together, side by side in one run.

1. One simulation of the same ramp: our kernel, scipy solve_ivp on the vectorised 304-roller model,
   exudyn (a multibody code standing in for ADAMS) with the same rollers as a force function.
2. The whole identification by the paper's method and by the default one; what it takes with
   pyswarms on the plain model and scipy (a part measured, the rest by proportion).
3. Optimisers on one and the same objective with one and the same number of evaluations: pyswarms,
   pymoo PSO, CMA-ES, scipy differential evolution, ours; share of seeds that reach the bottom.
4. Where the paper's own swarm stops, ours and pyswarms with the same settings.
Peers that are not installed are left out by name; benchmarks/peers-requirements.txt has them.
    python benchmarks/peers.py [--seeds 30] [--quick]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
import os
from pathlib import Path
import sys
import time

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test' / 'ring'))

from readable_ring import (
    contact_force,
    contact_rows,
    external_force,
    rate_of_state,
    static_equilibrium,
)
from rigs import RIG, virtual_run
from scipy.integrate import solve_ivp
from scipy.optimize import differential_evolution

from saddlering_ros.estimation.least_squares import SearchSpace
from saddlering_ros.identification import IdentificationSettings, identify, SwarmSettings
from saddlering_ros.identification.objective import (
    average_branches,
    PaperObjective,
    WeightedObjective,
)
from saddlering_ros.identification.observation import observe
from saddlering_ros.identification.swarm import minimise
from saddlering_ros.rig import ContactParameters, FULL_SCALE_LOAD, PARAMETER_NAMES, TRUE_TO_SCALE
from saddlering_ros.ring import dynamic_batch, SimulationError, static_batch, static_response

Array = NDArray[np.float64]
ELEVATION = np.radians(50.0)
CONTACT = TRUE_TO_SCALE.to_array()
REACHED = 1.001
"""An optimiser has reached the bottom when its chi square is within 0.1 % of the lowest known."""


def ramp(seconds: float, rate: float = 1000.0) -> tuple[Array, Array]:
    """Time [s] and load [N] of a ramp to 25 t and back."""
    time_s = np.arange(0.0, seconds, 1.0 / rate)
    return time_s, RIG.preload + (FULL_SCALE_LOAD - RIG.preload) * (
        1.0 - np.abs(2.0 * time_s / seconds - 1.0)
    )


def best_of(
    work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Shortest time [s] of several calls."""
    times = []
    for _ in range(repeats):
        started = clock()
        work()
        times.append(clock() - started)
    return min(times)


def simulations(seconds: float, noise: float) -> None:
    """Part 1: processor time of one simulation, and how far the displacements lie apart.

    noise: rms of the load cell [N]; a load that has it cannot be stepped over by adaptive steps.
    """
    grid, load = ramp(seconds)
    load = load + np.random.default_rng(0).normal(0.0, 1.0, load.size) * noise
    fast = dynamic_batch(RIG, CONTACT[None], ELEVATION, grid, load)[0]
    one = best_of(lambda: dynamic_batch(RIG, CONTACT[None], ELEVATION, grid, load), 5,
                  time.process_time)
    loads = np.concatenate([np.linspace(0.0, FULL_SCALE_LOAD, 26), np.linspace(
        FULL_SCALE_LOAD, 0.0, 26)[1:]])
    still = best_of(lambda: static_batch(RIG, CONTACT[None], ELEVATION, loads), 20,
                    time.process_time)
    print(f'ramp of {seconds:g} s at 1 kHz, load with noise of {noise:g} N, processor time; '
          'largest difference of delta_x to ours')
    print(f'  {"ours, one core":34s} {1e3 * one:10.2f} ms')
    print(f'  {"ours, static run of 51 plateaus":34s} {1e3 * still:10.3f} ms')
    longest = 1e-3 if noise else 0.02
    for name, solve in (('scipy solve_ivp LSODA', by_scipy('LSODA', longest)),
                        ('scipy solve_ivp Radau', by_scipy('Radau', longest)),
                        ('exudyn generalised alpha', by_exudyn)):
        try:
            started = time.process_time()
            motion = solve(grid, load)
            took = time.process_time() - started
        except ImportError as problem:
            print(f'  {name:34s} left out: {problem.name} is not installed')
            continue
        difference = np.abs(motion[0] - fast[0]).max()
        print(f'  {name:34s} {1e3 * took:10.0f} ms   {took / one:8.0f} x ours   '
              f'{1e9 * difference:8.1f} nm')


def by_scipy(method: str, longest: float) -> Callable[[Array, Array], Array]:
    def solve(grid: Array, load: Array) -> Array:
        start = static_equilibrium(RIG, TRUE_TO_SCALE, float(load[0]), ELEVATION)
        rate = rate_of_state(
            RIG, TRUE_TO_SCALE, ELEVATION, lambda t: float(np.interp(t, grid, load))
        )
        solution = solve_ivp(
            rate, (grid[0], grid[-1]), np.concatenate([start, np.zeros(3)]), method=method,
            t_eval=grid, rtol=1e-6, atol=1e-11, max_step=longest,
        )
        return np.asarray(solution.y[:3])

    return solve


def by_exudyn(grid: Array, load: Array) -> Array:
    import exudyn

    rows = contact_rows(RIG, TRUE_TO_SCALE)
    start = static_equilibrium(RIG, TRUE_TO_SCALE, float(load[0]), ELEVATION)
    mass = np.diag([RIG.carriage.mass, RIG.carriage.mass, RIG.carriage.inertia])
    container = exudyn.SystemContainer()
    system = container.AddSystem()
    node = system.AddNode({
        'nodeType': 'GenericODE2', 'numberOfODE2Coordinates': 3,
        'referenceCoordinates': [0.0] * 3, 'initialCoordinates': list(start),
        'initialCoordinates_t': [0.0] * 3, 'name': 'ring',
    })

    def force(_system, t, _item, q, v):
        outside = external_force(RIG, float(np.interp(t, grid, load)), ELEVATION)
        return outside + contact_force(rows, np.array(q), np.array(v))

    system.AddObject({
        'objectType': 'GenericODE2', 'nodeNumbers': [node], 'massMatrix': mass,
        'forceUserFunction': force, 'name': 'rollers',
    })
    system.Assemble()
    settings = exudyn.SimulationSettings()
    steps = len(grid) - 1
    settings.timeIntegration.numberOfSteps = steps
    settings.timeIntegration.endTime = float(grid[-1])
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.solutionSettings.writeSolutionToFile = False  # type: ignore[attr-defined]
    settings.solutionSettings.sensorsWritePeriod = float(grid[1])  # type: ignore[attr-defined]
    sensor = system.AddSensor({
        'sensorType': 'Node', 'nodeNumber': node, 'name': 'motion', 'storeInternal': True,
        'outputVariableType': exudyn.OutputVariableType.Coordinates, 'writeToFile': False,
    })
    system.SolveDynamic(settings)
    stored = np.array(system.GetSensorStoredData(sensor))
    return np.stack([np.interp(grid, stored[:, 0], stored[:, column]) for column in (1, 2, 3)])


def whole_identifications() -> None:
    """Part 2: a static and a dynamic record, 20 particles and 50 iterations a step."""
    runs = [
        virtual_run('static', 50.0, TRUE_TO_SCALE, seed=1),
        virtual_run('dynamic', 50.0, TRUE_TO_SCALE, seed=2),
    ]
    print('whole identification, one static run and one dynamic run of 10 s at 1 kHz')
    for method in ('paper', 'default'):
        settings = IdentificationSettings(method=method)
        found = identify(runs, RIG, settings)
        took = best_of(partial(identify, runs, RIG, settings), 2)
        print(f'  {method:10s} {took:8.2f} s   {found.evaluations:6d} evaluations   '
              f'chi square per degree of freedom {found.reduced_chi_square:.3g}   '
              f'{", ".join(found.notes)}')


def by_hand(seconds: float, iterations: int) -> None:
    """Part 2, the peer: pyswarms on the plain model and solve_ivp, over part of the record.

    The static step solves 51 equilibria a particle with scipy.optimize.root, the dynamic step runs
    solve_ivp over `seconds` of the recorded, noisy load, no step longer than a sample. Both scale
    with the particles and iterations, the dynamic one with the seconds too.
    """
    static = np.concatenate([np.arange(26), np.arange(24, -1, -1)]) * FULL_SCALE_LOAD / 25.0
    grid, load = ramp(10.0)
    load = load + np.random.default_rng(0).normal(0.0, 50.0, load.size)
    part = (grid >= 2.0) & (grid < 2.0 + seconds)
    span = np.array([np.log(50.0), 0.5, np.log(2e3), np.log(50.0), 0.5, np.log(2e3)])
    low = np.array([np.log(2e7), 1.0, np.log(1e4)] * 2)

    def laws(points: Array) -> list[ContactParameters]:
        values = low + points * span
        values[:, [0, 2, 3, 5]] = np.exp(values[:, [0, 2, 3, 5]])
        return [ContactParameters.from_array(row) for row in values]

    def static_misfit(law: ContactParameters) -> float:
        found, total = None, 0.0
        for force in static:
            try:
                found = static_equilibrium(RIG, law, float(force), ELEVATION, start=found)
            except SimulationError:  # scipy's root gives up in corners of the box
                return np.inf
            total += float(found[0]) ** 2
        return total

    def dynamic_misfit(law: ContactParameters) -> float:
        start = static_response(RIG, law.to_array(), ELEVATION, load[part][:1])[:, 0]
        rate = rate_of_state(RIG, law, ELEVATION, lambda t: float(np.interp(t, grid, load)))
        solution = solve_ivp(
            rate, (grid[part][0], grid[part][-1]), np.concatenate([start, np.zeros(3)]),
            method='BDF', t_eval=grid[part], rtol=1e-6, atol=[1e-9] * 3 + [1e-6] * 3,
            max_step=1e-3)
        return float(np.sum(solution.y[0] ** 2))

    whole = 0.0
    for words, misfit, factor in (('static', static_misfit, 1.0),
                                  ('dynamic', dynamic_misfit, 10.0 / seconds)):
        started = time.process_time()
        pyswarms_best(lambda points, one=misfit: np.array([one(law) for law in laws(points)]), 6,
                      0, 4, iterations)
        each = (time.process_time() - started) / (4 * iterations) * factor
        whole += 1000.0 * each
        print(f'  pyswarms on scipy, {words} step: {1e3 * each:8.1f} ms an evaluation '
              f'({4 * iterations} timed), 1000 take {1000.0 * each:8.0f} s')
    print(f'  pyswarms on scipy, both steps of 20 x 50: {whole:.0f} s, extrapolated')


def optimisers(seeds: int, particles: int, iterations: int) -> None:
    """Part 3: chi square reached on one objective with one number of evaluations."""
    runs = [
        virtual_run('static', 50.0, TRUE_TO_SCALE, seed=1),
        virtual_run('dynamic', 50.0, TRUE_TO_SCALE, seed=2, rate=200.0),
    ]
    observations = [one.coarse() for one in observe(runs, RIG, fit_rate=20.0)]
    space = SearchSpace.of(
        RIG.bounds, PARAMETER_NAMES, TRUE_TO_SCALE, ('K1', 'K2', 'D1', 'D2')
    )
    peers = {
        'ours, swarm alone': by_our_swarm, 'pyswarms': by_pyswarms, 'pymoo PSO': by_pymoo,
        'CMA-ES (cmaes)': by_cmaes, 'scipy DE': by_differential_evolution,
        'ours, swarm and least squares': by_default_method,
    }
    reached: dict[str, list[float]] = {}
    costs: dict[str, tuple[float, int]] = {}
    for name, run in peers.items():
        objective = WeightedObjective(RIG, observations, (0, 1, 2))
        started = time.perf_counter()
        try:
            reached[name] = [
                run(objective, space, seed, particles, iterations) for seed in range(seeds)
            ]
        except ImportError as problem:
            print(f'  {name}: left out, {problem.name} is not installed')
            continue
        costs[name] = ((time.perf_counter() - started) / seeds, objective.evaluations // seeds)
    lowest = min(min(values) for values in reached.values())
    print(f'{seeds} seeds, {particles} x {iterations} evaluations, six parameters; lowest chi '
          f'square known {lowest:.6g}')
    print(f'  {"optimiser":30s} {"s/seed":>8s} {"evals":>7s} {"median":>12s} {"worst":>12s} '
          f'{"at the bottom":>14s} {"ours not above":>15s}')
    ours = np.array(reached['ours, swarm and least squares'])
    for name, values in reached.items():
        took, evaluations = costs[name]
        at_bottom = sum(value <= REACHED * lowest for value in values)
        print(f'  {name:30s} {took:8.2f} {evaluations:7d} {np.median(values):12.6g} '
              f'{max(values):12.6g} {at_bottom:7d} of {seeds} '
              f'{int(np.sum(ours <= np.array(values) * (1.0 + 1e-9))):8d} of {seeds}')


def paper_swarm(seeds: int) -> None:
    """Part 4: where the paper's static step stops, ours and pyswarms' with the same settings."""
    one = observe([virtual_run('static', 50.0, TRUE_TO_SCALE, seed=1)], RIG, fit_rate=50.0)[0]
    objective = PaperObjective(RIG, [average_branches(
        one.coarse(), RIG.limits.level_step)], (0, 2))
    space = SearchSpace.of(RIG.bounds, ('K1', 'n1', 'K2', 'n2'), TRUE_TO_SCALE)
    span = space.high - space.low

    def ours(seed: int) -> float:
        return minimise(lambda points: objective(space.contacts(points)), space.low, space.high,
                        SwarmSettings(), seed=seed).objective

    def peer(seed: int) -> float:
        return pyswarms_best(
            lambda points: objective(space.contacts(space.low + points * span)), 4, seed, 20, 50)

    print(f"the paper's static step, 20 x 50, {seeds} seeds: J reached; J of the truth "
          f'{float(objective(CONTACT[None])[0]):.3g}')
    for name, run in (('ours', ours), ('pyswarms', peer)):
        try:
            values = [run(seed) for seed in range(seeds)]
        except ImportError:
            continue
        print(f'  {name:10s} least {min(values):.3g}  median {np.median(values):.3g}  '
              f'largest {max(values):.3g}')



def by_our_swarm(
    objective: WeightedObjective, space: SearchSpace, seed: int, particles: int, iterations: int
) -> float:
    return minimise(
        lambda points: objective(space.contacts(points)), space.low, space.high,
        SwarmSettings(particles=particles, iterations=iterations), seed=seed,
    ).objective


def by_default_method(
    objective: WeightedObjective, space: SearchSpace, seed: int, particles: int, iterations: int
) -> float:
    from saddlering_ros.identification.objective import refine

    start = minimise(
        lambda points: objective(space.contacts(points)), space.low, space.high,
        SwarmSettings(particles=particles, iterations=max(1, iterations // 4)), seed=seed,
    )
    return refine(objective, space, start.position).chi_square


def by_pyswarms(
    objective: WeightedObjective, space: SearchSpace, seed: int, particles: int, iterations: int
) -> float:
    span = space.high - space.low
    return pyswarms_best(lambda points: objective(space.contacts(space.low + points * span)),
                         len(span), seed, particles, iterations)


def pyswarms_best(
    objective: Callable[[Array], Array], size: int, seed: int, particles: int, iterations: int
) -> float:
    """Lowest objective found in the unit box with the paper's settings, inertia 0.9 to 0.4."""
    import logging

    import pyswarms

    logging.disable(logging.CRITICAL)
    np.random.seed(seed)
    optimiser = pyswarms.single.GlobalBestPSO(
        particles, size, {'c1': 1.2, 'c2': 1.7, 'w': 0.9},
        bounds=(np.zeros(size), np.ones(size)), velocity_clamp=(-0.2, 0.2),
    )
    # pyswarms' own schedules do not run from 0.9 to 0.4 over all iterations.
    optimiser.oh = lambda options, iternow, itermax: {
        **options, 'w': 0.9 - 0.5 * iternow / max(1, itermax - 1)}
    cost, _ = optimiser.optimize(objective, iterations, verbose=False)
    return float(cost)


def by_pymoo(
    objective: WeightedObjective, space: SearchSpace, seed: int, particles: int, iterations: int
) -> float:
    from pymoo.algorithms.soo.nonconvex.pso import PSO
    from pymoo.core.problem import Problem
    from pymoo.optimize import minimize

    class Chi(Problem):
        def __init__(self) -> None:
            super().__init__(n_var=len(space.low), n_obj=1, xl=space.low, xu=space.high)

        def _evaluate(self, x, out, *args, **kwargs):
            out['F'] = objective(space.contacts(x))

    found = minimize(
        Chi(), PSO(pop_size=particles), ('n_eval', particles * iterations), seed=seed
    )
    return float(np.ravel(found.F)[0])


def by_cmaes(
    objective: WeightedObjective, space: SearchSpace, seed: int, particles: int, iterations: int
) -> float:
    from cmaes import CMA

    optimiser = CMA(
        mean=np.full(len(space.low), 0.5), sigma=0.25, population_size=particles, seed=seed,
        bounds=np.array([[0.0, 1.0]] * len(space.low)),
    )
    best = np.inf
    for _ in range(iterations):
        points = np.array([optimiser.ask() for _ in range(particles)])
        values = objective(space.contacts(space.low + points * (space.high - space.low)))
        best = min(best, float(values.min()))
        optimiser.tell(list(zip(points, values.tolist(), strict=True)))
    return best


def by_differential_evolution(
    objective: WeightedObjective, space: SearchSpace, seed: int, particles: int, iterations: int
) -> float:
    found = differential_evolution(
        lambda points: objective(space.contacts(np.atleast_2d(points.T))),
        list(zip(space.low, space.high, strict=True)), vectorized=True, seed=seed, polish=False,
        popsize=max(1, particles // len(space.low)),
        maxiter=particles * iterations // (max(1, particles // len(space.low)) * len(space.low)),
        updating='deferred', tol=0.0,
    )
    return float(found.fun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=30)
    parser.add_argument('--quick', action='store_true', help='3 seeds and a ramp of 1 s')
    args = parser.parse_args()
    print(f'{len(os.sched_getaffinity(0))} cores, load {os.getloadavg()[0]:.1f} at the start')
    for noise in (0.0, 50.0):
        simulations(1.0 if args.quick else 10.0, noise)
    whole_identifications()
    try:
        by_hand(0.05 if args.quick else 0.2, 2 if args.quick else 5)
    except ImportError as problem:
        print(f'  pyswarms on scipy: left out, {problem.name} is not installed')
    optimisers(3 if args.quick else args.seeds, particles=20, iterations=50)
    paper_swarm(3 if args.quick else args.seeds)


if __name__ == '__main__':
    main()
