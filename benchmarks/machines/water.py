"""A water main with a loop of three taps; the records are EPANET's (wntr), the pipes unlike."""

import tempfile

import numpy as np
import wntr

from machines.machine import Array, Draw, hides, own_machine, swings
from saddlering_ros.discrepancy import Channel, Parameter, Run

STEP, COUNT, WIDTH, SHARES = 900, 400, 0.25, np.array([0.012, 0.02, 0.016])
PIPES = np.array([[1, -1, 0, 0], [0, 1, -1, 0], [0, 1, 0, -1], [0, 0, 1, -1]])  # source, taps
LENGTHS = np.array([800.0, 500.0, 600.0, 400.0])


def heads(use: Array, law: Array, rounds: int) -> Array:
    """Heads (3, N) [m] at the taps by Newton's method; use (N, 3) [m^3/s]."""
    source, smooth, left, right, valve, meter, gauge = law
    rough, leak = 10.67 * LENGTHS / smooth**1.852 / WIDTH**4.87, 1e-3 * np.array([0, left, right])
    rough[3] += valve * 0.0826 / WIDTH**4 * 0.02**0.148  # by the square of about 20 l/s
    head = source - np.tile([0.0, 5.0, 5.0, 5.0], (len(use), 1))
    for _ in range(rounds):
        fall, root = head @ PIPES.T, np.sqrt(np.maximum(head[:, 1:], 0.01))
        size = np.maximum(np.abs(fall), 1e-6)
        flow = (size / rough) ** 0.54
        over = (np.sign(fall) * flow) @ PIPES[:, 1:] + use * (1, 1, 1 + meter) + leak * root
        slope = np.einsum('pa,np,pb->nab', PIPES, 0.54 * flow / size, PIPES)[:, 1:, 1:]
        head[:, 1:] -= np.linalg.solve(slope, over[..., None])[..., 0]
    return np.asarray(head[:, 1:].T + gauge * np.eye(3)[[1]].T)


def record(draw: Draw) -> Run:
    time, net = STEP * np.arange(COUNT), wntr.network.WaterNetworkModel()
    head, smooth, left, right, valve, meter, gauge = draw.law()
    wave = np.column_stack([swings(draw.random, time, 1.2e-5, 2e-4) for _ in SHARES])
    use = np.maximum(1e-4, SHARES * (1.0 + 0.5 * wave))
    net.options.time = wntr.network.options.TimeOptions(STEP * (COUNT - 1), *4 * [STEP], 0, STEP)
    net.add_reservoir('0', base_head=head)
    for tap, (share, leak) in enumerate([(1.0, 0.0), (1.0, left), (1.0 + meter, right)], 1):
        net.add_pattern(f'use{tap}', use[:, tap - 1])
        net.add_junction(f'{tap}', share, f'use{tap}')
        net.get_node(f'{tap}').emitter_coefficient = 1e-3 * leak
    for pipe, length, shut in zip(PIPES, LENGTHS, (0.0, 0.0, 0.0, valve), strict=True):
        rough, loss = smooth * np.exp(0.06 * draw.own.normal()), draw.own.uniform(0.0, 5.0) + shut
        net.add_pipe(f'{length:g}', *map(str, np.flatnonzero(pipe)), length, WIDTH, rough, loss)
    with tempfile.TemporaryDirectory() as folder:
        seen = wntr.sim.EpanetSimulator(net).run_sim(f'{folder}/net').node['pressure']
    return draw.run(time, {'use': use}, seen[[*'123']].to_numpy().T + gauge * np.eye(3)[[1]].T)


MACHINE = own_machine('water', record, heads, source='wntr', licence='BSD-3-Clause', base={
    'head': (55.0, Parameter(40, 70, unit='m')), 'smooth': (110.0, Parameter(60, 150)),
}, effects={
    'leak_left': hides('Leak on the left', 0.5, size=Parameter(0, 4)),
    'leak_right': hides('Leak on the right', 0.5, size=Parameter(0, 4)),
    'valve': hides('Valve of the link half closed', 2500.0, loss=Parameter(0, 20000)),
    'meter': hides('Gain of the right meter', 0.12, share=Parameter(-0.3, 0.5)),
    'gauge': hides('Offset of the left gauge', 0.4, offset=Parameter(-3, 3, unit='m')),
}, channels={tap: Channel('m') for tap in ('near', 'left', 'right')}, lacks=(), parts=15)
