"""The next test of a verdict: its instruction, and the cause that each outcome means.

For causes that the data cannot separate, the engine simulates the possible tests of the rig, and
the test that most often leaves only the true cause comes first. For a named cause, the test is
chosen from the table of tests by the most similar causes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
import math

import numpy as np

from saddlering_ros import discrepancy
from saddlering_ros.diagnosis.proposed_law import CHANNELS as CHANNELS_OF_LAW
from saddlering_ros.diagnosis.records import Array, LoadGrid, LONGEST_STEP
from saddlering_ros.diagnosis.rig_dimensions import entries_of, title_of_dimension
from saddlering_ros.diagnosis.ring_wording import title_of
from saddlering_ros.diagnosis.verdict import shapes_left, signature_cosines
from saddlering_ros.discrepancy import Point, Proposal, Reading, RunBlocks
from saddlering_ros.doubts.comparison import rig_in_words
from saddlering_ros.effects import catalogue
from saddlering_ros.effects.base import MOVES, RIG_TESTS, RigTest, UNCLEAR
from saddlering_ros.identification.uncertainty import distinct_elevations
from saddlering_ros.quantities import lowered, MATERIAL
from saddlering_ros.record.record import Record
from saddlering_ros.rig import Rig

MIN_LIKENESS, SAME = 0.3, 0.98
"""Cosines of two signatures from which an effect counts as an alternative to a named one, and from
which both are one in these data."""

MAX_ALTERNATIVES = 3
"""Alternatives that one test can part: a sentence with more outcomes is not read."""

ENOUGH = 0.5
"""Share of draws below which a simulated test is replaced by a test of the table."""

ELEVATIONS = (30.0, 50.0, 70.0)
"""Elevations [deg] that are proposed besides those of the data."""

BLOCKS = 250
"""Number of block means of a simulated ramp."""

RAMP, HOLD, STEPS = 1.0, 5.0, 25
"""Seconds between the holds of a static test, seconds of a hold, and holds up to full scale."""

FAST_STEP = 5e-3
"""Longest step [s] of the simulation of a fast ramp, in which damping shows."""

REST_SECONDS, SAG = 600.0, 1e-4
"""Length of a record at constant preload [s], and the wander of the held load in it, as a share of
full scale."""

CELL_GAIN, CELL_SHARE = 2e-3, 5e-4
"""Accuracy of a reference cell: share of the load, and share of full scale."""

INCLINOMETER, SCALE = math.radians(0.02), 1e-3
"""Standard deviations of an inclinometer [rad] and of a measured height [m]."""


def next_test(diagnosis: discrepancy.Diagnosis, fitted: Sequence[Record],
              held_out: Sequence[Record], rig: Rig) -> str | None:
    """The most valuable next test, and the cause that each outcome means.

    With `unknown` the rig file comes before the hardware, if no hash identifies the file: a wrong
    dimension causes a misfit with a shape of no cause, and the drawing shows it without tools.
    """
    if diagnosis.verdict == 'none':
        limits = diagnosis.observability.limits
        return for_unseen([limit.effect for limit in limits if not limit.testable])
    evidence = diagnosis.held_out_evidence
    free = (discrepancy.wording.free_test_words(evidence)
            or discrepancy.wording.fit_too_words(diagnosis.remainder))
    # Static tests at two elevations leave nothing for a test at another one.
    runs = [*fitted, *held_out]
    static = distinct_elevations(run.elevation for run in runs if run.test == 'static')
    tests = tuple(test for test in RIG_TESTS if static < 2 or test.id != 'other_elevation')
    if diagnosis.verdict == 'unknown':
        first = '' if all(run.rig_hash == rig.digest for run in runs) else (
            f'First compare the rig file with the ring ({rig_in_words(rig)}): saddlering rig '
            '--check BAG and its drawing show a wrong dimension, span, polarity or elevation.')
        # Causes that explain little are likely to be others, which their test would not show.
        causes = diagnosis.causes if diagnosis.explained >= discrepancy.PARTED else ()
        groups = [cause.group for cause in causes if len(cause.group) > 1]
        sentence = for_groups(groups, diagnosis.separations, tests) if groups else None
        parting = sentence and f'If the cause is {_either(groups[0])}: {sentence}'
        if causes and not groups and not title_of_dimension(causes[0].effect):
            parting = confirming(causes[0].effect, [], tests)
        # Shapes that are all within chance need no test beside another one.
        after = diagnosis.residual_after
        is_told = not parting or shapes_left(after) or after.fast.visible >= MATERIAL
        rest = for_residual(after, diagnosis.law) if is_told else ''
        # Causes that held-out runs cannot separate may look different at their elevation.
        if not free or (evidence and not discrepancy.wording.excluded_titles(evidence)):
            free = at_another_elevation(fitted, held_out) or free
        return ' '.join(filter(None, (free, first, parting, rest)))
    entries = entries_of(rig, diagnosis.causes)
    first = ('First compare the rig file with the drawing and the ring: '
             f'{", ".join(entries)}.') if entries else ''
    named = diagnosis.causes[0].effect
    open_groups = [cause.group for cause in diagnosis.causes if len(cause.group) > 1]
    sentence = ''
    if open_groups:
        sentence = for_groups(open_groups, diagnosis.separations, tests) or next(
            (catalogue()[name].settled_by for name in open_groups[0]
             if not title_of_dimension(name)), '')
    elif not title_of_dimension(named):
        cause = diagnosis.causes[0]
        # The label of the cause where it acts, as in 'probe_bracket:3'.
        variants = cause.definition.variants
        label = named if len(variants) == 1 else next(
            f'{named}:{number}' for number, values in enumerate(variants)
            if all(cause.parameters[name].value == value for name, value in values.items()))
        alike = look_alikes(label, signature_cosines(diagnosis))
        sentence = confirming(named, alike[:MAX_ALTERNATIVES], tests)
    places = ' '.join(
        f'These data leave open where {lowered(title_of(cause.effect))} acts: examine each place.'
        for cause in diagnosis.causes if cause.elsewhere)
    return ' '.join(filter(None, (free, first, sentence, places)))


def at_another_elevation(fitted: Sequence[Record], held_out: Sequence[Record]) -> str:
    """The test that needs no record, if all fitted runs have one elevation; else ''."""
    usual = [run.elevation for run in fitted]
    names = [run.name for run in held_out if distinct_elevations([*usual, run.elevation]) == 2
             and distinct_elevations(usual) == 1]
    return (f'Fit {discrepancy.wording.joined(names)} too: at one elevation many causes look '
            'alike.') if names else ''


def for_residual(after: discrepancy.Residual, law: discrepancy.LawProposal | None = None) -> str:
    """The test for the largest part of the misfit that no cause explains; else the least likely.

    Among shapes that are all within chance, the largest one is that of the noisiest channel. A
    proposed law tells the coordinate better than the largest shape: a loop that follows the
    direction also has a part along the load, and the law predicts other runs.
    """
    shapes = shapes_left(after)
    largest = (max(shapes, key=lambda shape: shape.visible) if shapes else
               min(after.shapes, key=lambda shape: shape.p_value))
    fast, channel, coordinate = after.fast, largest.view, largest.coordinate
    if law is None and fast.visible >= max(MATERIAL, largest.visible):
        return (f'Record ten minutes at constant preload, at the highest sampling rate. If '
                f'{fast.view} moves at {fast.frequency:.2g} Hz there too, pickup of a probe '
                'is the cause. If it does not, the rig moves with the load or its steps.')
    if law is not None:
        channel, coordinate = CHANNELS_OF_LAW.get(
            law.terms[0].target, law.terms[0].target), law.terms[0].coordinate
    if channel == 'hydraulic_load':
        return ('Put a calibrated load cell in line with the cylinder and repeat the static test. '
                'If it differs from the recorded load, the load is the cause.')
    is_axial = channel in ('delta_y', 'gamma', 'eddy_current_2', 'eddy_current_4')
    probes = '2 and 4' if is_axial else '1 and 3'
    sentences = {
        'load': f'Swap probes {probes} and repeat the static test. If the misfit of {channel} '
        'moves with a probe, the probe is the cause. If the misfit stays, the ring or the load '
        'is the cause.',
        'direction': 'Record two cycles with holds of 30 s at preload and at full load. If the '
        f'loop of {channel} repeats and stays open, friction is the cause. If the loop closes '
        'during the holds, creep is the cause. If only the first cycle has a loop, settling is '
        'the cause.',
        'rate': f'Repeat the dynamic test four times slower. If the misfit of {channel} falls '
        'with the rate, damping or a delay is the cause. If the misfit stays, stiffness or '
        'friction is the cause.',
        'time': f'Record ten minutes at constant preload. If {channel} moves without any load, '
        'drift or pickup of a probe is the cause. If it does not move, creep of the ring is the '
        'cause.'}
    sentences['hysteresis'] = sentences['direction']
    return sentences.get(coordinate, sentences['load'])


def outcome(effect_id: str, test: RigTest) -> str:
    """Outcome of a test if this effect is the cause; UNCLEAR if any outcome is possible."""
    if effect_id not in catalogue():
        return UNCLEAR
    return catalogue()[effect_id].outcomes.get(test.id, test.otherwise)


def separated(test: RigTest, effects: Sequence[str]) -> int:
    """Number of pairs of these effects that the test separates."""
    shown = [outcome(name, test) for name in effects]
    return sum(UNCLEAR not in pair and pair[0] != pair[1] for pair in combinations(shown, 2))


def for_groups(groups: Sequence[Sequence[str]], separations: Sequence[discrepancy.Separation],
               tests: Sequence[RigTest] = RIG_TESTS) -> str | None:
    """The next test for the first group, and what parts the others: it, or a test of the table.

    None if no test is known for the first group.
    """
    first = for_group(groups[0], separations, tests)
    if first is None:
        return None
    words = [first]
    for effects in groups[1:]:
        together = next((one.together for one in separations[:1]
                         if first.startswith(one.proposal.sentence)), ())
        is_open = not together or any(
            all(any(name in model for model in models) for name in effects) for models in together)
        shown = between(effects, tests) if is_open else _parted(effects, together)
        words += [f'Of {_either(effects)}: {shown}'] if shown else []
    return ' '.join(words)


def for_group(effects: Sequence[str], separations: Sequence[discrepancy.Separation],
              tests: Sequence[RigTest] = RIG_TESTS) -> str | None:
    """The next test for a group, with its share of simulated draws that leave only the true cause.

    A test that could not be simulated comes first if no simulated test separates the group.
    """
    table = _of_table(effects, tests)
    best = separations[0] if separations else None
    simulated = {one.proposal.kind for one in separations}
    if best is None or (best.share < ENOUGH and table is not None and table.id not in simulated):
        return between(effects, tests)
    if not best.alone:
        words = (f'None of {len(separations)} simulated tests leaves one of these causes alone: '
                 'compare the size of each with the rig.')
        return ' '.join(filter(None, (between(effects, tests), words)))
    meanings = ''.join(_meanings(test, effects) for test in RIG_TESTS
                       if test.id == best.proposal.kind and separated(test, effects))
    share, low, high = (round(100.0 * value) for value in (best.share, *best.interval))
    words = (f'In {share} of 100 simulated draws, this test leaves the true cause alone '
             f'(95 % interval {low} to {high}{best.caveat}).')
    return ' '.join(filter(None, (
        best.proposal.sentence, meanings, _parted(effects, best.together), words)))


def _parted(effects: Sequence[str], together: Sequence[Sequence[Sequence[str]]]) -> str:
    """Which alternatives a simulated test parts, and which it leaves open; '' if none is known."""
    left = [[name for name in effects if any(name in model for model in models)]
            for models in together]
    left = [names for names in left if len(names) > 1]
    alone = [name for name in effects if not any(name in names for names in left)]
    if not left:
        return 'It parts all of these causes.' if together else ''
    words = [f'it leaves open {_either(names)}' for names in left]
    if alone:
        titles = discrepancy.wording.joined([lowered(title_of(name)) for name in alone])
        words.insert(0, f'it parts {titles} from all others')
    return _capital('; '.join(words)) + '.'


def _either(effects: Sequence[str]) -> str:
    return ' or '.join(lowered(title_of(name)) for name in effects)


def between(effects: Sequence[str], tests: Sequence[RigTest] = RIG_TESTS, *,
            is_first_named: bool = False) -> str | None:
    """The test of a table that separates most of these effects, with every outcome."""
    test = _of_table(effects, tests, is_first_named=is_first_named)
    return None if test is None else f'{test.instruction} {_meanings(test, effects)}'


def _of_table(effects: Sequence[str], tests: Sequence[RigTest], *,
              is_first_named: bool = False) -> RigTest | None:
    """The test that separates most pairs; among equal ones, the first effect from most others.

    If the first one is named, its own pairs come first: the others need not be told apart.
    """
    def score(test: RigTest) -> tuple[int, ...]:
        first, *others = (outcome(name, test) for name in effects)
        counts = (separated(test, effects), sum(
            UNCLEAR not in (first, other) and other != first for other in others))
        return counts[::-1] if is_first_named else counts

    best = max(tests, key=score)
    return best if any(score(best)) else None


def confirming(effect_id: str, alternatives: Sequence[str],
               tests: Sequence[RigTest] = RIG_TESTS) -> str:
    """The test that confirms a named effect against its look-alikes in these data."""
    alone = (f'{test.instruction} {_capital(shown)} confirms it.' for test in tests
             if (shown := outcome(effect_id, test)) not in (UNCLEAR, test.otherwise))
    sentence = between(
        [effect_id, *alternatives], tests, is_first_named=True) if alternatives else None
    effect = catalogue().get(effect_id)
    words = sentence or next(alone, '' if effect is None else effect.settled_by)
    return f'To confirm {lowered(title_of(effect_id))}: {words}'


def look_alikes(effect: str, cosines: Mapping[str, Mapping[str, float]],
                least: float = MIN_LIKENESS) -> list[str]:
    """Other effects with a cosine of `least` or more in any variant, the most similar first.

    effect: its id, or the label of one variant, as 'probe_gain:3', of which alone others count.
    """
    alike: dict[str, float] = {}
    for label, row in cosines.items():
        for other, value in row.items() if effect in (label, label.partition(':')[0]) else ():
            name = other.partition(':')[0]
            if name != effect.partition(':')[0] and value >= least:
                alike[name] = max(value, alike.get(name, 0.0))
    return sorted(alike, key=lambda name: -alike[name])


def repeated_laws(laws: Sequence[str], cosines: Mapping[str, Mapping[str, float]]) -> list[str]:
    """One sentence for each law of the user that repeats an effect of the catalogue here."""
    alike = {name: [other for other in look_alikes(name, cosines, SAME) if other not in laws]
             for name in laws}
    return [f'{title_of(name)} changes these data in the same way as an effect of the catalogue '
            f'({", ".join(lowered(title_of(other)) for other in others)}): the law and the effect '
            'are one cause in these data'
            for name, others in alike.items() if others]


def for_unseen(effects: Sequence[str]) -> str | None:
    """Every effect that these data cannot show, and the test that shows most of them."""
    scored = [([name for name in effects
                if outcome(name, test) not in (UNCLEAR, test.otherwise)], test)
              for test in RIG_TESTS if test.otherwise]
    best, test = max(scored, key=lambda score: len(score[0]), default=([], RIG_TESTS[0]))
    if not best:
        return None
    unseen, shown = (' or '.join(lowered(title_of(name)) for name in names)
                     for names in (effects, best))
    return (f'These data cannot show {unseen}, because contact parameters imitate them. To see '
            f'{shown}: {test.instruction} {_meanings(test, best)}')


def _meanings(test: RigTest, effects: Sequence[str]) -> str:
    """Each outcome with its causes: 'A loop of the same height means dry friction; ...'."""
    causes: dict[str, list[str]] = {}
    for name in effects:
        causes.setdefault(outcome(name, test), []).append(lowered(title_of(name)))
    unclear = causes.pop(UNCLEAR, [])
    meanings = [f'{shown} means {" or ".join(names)}' for shown, names in causes.items()]
    words = _capital('; '.join(meanings)) + '.'
    if unclear:
        words += f' The outcome for {" or ".join(unclear)} is open.'
    return words


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]


def propose(rig: Rig, runs: Sequence[RunBlocks]) -> list[Proposal]:
    """Possible tests of this rig at the elevations of the data and at others."""
    full, low, peak = rig.full_scale_load, rig.preload, rig.full_scale_words
    recorded = sorted({round(float(np.degrees(run.payload.elevation)), 1) for run in runs})
    proposals = []
    for degrees in sorted({*recorded, *ELEVATIONS}):
        where = f'at {degrees:g} deg'
        slow = load_run(rig, degrees, [0, 1, 31, 61, 62], [low, low, full, low, low])
        fast = load_run(rig, degrees, [0, 1, 2.5, 4, 6], [low, low, full, low, low], FAST_STEP)
        cycles = load_run(rig, degrees, [0, 1, 6, 36, 41, 71, 76, 106, 111, 141],
                          [low, low, full, full, low, low, full, full, low, low])
        proposals += [
            Proposal(f'Record a slow ramp to {peak} and back in 60 s {where}.', slow,
                     'second_rate'),
            Proposal(f'Record a fast ramp to {peak} and back in 3 s {where}.', fast,
                     'second_rate'),
            Proposal(f'Record two cycles to {peak} with holds of 30 s at full load and at preload '
                     f'{where}.', cycles, 'repeat_cycle')]
        if degrees not in recorded:
            proposals.append(Proposal(f'Repeat the static test {where}.', staircase(rig, degrees),
                                      'other_elevation'))
    static = staircase(rig, recorded[0])
    rest = load_run(rig, recorded[0], [0, REST_SECONDS], [low, low + SAG * full])
    cell = (Reading('load_gain', CELL_GAIN), Reading('load_offset', CELL_SHARE * full),
            Reading('load_nonlinearity', CELL_SHARE),
            Reading('cylinder_friction', CELL_SHARE * full))
    angles = (Reading('elevation_error', INCLINOMETER), Reading('bracket_play', INCLINOMETER))
    heights = (Reading('moment_arm', SCALE), Reading('probe_height', SCALE))
    words = {test.id: test.instruction for test in RIG_TESTS}
    repeats = {
        'swapped_probes': Proposal('', static, as_made=with_swapped_probes),
        'slewed_ring': Proposal('', static, as_made=on_slewed_ring, is_other_place=True),
        'reference_load': Proposal('', static, readings=cell),
        'inclinometer': Proposal('', static, readings=angles),
        'heights': Proposal('', static, readings=heights), 'zero_load': Proposal('', rest)}
    proposals += [replace(one, sentence=words[kind], kind=kind) for kind, one in repeats.items()]
    return [
        replace(proposal, run=replace(proposal.run, name=f'proposed {number}'))
        for number, proposal in enumerate(proposals)]


def with_swapped_probes(point: Point) -> Point:
    """The same with probes 1 and 3, and 2 and 4, in each other's place."""
    effects = {}
    for name, values in point.effects.items():
        probe = values.get('probe', 0.0)
        effect = catalogue().get(name)
        moves = effect is not None and effect.outcomes.get('swapped_probes') == MOVES
        other = {'rate': values['sum'] - values['rate']} if probe > 4 else {
            'probe': (probe + 1) % 4 + 1}
        effects[name] = {**values, **other} if moves and probe else values
    return Point(point.base, effects)


