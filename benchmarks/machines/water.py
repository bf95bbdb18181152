"""A water main with a loop of three taps; the records are EPANET's (wntr), the pipes unlike."""

from __future__ import annotations

import tempfile

import numba as nb
import numpy as np
import wntr

from machines.machine import Array, Draw, Machine, noisy, swings
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, COUNT = 900.0, 400
TAPS = ('near', 'left', 'right')
PIPES = {'main': (0, 1, 800.0), 'to_left': (1, 2, 500.0), 'to_right': (1, 3, 600.0),
         'across': (2, 3, 400.0)}
WIDTH, SHARES = 0.25, (0.012, 0.02, 0.016)
TRUE = {'head': 55.0, 'smooth': 110.0}
NAMES = ('leak_left.size', 'leak_right.size', 'valve.loss', 'meter.share', 'gauge.offset')


@nb.njit(cache=True)
def heads(use, ends, lengths, law):  # type: ignore[no-untyped-def]
    """Heads (N, 3) [m] at the taps by Newton's method; use (N, 3) [m^3/s]."""
    source, smooth, left, right, valve, meter, _ = law
    seen, head = np.empty((use.shape[0], 3)), np.array([source, source, source, source]) - 5.0
    head[0] = source
    for n in range(use.shape[0]):
        for _ in range(30):
            slope, over = np.zeros((3, 3)), np.zeros(3)
            for pipe in range(4):
                a, b = ends[pipe]
                rough = 10.67 * lengths[pipe] / (smooth**1.852 * WIDTH**4.87)
                fall = head[a] - head[b]
                # A closed valve adds a loss by the square of the flow of about 20 l/s.
                rough += valve * 0.0826 / WIDTH**4 * 0.02**0.148 if pipe == 3 else 0.0
                size = max(abs(fall), 1e-6)
                flow, steep = np.sign(fall) * (size / rough) ** 0.54, 0.54 * (
                    size / rough) ** 0.54 / size
                for node, sign in ((a, -1.0), (b, 1.0)):
                    if node:
                        over[node - 1] += sign * flow
                        for other, way in ((a, 1.0), (b, -1.0)):
                            if other:
                                slope[node - 1, other - 1] += sign * way * steep
            for tap, leak in enumerate((0.0, left, right)):
                root = np.sqrt(max(head[tap + 1], 0.01))
                over[tap] -= use[n, tap] * (1.0 + meter * (tap == 2)) + 1e-3 * leak * root
                slope[tap, tap] -= 5e-4 * leak / root
            step = np.linalg.solve(slope, over)
            head[1:] -= step
            if np.abs(step).max() < 1e-6:
                break
        seen[n] = head[1:]
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    ends = np.array([pipe[:2] for pipe in PIPES.values()])
    lengths = np.array([pipe[2] for pipe in PIPES.values()])
    law = np.array([p['head'], p['smooth'], *(p[name] for name in NAMES)])
    seen = heads(np.asarray(run.inputs['use']), ends, lengths, law)
    seen[:, 1] += p['gauge.offset']
    return dict(zip(TAPS, seen.T, strict=True))


MODEL = Model(
    simulate,
    base={'head': Parameter(40, 70, unit='m'), 'smooth': Parameter(60, 150)},
    effects={
        'leak_left': Effect('Leak on the left', {'size': Parameter(0, 4)}),
        'leak_right': Effect('Leak on the right', {'size': Parameter(0, 4)}),
        'valve': Effect('Valve of the link half closed', {'loss': Parameter(0, 20000)}),
        'meter': Effect('Gain of the right meter', {'share': Parameter(-0.3, 0.5)}),
        'gauge': Effect('Offset of the left gauge', {'offset': Parameter(-3, 3, unit='m')}),
    },
    channels={tap: Channel('m') for tap in TAPS},
)
HIDDEN = {'leak_left': {'size': 0.5}, 'leak_right': {'size': 0.5}, 'valve': {'loss': 2500.0},
          'meter': {'share': 0.12}, 'gauge': {'offset': 0.4}}


def record(draw: Draw) -> Run:
    time, own = STEP * np.arange(COUNT), np.random.default_rng([draw.seed, 7])
    use = np.maximum(1e-4, np.array(SHARES) * np.column_stack([
        1.0 + 0.5 * swings(draw.random, time, 1.2e-5, 2e-4) for _ in TAPS]))
    net = wntr.network.WaterNetworkModel()
    net.options.hydraulic.inpfile_units = 'CMH'
    net.options.hydraulic.emitter_exponent = 0.5
    net.options.time.duration = int(STEP * (COUNT - 1))
    for option in ('hydraulic_timestep', 'pattern_timestep', 'report_timestep'):
        setattr(net.options.time, option, int(STEP))
    net.add_reservoir('0', base_head=draw.true['head'])
    for tap in range(3):
        share = 1.0 + draw.size('meter.share') * (tap == 2)
        net.add_pattern(f'use{tap}', use[:, tap])
        net.add_junction(str(tap + 1), share, f'use{tap}')
    for tap, name in ((2, 'leak_left.size'), (3, 'leak_right.size')):
        net.get_node(str(tap)).emitter_coefficient = 1e-3 * draw.size(name)
    for name, (a, b, length) in PIPES.items():
        rough = draw.true['smooth'] * np.exp(0.06 * own.normal())
        loss = own.uniform(0.0, 5.0) + draw.size('valve.loss') * (name == 'across')
        net.add_pipe(name, str(a), str(b), length, WIDTH, rough, loss)
    with tempfile.TemporaryDirectory() as folder:
        found = wntr.sim.EpanetSimulator(net).run_sim(file_prefix=f'{folder}/net')
    seen = found.node['pressure'][['1', '2', '3']].to_numpy()
    seen[:, 1] += draw.size('gauge.offset')
    return draw.run(time, {'use': use}, {
        tap: noisy(draw.random, seen[:, place]) for place, tap in enumerate(TAPS)})


MACHINE = Machine('water', 'wntr', 'BSD-3-Clause', MODEL, HIDDEN, record, TRUE)
