"""Readings that suggest that a probe is wired wrongly, stuck or dead, each with its evidence.

The checks use no identified model, only properties of any ring on this rig. Probes 1 and 3 face
each other, so that one gap opens as the other closes. A load moves each probe to a side that
follows from the forces at C (rig.resolve_load), whatever the stiffness. The ring is a set of
rollers on a circle of radius R, with a tilting stiffness of R^2/2 times its axial stiffness.

Faults of a few percent (a gain, a bracket that gives way, clipping at the end of a range) are
effects for the diagnosis. Here a probe moves to the wrong side, not at all, or like another one.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from saddlering_ros.doubts import Finding
from saddlering_ros.quantities import quantity
from saddlering_ros.record.batches import Floats, Mask
from saddlering_ros.record.quality import white_noise
from saddlering_ros.record.record import Record
from saddlering_ros.record.scratch import blocks, complete_rows, spread
from saddlering_ros.rig import FORCE_UNITS, Rig
from saddlering_ros.rig.geometry import gap_increment, resolve_load

MIN_LOAD_SPAN = 0.1
"""Share of the full-scale load that a run must cover for a judgement."""

CLEAR_SIDE = 0.25
"""Smallest share of the largest motion at which the side of a probe is certain."""

OPPOSITE_LIMIT = 0.1
"""Sum of the motions of probes 1 and 3 (rms, signed) over their difference from which on they do
not mirror each other. A clock or a draught of one of them hardly changes its motion."""

STUCK_SAMPLES = 20
"""Fewest samples of a probe that is stuck: a converter may repeat a few of a slow motion."""

STUCK_SHARE = 0.05
"""Share of the load's span that passes while a reading stands still."""

DEAD_SHARE = 0.02
"""Share of the largest motion below which a probe does not follow the load."""

FOLLOWING = 2.0
"""Motion of a probe by the load, over its noise (rms), below which none follows if no other moves
more. The stiffest ring of the bounds moves one by 0.9 µm and more in a tenth of full scale."""

LOAD_STUCK_SHARE = 0.25
"""Share of the largest motion that passes while the load stands still to the last digit. Creep at
a hold, with a converter of few bits, moves a probe by less."""

TOO_STIFF = 0.3
"""Largest motion of a probe, over that of the stiffest ring of the bounds without clearance, below
which a unit is wrong. 500 sound rings of 1 to 400 t, the largest five times as stiff as their
bounds, have 0.43 and more."""

MIRROR_LIMIT = 0.06
"""Sum of two probes, as a share of their difference (rms), up to which they mirror each other."""

EXCHANGE_SIZE = 8.0
"""Change of each reading at an exchange, as a multiple of the usual change over ROWS: 1.4 at most
in 25 bags without one."""


def wiring_findings(rig: Rig, elevation: float, load: Floats, gaps: Floats) -> list[Finding]:
    """Probable faults in gaps (4, N) [m] over load (N,) [N] at `elevation` [rad]."""
    load, gaps = complete_rows(load, gaps)
    span = float(np.ptp(load)) if len(load) else 0.0
    if len(load) < STUCK_SAMPLES or span < MIN_LOAD_SPAN * rig.full_scale_load:
        return []
    increments = gap_increment(rig.probes, gaps, gaps[:, 0])
    around = load - load.mean()
    slope = (increments * around).sum(axis=1) / float((around ** 2).sum())
    motion = np.abs(slope) * span
    largest = float(motion.max())
    # Motion by a pushing load, up to a factor for probes 1 and 3 and one for 2 and 4.
    forces = resolve_load(rig, 1.0, elevation)
    radial, both = float(forces.force_x), float(forces.force_y)
    apart = float(forces.moment) * rig.probes.axial_span / rig.axial_rows.pitch_radius ** 2
    expected = np.array([radial, both + apart, -radial, both - apart])
    # The side is certain but for probes that hardly move at this elevation.
    axial = np.abs(expected[1::2]).max()
    clear = np.abs(expected) >= CLEAR_SIDE * np.array([1.0, axial, 1.0, axial])
    present = [number - 1 for number in rig.probes.present]
    noise = float(np.median([white_noise(gaps[probe]) for probe in present]))
    none_follows = largest < FOLLOWING * noise
    stuck, dead = [], []
    for probe in present:
        is_stuck = _stuck(rig, probe, load, gaps[probe])
        stuck += is_stuck
        is_dead = motion[probe] < DEAD_SHARE * largest and not none_follows
        if not is_stuck and clear[probe] and is_dead:
            dead.append(Finding(
                f'probe {probe + 1} does not follow the load: its reading changes by '
                f'{quantity(motion[probe], "m")} over {rig.force_words(span)}, that of another '
                f'probe by {quantity(largest, "m")}; check that the probe is connected and faces '
                'the ring'))
    copied = [Finding(f'probes {first + 1} and {second + 1} have the same readings throughout: '
                      'one channel is recorded twice: correct the driver or the map of the '
                      'import')
              for first, second in combinations(present, 2)
              if np.array_equal(gaps[first], gaps[second])]
    if stuck or dead or copied:
        return [*stuck, *dead, *copied]
    if none_follows:
        return [Finding(
            f'no probe follows the load: over {rig.force_words(span)} the readings change by '
            f'{quantity(largest, "m", digits=2)} at most, and their noise is '
            f'{quantity(noise, "m", digits=2)}: check that the probes are connected and face the '
            'ring, and that load and probes are of one test and one clock')]
    if held := _held_load(rig, present, load, gaps):
        return held
    least = float(np.max(_least_motions(rig, np.abs(expected) * span)))
    if largest < TOO_STIFF * least:
        return [Finding(
            f'no probe moves by more than {quantity(largest, "m", digits=2)} over '
            f'{rig.force_words(span)}, and even the stiffest ring of the bounds of K1 and K2 '
            f'moves one by {quantity(least, "m", digits=2)}: the unit or the scale of the probes '
            'is wrong (in a map of an import: unit, scale), or that of the load, or the bounds '
            'in the rig file')]
    return _mirrored(increments, slope) or _sides(rig, slope, expected, clear)