def on_slewed_ring(point: Point) -> Point:
    """The same with the ring turned by a quarter, so that an oval and worn arcs lie elsewhere."""
    known = catalogue()
    return Point(point.base, {
        name: known[name].slewed(values) if name in known else values
        for name, values in point.effects.items()})


def load_run(rig: Rig, degrees: float, times: Sequence[float], loads: Sequence[float],
             max_step: float = LONGEST_STEP) -> RunBlocks:
    """An empty run along a course of load: times [s] and loads [N], linear in between.

    max_step [s]: longest step of its simulation.
    """
    edge = np.linspace(times[0], times[-1], 2 * BLOCKS + 1)
    time = 0.5 * (edge[:-1] + edge[1:])
    load = np.interp(time, times, loads)
    first = np.arange(0, 2 * BLOCKS, 2)
    width = 2.0 * float(np.diff(edge)[0])
    centre = time.reshape(BLOCKS, 2).mean(axis=1)
    grid = LoadGrid(float(np.radians(degrees)), time, load, float(load[0]), first, first + 2,
                    max_step)
    change = np.gradient(load.reshape(BLOCKS, 2).mean(axis=1), centre)
    return _empty_run(rig, grid, centre, np.full(BLOCKS, width), np.sign(change), change)


def staircase(rig: Rig, degrees: float) -> RunBlocks:
    """An empty static run: holds up to full scale and back, four blocks each."""
    rise = np.arange(1, STEPS + 1) * rig.full_scale_load / STEPS
    levels = np.concatenate([[rig.preload], rise, rise[-2::-1]])
    before, level = levels[:-1, None], levels[1:, None]
    moving, still = np.array([0.1, 0.3, 0.5, 0.7, 0.9]), np.array([0.125, 0.375, 0.625, 0.875])
    begin = (RAMP + HOLD) * np.arange(level.size)[:, None]
    time = np.hstack([begin + moving * RAMP, begin + RAMP + still * HOLD])
    load = np.hstack([before + moving * (level - before), np.repeat(level, still.size, axis=1)])
    held = np.flatnonzero(level[:, 0] >= rig.limits.hold_min)
    first = 1 + np.arange(time.size).reshape(time.shape)[held, moving.size:].ravel()
    grid = LoadGrid(float(np.radians(degrees)), np.append(0.0, time), np.append(levels[0], load),
                    float(levels[0]), first, first + 1, 1.0)
    branch = np.where(level > before, 1.0, -1.0)[held, 0]
    return _empty_run(rig, grid, grid.time[first], np.full(first.size, HOLD / 4),
                      np.repeat(branch, still.size), np.zeros(first.size),
                      np.repeat(held.astype(np.float64), still.size))


def _empty_run(rig: Rig, grid: LoadGrid, time: Array, width: Array, direction: Array, rate: Array,
               hold: Array | None = None) -> RunBlocks:
    return RunBlocks(
        'proposed', f'{np.degrees(grid.elevation):.1f} deg', time, width,
        np.zeros((len(rig.probes.present), time.size)), {'load': grid.block_means(grid.load)},
        payload=grid, direction=direction, rate=rate, hold=hold)
