"""Do intervals of identify hold the truth of drawn rigs, and is another test predicted?

    python benchmarks/identification.py [--rigs 200] [--scatter]
                                        [--small-errors] [--waves 0] [--phases] [--seed 1]

Each rig is drawn from the whole box of contact laws. It is identified from a static and a dynamic
run at 50 deg and a static run at 70 deg, and a dynamic run at 70 deg is predicted. Counted are
95 % intervals that hold the truth (target: 90 to 99 % for every parameter) and predictions with
nrmse within 1.1 times the noise floor; what the true parameters reach stands beside them. With
--scatter the rollers differ as made ones do. With --waves or --small-errors the rings are those of
independent_ring.py, whose raceways wave by this rms [um], or which have all small errors of
dirty_ring.py: the first has the number --seed. With --phases the rollers of these rings, which
may be even ones then, begin at any angle, as those of real rings do.
"""

from dataclasses import dataclass, replace
from pathlib import Path
import tempfile
import time

from dirty_ring import dirty_fault, NOTHING, wavy
from frame import arguments
from independent import draw_ring, write
from independent_ring import Fault, record, usual_courses
import numpy as np
from numpy.typing import NDArray
from rigs import drawn_contact, NO_SCATTER, RIG, virtual_run

from saddlering_ros.bags.reader import read_run
from saddlering_ros.identification.methods import identify
from saddlering_ros.identification.result import FittedLaw
from saddlering_ros.identification.settings import IdentificationSettings
from saddlering_ros.identification.validation import validate
from saddlering_ros.quantities import WIDTH_95
from saddlering_ros.rig import PARAMETER_NAMES, ParameterSet
from saddlering_ros.virtual_rig.integrator import Scatter

Array = NDArray[np.float64]
LOGARITHMIC = np.array([name[0] in 'KD' for name in PARAMETER_NAMES])
PLAN = (('static', 50.0), ('dynamic', 50.0), ('static', 70.0), ('dynamic', 70.0))
"""Tests of a rig; the last is predicted."""


@dataclass(frozen=True)
class Rig:
    """One drawn rig: errors over stated errors (6,), which parameters are determined (6,).

    ratios: by channel the nrmse of the prediction over the noise floor, identified and true.
    """

    score: Array
    determined: Array
    ratios: dict[str, tuple[float, float]]
    seconds: float


def one_rig(number: int, scatter: Scatter) -> Rig:
    """Draw, identify and predict."""
    random = np.random.default_rng([2020, number])
    contact = drawn_contact(random)
    noise = 1e-6 * 10.0 ** random.uniform(-1.0, 0.0)
    runs = [
        virtual_run(test, elevation, contact, seed=int(random.integers(2**31)), noise=noise,
                    scatter=scatter)
        for test, elevation in PLAN
    ]
    began = time.process_time()
    found = identify(runs[:-1], RIG, IdentificationSettings(seed=number))
    seconds = time.process_time() - began
    truth, value = contact.to_array(), found.parameters.contact.to_array()
    off = np.where(LOGARITHMIC, value * np.log(value / truth), value - truth)
    predicted, best = (
        validate(runs[-1:], RIG, parameters).runs[0].channels
        for parameters in (found.parameters, ParameterSet(contact)))
    ratios = {
        name: (figures.nrmse / figures.noise_floor, best[name].nrmse / best[name].noise_floor)
        for name, figures in predicted.items() if name != 'parity'
    }
    return Rig(off / np.sqrt(np.diag(found.parameters.source.covariance)),
               np.array([found.determined[name] for name in PARAMETER_NAMES]), ratios, seconds)


Errors = tuple[Array, Array, Array]
"""Errors (6,) of ln K, n, ln D, those over stated ones, and which are determined."""


