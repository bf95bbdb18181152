"""Do intervals with instruments drawn from their certificates hold, and is the budget right?

    python benchmarks/certificates.py [--what coverage] [--count 300]     over drawn rigs
    python benchmarks/certificates.py --what budget [--count 150]     sources against Monte Carlo
    python benchmarks/certificates.py --what gain [--count 40]     a gain of five certificates

The errors are applied to the readings and to the true rig, apart from the code that counts them.
The tests are two static ones, which determine K and n. `budget` fits the readings of one ring
again with every draw (JCGM 101), with the whole identification, so that nothing is linearised.
Its shares by source are those of a regression on the draws, which are a Latin hypercube. In `gain`
contact, rollers, friction and errors within the certificates are drawn for each ring, and its
later session has the gain. Rows are kept in --out, and a campaign goes on where it stopped.
"""

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

from dataclasses import replace
import math
from pathlib import Path
import sys

from frame import arguments, keep, kept_rows, share
import numpy as np
from rigs import NO_SCATTER, RIG, virtual_run
from scipy.stats import norm
from scipy.stats.qmc import LatinHypercube

from saddlering_ros import compare, rig
from saddlering_ros.identification.methods import identify
from saddlering_ros.identification.result import Identification
from saddlering_ros.identification.settings import IdentificationSettings
from saddlering_ros.quantities import WIDTH_95
from saddlering_ros.record.record import Record
from saddlering_ros.rig import ContactParameters, PARAMETER_NAMES, Rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.ring.small_errors import GAP_SCATTER, STIFFNESS_SCATTER
from saddlering_ros.virtual_rig.effects import request
from saddlering_ros.virtual_rig.integrator import Scatter

STATED = rig.Instruments(
    load_gain=1e-3, load_offset=30.0, load_nonlinearity=3e-4, elevation=2e-4,
    probe_gain=(1e-3,) * 4, clearance=1e-6, weight=2e-3, trunnion=5e-4, axial_span=3e-4,
    radial_height=3e-4)
CERTIFIED = replace(RIG, instruments=STATED)
SOURCES = ('load_gain', 'load_offset', 'load_nonlinearity', 'elevation', 'probe_gain_1',
           'probe_gain_2', 'probe_gain_3', 'probe_gain_4', 'clearance_axial', 'clearance_radial',
           'weight', 'trunnion_x', 'trunnion_y', 'axial_span', 'radial_height')
SCATTER = Scatter(GAP_SCATTER, STIFFNESS_SCATTER)
"""Unequal rollers as large as an identification assumes."""

LOGARITHMIC = np.array([name[0] in 'KD' for name in PARAMETER_NAMES])


def spread(source: str) -> float:
    """Standard uncertainty of a source."""
    name = source.rstrip('_1234')
    for ending in ('_axial', '_radial', '_x', '_y'):
        name = name.removesuffix(ending) if name != 'axial' else name
    stated = getattr(STATED, name)
    return float(stated[0]) if isinstance(stated, tuple) else float(stated)


def true_rig(errors: dict[str, float]) -> Rig:
    """The rig as it is, where the certificates state RIG with these errors."""
    return replace(
        RIG,
        axial_rows=replace(RIG.axial_rows,
                           clearance=RIG.axial_rows.clearance + errors['clearance_axial']),
        radial_row=replace(RIG.radial_row,
                           clearance=RIG.radial_row.clearance + errors['clearance_radial']),
        carriage=replace(RIG.carriage, weight=RIG.carriage.weight * (1.0 + errors['weight'])),
        trunnion=replace(RIG.trunnion, x=RIG.trunnion.x + errors['trunnion_x'],
                         y=RIG.trunnion.y + errors['trunnion_y']),
        probes=replace(RIG.probes, axial_span=RIG.probes.axial_span + errors['axial_span'],
                       radial_height=RIG.probes.radial_height + errors['radial_height']))


def recorded(test: str, degrees: float, contact: ContactParameters, errors: dict[str, float],
             seed: int, noise: float, number: int = 1) -> Record:
    """A test of the true rig as its instruments read it; 1: of the rig without scatter."""
    run = virtual_run(test, degrees + math.degrees(errors['elevation']), contact, seed=seed,
                      noise=noise, rig=true_rig(errors), number=number,
                      scatter=NO_SCATTER if number == 1 else SCATTER, quantised=number != 1)
    full, load = RIG.full_scale_load, run.load
    bend = 4.0 * load * (full - load) / full
    read = load * (1.0 + errors['load_gain']) + errors['load_offset'] + (
        errors['load_nonlinearity'] * bend)
    gains = np.array([errors[f'probe_gain_{number}'] for number in (1, 2, 3, 4)])
    gaps = run.gaps[:, :1] + (1.0 + gains)[:, None] * (run.gaps - run.gaps[:, :1])
    return replace(run, load=read, gaps=gaps, elevation=math.radians(degrees))


def drawn(random: np.random.Generator) -> dict[str, float]:
    return {source: spread(source) * float(random.standard_normal()) for source in SOURCES}


