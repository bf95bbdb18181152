"""Changes of dirty rings between two sessions: is what changed named, and nothing else?

    python benchmarks/changes.py [--kind third|near|none|moved] [--seed 1300] [--pairs 40]
                                 [--limits] [--waves 0] [--out FILE.jsonl] [--table]

The rings are those of dirty_ring.py. Their many small errors are the same in both sessions, and
the noise of the instruments is new. third: one cause of the catalogue appears in the later
session, at a third of the size that one session names; each pair has a ring of its own. none:
nothing changes. moved: nothing but the rollers, which stand elsewhere in the later session, with
gaps of 1.5 um rms and stiffnesses of 3 %. near: 0.8 to 1.5 times the smallest change that an
unchanged pair of the ring could show, five causes to a ring. Each has a twin whose noise has the
opposite sign, so that the error by noise cancels in their mean and the bias is left. Errors of
sizes are in stated standard deviations, positive if a size is too large. --waves: rms [um] of the
waves of each raceway beside the small errors, of 1 to 16 maxima whose amplitudes fall as 1/m.
--limits: also those of the later session alone, which take as long as the verdict.
"""

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
import tempfile
import time as clock

from dirty_ring import dirty_fault, hidden_in, MAIN
from frame import arguments, keep, kept_rows, share
from independent import draw_ring, RIG, write
from independent_faults import Hidden
from independent_ring import Fault, Noise, record, Ring, usual_courses
import numpy as np

from saddlering_ros import compare, read_bag
from saddlering_ros.comparison import change
from saddlering_ros.comparison.change import Change

TESTS = ('static_50', 'dynamic_50', 'static_70')
LATER, UNCHANGED = 40, 400
"""Number of the first bag of a later session: a quarter of an hour each."""

CAUSES_OF_A_RING = 5


@dataclass(frozen=True)
class Pair:
    """One pair of sessions: what was hidden, the verdict, the size of a right first cause.

    seed: of the ring; twin: whether the noise has the opposite sign; gain: how much lower the
    median limit of the change is than that of the later session alone, 0 if not computed; waves:
    rms [um] on each raceway.
    """

    kind: str
    number: int
    seed: int
    effect: str
    twin: bool
    verdict: str
    groups: list[list[str]]
    partial: bool = False
    true: float = 0.0
    value: float = 0.0
    std: float = 0.0
    gain: float = 0.0
    seconds: float = 0.0
    waves: float = 0.0

    @property
    def is_established(self) -> bool:
        return self.verdict in ('named', 'ambiguous')

    @property
    def is_right(self) -> bool:
        """The hidden cause is the name, or in the one group."""
        return self.is_established and len(self.groups) == 1 and self.effect in self.groups[0]

    @property
    def has_size(self) -> bool:
        """The hidden cause is the first, whose size is stated."""
        return self.is_right and self.groups[0][0] == self.effect

    @property
    def error(self) -> float:
        """Of the size, in stated deviations."""
        return (self.value - self.true) * float(np.sign(self.true)) / self.std


def with_own_rollers(ring: Ring, fault: Fault, seed: list[int]) -> tuple[Ring, Fault]:
    """The ring with other rollers, at any angle."""
    draw, usual = np.random.default_rng(seed), (fault.gap_axial, fault.gap_radial)
    gaps = [1.5e-6 * draw.standard_normal(row.rollers) for row in (RIG.axial_rows, RIG.radial_row)]
    axial, radial = draw.uniform(size=2).tolist()
    return replace(ring, scatter=0.03, seed=int(draw.integers(2**31)), phases=(axial, radial)), (
        replace(fault, gap_axial=lambda angle: gaps[0] + (usual[0](angle) if usual[0] else 0.0),
                gap_radial=lambda angle: gaps[1] + (usual[1](angle) if usual[1] else 0.0)))


def session(seed: int, hidden: Hidden, noise: Noise, draw: int, first: int, folder: Path,
            waves: float, moves: bool) -> list:
    """The bags of one session of the ring of a seed, read; draw: of the noise."""
    ring, _ = draw_ring(seed)
    fault = dirty_fault(hidden, seed, waves)
    if moves:
        ring, fault = with_own_rollers(ring, fault, [seed, 15, first])
    courses = [course for course in usual_courses(RIG) if course.name in TESTS]
    paths = [write(record(ring, fault, course, 1000 * draw + first + number, noise),
                   first + number, folder / str(first)) for number, course in enumerate(courses)]
    return [read_bag(path, rig=RIG) for path in paths]


def compared(
    seed: int, hidden: Hidden, noise: Noise, draw: int, later: int, waves: float,
    moves: bool = False,
) -> Change:
    """The comparison of two sessions of a ring; the hidden cause is in the later one."""
    with tempfile.TemporaryDirectory() as folder:
        before = session(seed, hidden_in('', seed), noise, draw, 0, Path(folder), waves,
                         moves)
        after = session(seed, hidden, noise, draw, later, Path(folder), waves, moves)
        return compare(before, after, rig=RIG).change


@cache
def limits(seed: int, waves: float) -> dict[str, float]:
    """The smallest change of each cause that is named, from an unchanged pair of a ring."""
    found = compared(seed, hidden_in('', seed), draw_ring(seed)[1], seed, UNCHANGED, waves)
    return {item.effect: max(item.limit, item.material_limit)
            for item in found.diagnosis.observability.limits}


def size_of(hidden: Hidden) -> float:
    """The size of a cause, which is its first parameter; 0 of none."""
    return float(next(iter(hidden.parameters.values()), 0.0))