def _least_motions(rig: Rig, forces: Floats) -> Floats:
    """Motions [m] of four probes under forces (4,) [N], of the stiffest ring without clearance.

    A radial row pushes with half of its rollers, which share the force by their cosines.
    """
    axial, radial = rig.axial_rows.rollers, 0.25 * rig.radial_row.rollers
    bounds = rig.bounds
    stiffness = np.array([bounds['K2'][1] * radial, bounds['K1'][1] * axial] * 2)
    exponents = np.array([bounds['n2'][0], bounds['n1'][0]] * 2)
    return np.asarray((forces / stiffness) ** (1.0 / exponents))


def wiring_first(rig: Rig, runs: Sequence[Record]) -> str:
    """What to do about probable faults of wiring and units before any test; '' without any."""
    faults: dict[tuple[str, str], list[str]] = {}
    for run in runs:
        for finding in wiring_findings(rig, run.elevation, run.load, run.gaps):
            fault = finding.words.partition(':')[0]
            faults.setdefault(('wiring', fault), []).append(run.name)
        for unit in units_of_notes(run.notes):
            faults.setdefault(('units', f'readings look like {unit}'), []).append(run.name)
    return ' '.join(f'See to the {place} first: in {", ".join(names)} {fault}.'
                    for (place, fault), names in faults.items())


def units_of_notes(notes: Sequence[str]) -> list[str]:
    """Units that the readings of a record look like: 'lbf (the preload is ..)'."""
    return [note.units for note in notes if isinstance(note, Finding) and note.units]