def off(value: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distance in ln K, n, ln D."""
    return np.where(LOGARITHMIC, np.log(value / truth), value - truth)


def contact_of(random: np.random.Generator) -> ContactParameters:
    """K and D within a factor of 1.6 of the usual ones."""
    return ContactParameters(*TRUE_TO_SCALE.to_array() * np.where(
        LOGARITHMIC, np.exp(random.uniform(-0.5, 0.5, 6)), 1.0))


def coverage(rigs: int, file: Path) -> None:
    """Share of 95 % intervals of rigs with drawn instruments that hold the true parameter."""
    for number in range(len(kept_rows(file)), rigs):
        random = np.random.default_rng([2700, number])
        contact, errors = contact_of(random), drawn(random)
        runs = [recorded(test, degrees, contact, errors, int(random.integers(2**31)), 0.3e-6,
                         number + 2)
                for test, degrees in (('static', 50.0), ('static', 70.0))]
        found = identify(runs, CERTIFIED, IdentificationSettings(seed=number))
        value = found.parameters.contact.to_array()
        std = np.sqrt(np.diag(found.covariance))
        score = off(value, contact.to_array()) / np.where(LOGARITHMIC, std / value, std)
        keep(file, {name: float(one) for one, name in zip(score, PARAMETER_NAMES, strict=True)
                    if found.determined[name]})
    for name in PARAMETER_NAMES:
        own = np.array([row[name] for row in kept_rows(file) if name in row])
        print(f'{name}: {share(np.abs(own) <= WIDTH_95)}, '
              f'rms {np.sqrt(np.mean(own**2)) if own.size else math.nan:.2f}')


def budget(draws: int, _: Path) -> None:
    """Deviation by source of K, n and D in the budget and by Monte Carlo."""
    contact, sound = TRUE_TO_SCALE, dict.fromkeys(SOURCES, 0.0)
    tests = (('static', 50.0), ('static', 70.0))

    def fit(errors: dict[str, float]) -> Identification:
        return identify([recorded(test, degrees, contact, errors, 1, 1e-8)
                         for test, degrees in tests], CERTIFIED)

    stated = fit(sound)
    centre = stated.parameters.contact.to_array()
    std = np.sqrt(np.diag(stated.covariance)) / np.where(LOGARITHMIC, centre, 1.0)
    inputs = norm.ppf(LatinHypercube(len(SOURCES), seed=101).random(draws))
    moved = np.array([
        off(fit({source: spread(source) * float(one)
                 for source, one in zip(SOURCES, row, strict=True)}
                ).parameters.contact.to_array(), centre) for row in inputs])
    slopes = np.linalg.lstsq(inputs, moved, rcond=None)[0]
    for column, name in enumerate(PARAMETER_NAMES):
        if name[0] == 'D':
            continue
        shares = stated.budget[name]
        of_instruments = std[column] * math.sqrt(sum(shares[source] for source in SOURCES))
        by_draws = float(np.std(moved[:, column]))
        print(f'{name}: budget {of_instruments:.3g}, Monte Carlo {by_draws:.3g} '
              f'({100.0 * (of_instruments / by_draws - 1.0):+.1f} %)')
        for source, slope in zip(SOURCES, slopes[:, column], strict=True):
            own = std[column] * math.sqrt(shares[source])
            if own > 0.1 * of_instruments:
                print(f'    {source}: {own:.3g}, {abs(slope):.3g} '
                      f'({100.0 * (own / abs(slope) - 1.0):+.1f} %)')


def gain(pairs: int, file: Path) -> None:
    """How often a load gain of five times its certificate is found between two sessions."""
    sys.path[:0] = [str(Path(__file__).parents[1] / place) for place in ('.', 'test/comparison')]
    from sessions_made import session

    for number in range(len(kept_rows(file)), pairs):
        random = np.random.default_rng([2701, number])
        contact, own = contact_of(random), drawn_dirt(random)
        grown = {**own, 'load_gain': own['load_gain'] + (5e-3 if number % 2 else -5e-3)}
        before, after = (
            session(10 + 2 * number + day, [
                request(name, {request(name).effect.parameters[0].name: size})
                for name, size in sizes.items()], contact=contact, rollers=number, step=TONNE)
            for day, sizes in enumerate((own, grown)))
        found = compare(before, after, rig=CERTIFIED).to_json()
        named = [cause['group'] for cause in found['causes']]
        right = found['verdict'] in ('named', 'ambiguous') and 'load_gain' in named[0]
        keep(file, {'verdict': found['verdict'], 'groups': named, 'right': right})
        print(number, found['verdict'], named, found['headline'], flush=True)
    print('found:', share(row['right'] for row in kept_rows(file)))


def drawn_dirt(random: np.random.Generator) -> dict[str, float]:
    """Errors within the certificates, and friction, which both sessions have."""
    spreads = {'load_gain': STATED.load_gain, 'load_offset': STATED.load_offset,
               'elevation_error': STATED.elevation, 'moment_arm': STATED.trunnion,
               'probe_height': STATED.radial_height}
    errors = {name: (size or 0.0) * random.standard_normal() for name, size in spreads.items()}
    friction = {name: 350.0 * abs(random.standard_normal())
                for name in ('radial_friction', 'cylinder_friction')}
    return {**errors, **friction}


WHAT = {'coverage': (coverage, 300), 'budget': (budget, 150), 'gain': (gain, 40)}
"""Each campaign and its usual number of rigs, draws or pairs."""


def main() -> None:
    args = arguments(__doc__, {'count': 1}, what='coverage', count=0, out=Path)
    campaign, count = WHAT[args.what]
    campaign(args.count or count, args.out or Path('out') / f'certificates_{args.what}.jsonl')


if __name__ == '__main__':
    main()