def real_ring(number: int, fault: Fault, phases: tuple[float, float]
              ) -> tuple[Errors, Errors | None]:
    """Errors of the law of even raceways, and of that beside waves of the raceways."""
    ring, noise = draw_ring(number)
    ring = replace(ring, phases=phases)
    with tempfile.TemporaryDirectory() as folder:
        runs = [read_run(write(record(ring, fault, course, number + 31 * place, noise), place,
                               Path(folder)))
                for place, course in enumerate(usual_courses(RIG)[:-1])]
    found = identify(runs, RIG, IdentificationSettings(seed=number))
    truth = np.array([float(getattr(ring, name)) for name in PARAMETER_NAMES])
    beside = found.beside_errors
    return errors_of(found, truth), None if beside is None else errors_of(beside, truth)


def phases_of(number: int) -> tuple[float, float]:
    """Angles of the first rollers of a ring, any alike."""
    axial, radial = np.random.default_rng([number, 14]).uniform(size=2).tolist()
    return axial, radial


def errors_of(found: FittedLaw, truth: Array) -> Errors:
    value = found.contact.to_array()
    off = np.where(LOGARITHMIC, np.log(value / truth), value - truth)
    stated = np.sqrt(np.diag(found.covariance)) / np.where(LOGARITHMIC, value, 1.0)
    return off, off / stated, np.array([found.determined[name] for name in PARAMETER_NAMES])


def report_real(title: str, rings: list[Errors]) -> None:
    """Print how many intervals hold, of determined parameters and of all."""
    print(f'{title}: {len(rings)} rings')
    if not rings:
        return
    print(f'{"parameter":10s} {"determined":>10s} {"95 % holds":>11s} {"of all":>8s} '
          f'{"rms z":>8s} {"rms error":>10s}')
    off, score, determined = (np.array(part) for part in zip(*rings, strict=True))
    holds = np.abs(score) <= WIDTH_95
    for column, name in enumerate(PARAMETER_NAMES):
        own = determined[:, column]
        print(f'{name:10s} {own.sum():10d} {holds[own, column].sum():11d} '
              f'{holds[:, column].sum():8d} {np.sqrt(np.mean(score[:, column]**2)):8.2f} '
              f'{np.sqrt(np.mean(off[:, column]**2)):10.4f}')


def report(rigs: list[Rig]) -> None:
    """Print how many intervals hold, and how well the fourth run is predicted."""
    print(f'{len(rigs)} virtual rigs, {np.mean([rig.seconds for rig in rigs]):.2f} s each')
    print(f'{"parameter":10s} {"determined":>10s} {"95 % holds":>11s} {"rms z":>8s}')
    score = np.array([rig.score for rig in rigs])
    determined = np.array([rig.determined for rig in rigs])
    for column, name in enumerate(PARAMETER_NAMES):
        own = score[determined[:, column], column]
        held = 100.0 * np.mean(np.abs(own) <= WIDTH_95)
        print(f'{name:10s} {len(own):10d} {held:10.1f}% {np.sqrt(np.mean(own**2)):8.2f}')
    print('nrmse over noise floor of the predicted run')
    print(f'{"channel":10s} {"median":>8s} {"worst":>8s} {"<= 1.1":>8s} {"truth, worst":>13s}')
    for name in rigs[0].ratios:
        own, true = np.array([rig.ratios[name] for rig in rigs]).T
        print(f'{name:10s} {np.median(own):8.3f} {own.max():8.3f} '
              f'{100.0 * np.mean(own <= 1.1):7.0f}% {true.max():13.3f}')


def main() -> None:
    args = arguments(__doc__, {'rigs': 5}, rigs=200, scatter=False, small_errors=False,
                     waves=0.0, phases=False, seed=1)
    if args.waves or args.small_errors or args.phases:
        numbers = range(args.seed, args.seed + args.rigs)
        rings = [real_ring(
            number, dirty_fault(NOTHING, number, args.waves) if args.small_errors else
            wavy(Fault(), number, args.waves), phases_of(number) if args.phases else (0.0, 0.0))
            for number in numbers]
        report_real('even raceways', [even for even, _ in rings])
        report_real('beside waves', [beside for _, beside in rings if beside is not None])
        return
    scatter = Scatter() if args.scatter else NO_SCATTER
    report([one_rig(number, scatter) for number in range(args.rigs)])


if __name__ == '__main__':
    main()