def _longest_still(readings: Floats) -> slice:
    """The longest stretch of equal readings."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(readings) != 0.0) + 1, [len(readings)]])
    longest = int(np.argmax(np.diff(edges)))
    return slice(*edges[longest:longest + 2].tolist())


def _held_load(rig: Rig, present: Sequence[int], load: Floats, gaps: Floats) -> list[Finding]:
    """A finding if the load stands still while a probe of those present moves far."""
    rows = _longest_still(load)
    if rows.stop - rows.start < STUCK_SAMPLES:
        return []
    moved, whole = (np.ptp(np.percentile(part, [2.0, 98.0], axis=1), axis=0)
                    for part in (gaps[present][:, rows], gaps[present]))
    most = int(np.argmax(moved))
    if moved[most] < LOAD_STUCK_SHARE * whole.max():
        return []
    return [Finding(
        f'the load stays at {rig.force_words(float(load[rows.start]), 2)} while probe '
        f'{present[most] + 1} moves by {quantity(float(moved[most]), "m")}: the load cell or its '
        'channel is stuck, or at a limit')]


def _stuck(rig: Rig, probe: int, load: Floats, gap: Floats) -> list[Finding]:
    """The longest stretch of equal readings, if much load passes meanwhile."""
    rows = _longest_still(gap)
    low, high = float(load[rows].min()), float(load[rows].max())
    if rows.stop - rows.start < STUCK_SAMPLES or high - low < STUCK_SHARE * float(np.ptp(load)):
        return []
    return [Finding(
        f'probe {probe + 1} stays at {gap[rows.start] * 1e6:.2f} µm while the load changes from '
        f'{rig.force_range(low, high, 2)}: the probe is stuck, or at an end of its range')]


def _mirrored(increments: Floats, slope: Floats) -> list[Finding]:
    """Probes 1 and 3 must mirror each other; another pair that does shows swapped channels."""
    around = increments - increments.mean(axis=1, keepdims=True)
    # Rms of the sum of two probes over that of their difference: 0 if they mirror each other.
    unlikeness = {
        (first, second): float(np.sqrt(np.mean((around[first] + around[second]) ** 2))) / max(
            float(np.sqrt(np.mean((around[first] - around[second]) ** 2))), 1e-12)
        for first, second in combinations(range(4), 2) if (first, second) != (0, 2)}
    one, _, other, _ = (np.sign(slope) * around.std(axis=1)).tolist()
    opposite = abs(one + other) / max(abs(one - other), 1e-12)
    if opposite < OPPOSITE_LIMIT or opposite > 1.0 / OPPOSITE_LIMIT:
        return []  # They do, or move to the same side: `_sides` judges that.
    (first, second), least = min(unlikeness.items(), key=lambda pair: pair[1])
    if least > MIRROR_LIMIT or least > opposite / 3.0:
        return []
    # One radial probe has its own channel: the other is read where its partner should be.
    cables = sorted({0, 2} ^ {first, second})
    swapped = (f'{cables[0] + 1} and {cables[1] + 1} look swapped' if len(cables) == 2 else
               '1 and 3 look swapped with those of 2 and 4')
    return [Finding(
        f'channels of probes {swapped}: {first + 1} and {second + 1} mirror each other (their sum '
        f'is {100 * least:.1f} % of their difference), and the motions of 1 and 3, which should, '
        f'do not ({100 * opposite:.0f} %)')]


def _sides(rig: Rig, slope: Floats, expected: Floats, clear: Mask) -> list[Finding]:
    """A finding on probes that move to the wrong side; slope [m/N] of each."""
    wrong = np.flatnonzero(clear & (slope * expected < 0.0)).tolist()
    if not wrong:
        return []
    per_unit = 1e6 * FORCE_UNITS[rig.force_unit]
    slopes = ', '.join(
        f'{slope[probe] * per_unit:+.2f} where '
        f'{"+" if expected[probe] > 0 else "-"} is due (probe {probe + 1})' for probe in wrong)
    if len(wrong) == int(clear.sum()):
        guess = ('all probes have the opposite sign: the sign of the load, every polarity, or '
                 'the elevation is wrong')
    elif wrong in ([0, 2], [1, 3]) and not (rig.probes.absent and wrong[0] == 0):
        guess = (f'probes {wrong[0] + 1} and {wrong[1] + 1} look swapped, or both of the wrong '
                 'polarity')
    else:
        wrong = [probe for probe in wrong if probe + 1 in rig.probes.present]
        names = ' and '.join(str(probe + 1) for probe in wrong)
        guess = f'wrong polarity of probe{"s" * (len(wrong) > 1)} {names} (rig.probes.polarity)'
    return [Finding(f'{guess}: µm per {rig.force_unit} {slopes}')]


ROWS, USUAL_SHARE = 2, 0.99
"""Rows over which readings are compared, because one may be interpolated across the exchange; and
share of the rows that the usual change over them covers."""

MATCH = 0.1
"""Largest difference from the earlier reading of the other probe, as a share of the change."""


def exchange_findings(rig: Rig, time: Floats, load: Floats, gaps: Floats) -> list[Finding]:
    """A finding for each pair of probes (of gaps (4, N)) that exchange their readings at rest."""
    exchanges: dict[tuple[int, int], float] = {}
    changes = [np.abs(sample[ROWS:] - sample[:-ROWS]) for sample in map(spread, gaps)]
    finite = [change[np.isfinite(change)] for change in changes]
    usual = [float(np.quantile(one, USUAL_SHARE)) if len(one) else np.inf for one in finite]
    for block in blocks(len(load) - 2 * ROWS, time, load, gaps):
        rows = slice(block.start, block.stop + 2 * ROWS)
        still = np.abs(load[rows][2 * ROWS:] - load[rows][:-2 * ROWS]) < rig.limits.level_step
        for pair in combinations(range(len(gaps)), 2):
            both = gaps[list(pair), rows]
            before, after, later = both[:, :-2 * ROWS], both[:, ROWS:-ROWS], both[:, 2 * ROWS:]
            with np.errstate(invalid='ignore'):
                change = np.abs(after - before).min(axis=0)
                # A ring that slips across its clearance passes by the mirror of its place.
                away = np.abs([after - before[::-1], later - before[::-1]]).max(axis=(0, 1))
                is_large = change > EXCHANGE_SIZE * max(usual[one] for one in pair)
                places = np.flatnonzero(still & is_large & (away < MATCH * change))
            if len(places):
                exchanges.setdefault(pair, float(time[block.start + int(places[0]) + 1]))
    return [Finding(f'probes {first + 1} and {second + 1} exchange their readings at '
                    f'{seconds:.3f} s while the load stands still: a cable or a channel was '
                    'moved: repeat the test') for (first, second), seconds in exchanges.items()]
