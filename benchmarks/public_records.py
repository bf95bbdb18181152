"""Public records whose hidden nonlinearity is known: is it found, and what is it worth?

    python benchmarks/public_records.py FOLDER [--without overflow]

FOLDER holds the data, which are not part of this repository; docs/benchmarks/ has the source,
citation and licence of each set. Sets that are not in the folder are left out.

- dataBenchmark.csv: cascaded tanks with overflow. M. Schoukens, P. Mattson, T. Wigren, J.-P. Noel,
  Cascaded tanks benchmark combining soft and hard nonlinearities, Workshop on Nonlinear System
  Identification Benchmarks, Brussels 2016. Fitted on uEst, yEst, held out uVal, yVal.
- exchanger.csv: steam heat exchanger. S. Bittanti, L. Piroddi, Nonlinear identification and
  control of a heat exchanger: a neural network approach, J. Franklin Institute 334 (1997) 135;
  DaISy 97-002. Columns time, flow, temperature; fitted on samples 100 to 2 000, held out from
  there to 4 000.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import time as clock

import numba as nb
import numpy as np

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Parameter, Run

SUBSTEPS = 4
RIM = 10.0
"""Reading of a full tank [V], as the description of the tanks gives it."""


@nb.njit(cache=True)
def tanks(pump, step, start, law, extra):  # type: ignore[no-untyped-def]
    """Level of the lower tank (N,): Bernoulli outflow, Euler steps.

    law: outflow of the upper tank, feed and outflow of the lower one, gain of the pump. extra:
    share of what rises over the rim that is spilt; share of that which falls into the lower tank;
    curvature of the pump; change of the exponent of the outflow.
    """
    upper, lower = start
    out, into, away, gain = law
    spilt, caught, curve, exponent = extra
    level = np.empty(pump.size)
    dt = step / SUBSTEPS
    for n in range(pump.size):
        level[n] = min(lower, RIM)
        for _ in range(SUBSTEPS):
            first = max(upper, 0.0) ** (0.5 + exponent)
            second = max(lower, 0.0) ** (0.5 + exponent)
            flow = gain * (pump[n] + curve * pump[n] ** 2)
            upper += dt * (flow - out * first)
            lower += dt * (into * first - away * second)
            if upper > RIM:
                over = spilt * (upper - RIM)
                upper -= over
                lower += caught * over * into / out
            if lower > RIM:
                lower = RIM
        if not np.isfinite(lower):
            break
    return level


def cascaded_tanks(file: Path, without: str) -> tuple[Model, Run, Run]:
    """The model of the tanks without overflow, the run to fit and the run held out."""
    table = np.genfromtxt(file, delimiter=',', skip_header=1, usecols=(0, 1, 2, 3))
    time = 4.0 * np.arange(table.shape[0])

    def simulate(p: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        pump = np.asarray(run.inputs['pump'])
        start = np.array([p['start'], float(run.outputs['level'][:4].mean())])
        law = np.array([p['out'], p['into'], p['away'], p['gain']])
        extra = np.array([p.get('overflow.spilt', 0.0), p.get('overflow.caught', 0.0),
                          p.get('pump.curvature', 0.0), p.get('outlet.exponent', 0.0)])
        return {'level': tanks(pump, 4.0, start, law, extra)}

    effects = {
        'overflow': Effect('Overflow of the upper tank', {
            'spilt': Parameter(0, 1), 'caught': Parameter(0, 1)}),
        'pump': Effect('Curved characteristic of the pump', {'curvature': Parameter(-0.1, 0.1)}),
        'outlet': Effect('Discharge unlike a square root', {'exponent': Parameter(-0.3, 0.3)}),
    }
    effects.pop(without, None)
    model = Model(
        simulate,
        base={
            'out': Parameter(0.005, 0.15), 'into': Parameter(0.005, 0.15),
            'away': Parameter(0.005, 0.15), 'gain': Parameter(0.005, 0.15),
            'start': Parameter(0.0, 10.0),
        },
        effects=effects,
        channels={'level': Channel(unit='V', offset='none', model_error=0.005)},
    )
    runs = [
        Run(name, time, inputs={'pump': table[:, column]},
            outputs={'level': table[:, column + 2]}, coordinates={'pump': table[:, column]})
        for column, name in enumerate(('estimation', 'validation'))
    ]
    return model, runs[0], runs[1]


@nb.njit(cache=True)
def exchanger(flow, start, law, extra):  # type: ignore[no-untyped-def]
    """Outlet temperature (N,): two lags after a delay, linear in the flow but for `extra`.

    law: temperature at the mean flow, its change with flow, two time constants [s], delay [s].
    extra: curvature of the change; share by which the lags shorten with flow; drift [K / h].
    """
    level, gain, first, second, delay = law
    curve, quicker, drift = extra
    seen = np.empty(flow.size)
    one = two = start
    mean = flow.mean()
    for n in range(flow.size):
        late = max(n - delay, 0.0)
        low = int(late)
        part = late - low
        apart = (1.0 - part) * flow[low] + part * flow[min(low + 1, flow.size - 1)] - mean
        aim = level + gain * apart + curve * apart * apart
        faster = max(1.0 + quicker * apart, 0.1)
        seen[n] = two + drift * n / 3600.0
        one += (aim - one) * (1.0 - np.exp(-faster / first))
        two += (one - two) * (1.0 - np.exp(-faster / second))
        if not np.isfinite(two):
            break
    return seen


def heat_exchanger(file: Path, without: str) -> tuple[Model, Run, Run]:
    """A linear model of the exchanger; hidden is that its gain falls as the flow rises."""
    table = np.genfromtxt(file, delimiter=',', skip_header=1)

    def simulate(p: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        law = np.array([p['level'], p['gain'], p['first'], p['second'], p['delay']])
        extra = np.array([p.get('curve.size', 0.0), p.get('quicker.share', 0.0),
                          p.get('drift.rate', 0.0)])
        start = float(np.asarray(run.inputs['start']))
        return {'temperature': exchanger(np.asarray(run.inputs['flow']), start, law, extra)}

    effects = {
        'curve': Effect('Gain that changes with the flow', {'size': Parameter(-60, 60)}),
        'quicker': Effect('Lags that shorten as the flow rises', {'share': Parameter(-1.5, 4)}),
        'drift': Effect('Drift', {'rate': Parameter(-10, 10, unit='K/h')}),
    }
    effects.pop(without, None)
    model = Model(
        simulate,
        base={
            'level': Parameter(90, 103, unit='degC'), 'gain': Parameter(-30, 0),
            'first': Parameter(2, 80, unit='s', scale='log'),
            'second': Parameter(2, 80, unit='s', scale='log'),
            'delay': Parameter(0, 25, unit='s'),
        },
        effects=effects,
        channels={'temperature': Channel(unit='degC', model_error=0.005)},
    )
    runs = []
    for name, part in (('samples 100 to 2000', slice(100, 2000)),
                       ('samples 2000 to 4000', slice(2000, 4000))):
        flow, seen = table[part, 1], table[part, 2]
        runs.append(Run(name, table[part, 0], {'flow': flow, 'start': float(seen[:3].mean())},
                        {'temperature': seen}, {'flow': flow}))
    return model, runs[0], runs[1]


SETS = {'dataBenchmark.csv': cascaded_tanks, 'exchanger.csv': heat_exchanger}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--without', default='', help='effect taken out of the catalogue')
    args = parser.parse_args()
    found = [name for name in SETS if (args.folder / name).is_file()]
    if not found:
        print(f'{args.folder}: holds none of {", ".join(SETS)}: see docs/benchmarks for sources',
              file=sys.stderr)
        return 2
    for name in found:
        model, run, held_out = SETS[name](args.folder / name, args.without)
        began = clock.process_time()
        answer = diagnose(model, [run], hold_out=[held_out])
        print(f'{name}: {run.time.size} samples, {clock.process_time() - began:.0f} s')
        print(answer.summary())
        for prediction in answer.runs:
            measured = np.asarray(prediction.run.channels[0])
            rms = [float(np.sqrt(np.nanmean((item[0] - measured) ** 2)))
                   for item in (prediction.before, prediction.after)]
            print(f'  {prediction.run.name}: rms {rms[0]:.4g} without, {rms[1]:.4g} with')
        if answer.law is not None:
            print(f'  law: {answer.law.term.target} over {answer.law.term.coordinate}, '
                  f'{answer.law.term.law}, gain {answer.law.fit:.2f}, '
                  f'held out {answer.law.held_out}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