def trial(kind: str, number: int, seed: int, effect: str, twin: bool, waves: float) -> Pair:
    """One pair of sessions and its verdict."""
    began = clock.process_time()
    noise, part, ring = draw_ring(seed)[1], 1.0 / 3.0, dirty_fault(hidden_in('', seed), seed)
    # The friction of the ring itself in whose place that of a hidden cause stands.
    own = {'radial_friction': ring.friction_x.total,
           'tilt_friction': ring.friction_tilt.total}.get(effect, 0.0)
    if kind == 'near':
        times = np.random.default_rng([seed, 21, MAIN.index(effect)]).uniform(0.8, 1.5)
        wanted = float(times * limits(seed, waves)[effect] + own)
        part = wanted / abs(size_of(hidden_in(effect, seed)))
    if twin:
        noise = replace(noise, load=-noise.load, probe=-noise.probe, slow=-noise.slow)
    hidden = hidden_in(effect, seed, part)
    found = compared(seed, hidden, noise, seed + 7919 * number * (kind == 'near'), LATER,
                     waves, kind == 'moved')
    causes = found.diagnosis.causes if found.verdict != 'none' else ()
    size = next(iter(causes[0].parameters.values())) if causes else None
    ratios = [found.limits_alone[item.effect] / max(item.limit, 1e-300)
              for item in found.diagnosis.observability.limits
              if found.limits_alone.get(item.effect) and item.limit]
    return Pair(kind, number, seed, effect, twin, found.verdict,
                [list(cause.group) for cause in causes],
                any(cause.partial for cause in causes), size_of(hidden) - own,
                size.value if size else 0.0, size.std if size else 0.0,
                float(np.median(ratios)) if ratios else 0.0, clock.process_time() - began, waves)


def plan(kind: str, seed: int, pairs: int) -> list[tuple[int, int, str, bool]]:
    """Number, ring, hidden cause and sign of the noise of every pair."""
    return [(number, seed + (number // CAUSES_OF_A_RING if kind == 'near' else number),
             '' if kind in ('none', 'moved') else MAIN[number % len(MAIN)], twin)
            for number in range(pairs) for twin in ((False, True) if kind == 'near' else (False,))]


def bias(rows: Sequence[Pair]) -> str:
    """Mean and median error of the sizes, twins averaged, with 95 % intervals over the rings."""
    twins: dict[tuple[int, int], list[float]] = {}
    for row in rows:
        twins.setdefault((row.seed, row.number), []).append(row.error)
    rings = [[np.mean(own) for (seed, _), own in twins.items() if seed == ring]
             for ring in sorted({seed for seed, _ in twins})]
    draw = np.random.default_rng(27)
    again = [np.concatenate([rings[i] for i in draw.integers(len(rings), size=len(rings))])
             for _ in range(4000)]
    said = []
    for name, figure in (('mean', np.mean), ('median', np.median)):
        low, high = np.quantile([figure(one) for one in again], (0.025, 0.975))
        said.append(f'{name} {figure(np.concatenate(rings)):+.2f} ({low:+.2f} to {high:+.2f})')
    errors = np.array([row.error for row in rows])
    return (f'{errors.size} sizes of {len(twins)} changes of {len(rings)} rings: '
            f'{", ".join(said)} std, rms {np.sqrt(np.mean(errors**2)):.2f}, beyond two '
            f'{share(np.abs(errors) > 2.0)}')


def report(rows: Sequence[Pair]) -> None:
    """Print every rate of the kept pairs."""
    for kind in ('third', 'near'):
        changed = [row for row in rows if row.kind == kind]
        named = [row for row in changed if row.has_size]
        if not changed:
            continue
        print(f'{kind}: right {share(row.is_right for row in changed)}, of these first '
              f'{len(named)}, alone {sum(row.verdict == "named" for row in named)}')
        print('    wrong:', share(row.is_established and not row.is_right for row in changed))
        for words, own in (('first', named),
                           ('alone', [row for row in named if row.verdict == 'named'])):
            if own:
                print(f'    {words}: {bias(own)}')
    for kind in ('none', 'moved'):
        unchanged = [row for row in rows if row.kind == kind]
        if not unchanged:
            continue
        print(f'{kind}, accused:', share(row.is_established for row in unchanged), 'none:',
              share(row.verdict == 'none' for row in unchanged))
    gains = [row.gain for row in rows if row.gain]
    if gains:
        print(f'limits lower by {np.median(gains):.1f} ({min(gains):.1f} to {max(gains):.1f})')


def main() -> None:
    args = arguments(__doc__, {'kind': 'none', 'pairs': 1}, kind='third', seed=1300, pairs=40,
                     limits=False, waves=0.0, out=Path('out/changes.jsonl'), table=False)
    if not args.limits:
        change._limits_alone = lambda *_: {}
    known = {(row['kind'], row['number'], row['seed'], row['twin'], row.get('waves', 0.0))
             for row in kept_rows(args.out)}
    for number, seed, effect, twin in () if args.table else plan(args.kind, args.seed, args.pairs):
        if (args.kind, number, seed, twin, args.waves) in known:
            continue
        pair = trial(args.kind, number, seed, effect, twin, args.waves)
        keep(args.out, asdict(pair))
        print(f'{pair.kind} {seed} {effect or "none"}{" twin" if twin else ""}: {pair.verdict} '
              f'{pair.groups}', f'{pair.error:+.2f} std' if pair.has_size else '',
              f'{pair.seconds:.0f} s', flush=True)
    report([pair for pair in (Pair(**row) for row in kept_rows(args.out))
            if pair.waves == args.waves])


if __name__ == '__main__':
    main()
