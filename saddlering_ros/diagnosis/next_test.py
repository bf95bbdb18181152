"""The next test of a verdict: its instruction, and the cause that each outcome means.

For causes that the data cannot separate, the engine simulates the possible tests of the rig, and
the test that most often leaves only the true cause comes first. For a named cause, the test is
chosen from the table of tests by the most similar causes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

from saddlering_ros.diagnosis.wording import lowered, title_of
from saddlering_ros.discrepancy import Separation
from saddlering_ros.effects import catalogue
from saddlering_ros.effects.base import RIG_TESTS, RigTest, UNCLEAR

MIN_LIKENESS = 0.3
"""Cosine of two signatures from which an effect counts as an alternative to a named one."""

SAME = 0.98
"""Cosine of two signatures from which they are one in these data."""

MAX_ALTERNATIVES = 3


ENOUGH = 0.5
"""Share of draws below which a simulated test is replaced by a test of the table."""


def outcome(effect_id: str, test: RigTest) -> str:
    """Outcome of a test if this effect is the cause; UNCLEAR if any outcome is possible."""
    known = catalogue().get(effect_id)
    if known is None:
        return UNCLEAR
    own: str | None = getattr(known.outcomes, test.id)
    return test.otherwise if own is None else own


def separated(test: RigTest, effects: Sequence[str]) -> int:
    """Number of pairs of these effects that the test separates."""
    shown = [outcome(name, test) for name in effects]
    return sum(UNCLEAR not in pair and pair[0] != pair[1] for pair in combinations(shown, 2))


def for_group(effects: Sequence[str], separations: Sequence[Separation]) -> str | None:
    """The next test for a group, with its share of simulated draws that leave only the true cause.

    A test that could not be simulated comes first if no simulated test separates the group.
    """
    table = _of_table(effects)
    best = separations[0] if separations else None
    simulated = {item.proposal.kind for item in separations}
    if best is None or (best.share < ENOUGH and table is not None and table.id not in simulated):
        return between(effects)
    known = [test for test in RIG_TESTS if test.id == best.proposal.kind]
    meanings = _meanings(known[0], effects) if known and separated(known[0], effects) else ''
    return ' '.join(filter(None, (best.proposal.sentence, meanings, share_words(best))))


def share_words(separation: Separation) -> str:
    """The share of a test in words: 'In 87 of 100 simulated draws, ...'."""
    share, low, high = (
        round(100.0 * item) for item in (separation.share, *separation.interval))
    return (f'In {share} of 100 simulated draws, this test leaves the true cause alone '
            f'(95 % interval {low} to {high}).')


def between(effects: Sequence[str]) -> str | None:
    """The test of the table that separates most of these effects, with every outcome."""
    test = _of_table(effects)
    return None if test is None else f'{test.instruction} {_meanings(test, effects)}'


def _of_table(effects: Sequence[str]) -> RigTest | None:
    """The test that separates most pairs; among equal ones, the first effect from most others."""
    scored = [(separated(test, effects), _first_separated(test, effects), test)
              for test in RIG_TESTS]
    best = max(scored, key=lambda item: item[:2])
    return best[2] if best[0] else None


def confirming(effect_id: str, alternatives: Sequence[str]) -> str:
    """The test that confirms a named effect against its look-alikes in these data."""
    sentence = between([effect_id, *alternatives]) if alternatives else None
    if sentence is not None:
        return f'To confirm {lowered(title_of(effect_id))}: {sentence}'
    for test in RIG_TESTS:
        shown = outcome(effect_id, test)
        if shown not in (UNCLEAR, test.otherwise):
            return (f'To confirm {lowered(title_of(effect_id))}: {test.instruction} '
                    f'{_capital(shown)} confirms it.')
    known = catalogue().get(effect_id)
    words = '' if known is None else known.settled_by
    return f'To confirm {lowered(title_of(effect_id))}: {words}'


def look_alikes(effect_id: str, cosines: Mapping[str, Mapping[str, float]]) -> list[str]:
    """The effects with the most similar signatures, the most similar first."""
    found: dict[str, float] = {}
    for label, row in cosines.items():
        if label.partition(':')[0] != effect_id:
            continue
        for other, value in row.items():
            name = other.partition(':')[0]
            if name != effect_id and value >= MIN_LIKENESS:
                found[name] = max(value, found.get(name, 0.0))
    return sorted(found, key=lambda name: -found[name])[:MAX_ALTERNATIVES]


def repeated_laws(own: Sequence[str], cosines: Mapping[str, Mapping[str, float]]) -> list[str]:
    """One sentence for each law of the user that repeats an effect of the catalogue here."""
    sentences = []
    for name in own:
        rows = [row for label, row in cosines.items() if label.partition(':')[0] == name]
        alike: dict[str, float] = {}
        for row in rows:
            for label, value in row.items():
                other = label.partition(':')[0]
                if other not in own and value >= SAME:
                    alike[other] = max(value, alike.get(other, 0.0))
        if alike:
            others = ', '.join(sorted(alike, key=lambda item: -alike[item]))
            sentences.append(f'{name} changes these data in the same way as {others} of the '
                             'catalogue: the law and the effect are one cause in these data')
    return sentences


def for_unseen(effects: Sequence[str]) -> str | None:
    """The test that shows most of the effects that these data cannot show."""
    scored = [([name for name in effects if _shows(name, test)], test) for test in RIG_TESTS
              if test.otherwise]
    best, test = max(scored, key=lambda item: len(item[0]), default=([], RIG_TESTS[0]))
    if not best:
        return None
    causes = ' or '.join(lowered(title_of(name)) for name in best)
    return (f'No question is open. These data cannot show {causes}. To see such a cause: '
            f'{test.instruction} {_meanings(test, best)}')


CHANNEL_PROBES = {'delta_x': '1 and 3', 'parity': '1 and 3', 'delta_y': '2 and 4',
                  'gamma': '2 and 4'}


def for_shape(channel: str, coordinate: str) -> str:
    """The next test for a misfit that no known cause explains, by channel and coordinate."""
    probes = CHANNEL_PROBES.get(channel, '1 and 3')
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
        'cause.',
    }
    return sentences.get(coordinate, sentences['load'])


def for_swing(channel: str, frequency: float) -> str:
    """The next test for an unexplained oscillation."""
    return (f'Record ten minutes at constant preload, at the highest sampling rate. If {channel} '
            f'oscillates at {frequency:.2g} Hz there too, pickup of a probe is the cause. If it '
            'does not, the rig oscillates with the load.')


def _first_separated(test: RigTest, effects: Sequence[str]) -> int:
    first, *others = (outcome(name, test) for name in effects)
    return sum(UNCLEAR not in (first, other) and other != first for other in others)


def _shows(effect_id: str, test: RigTest) -> bool:
    return outcome(effect_id, test) not in (UNCLEAR, test.otherwise)


def _meanings(test: RigTest, effects: Sequence[str]) -> str:
    """Each outcome with its causes: 'A loop of the same height means dry friction; ...'."""
    causes: dict[str, list[str]] = {}
    for name in effects:
        causes.setdefault(outcome(name, test), []).append(lowered(title_of(name)))
    unclear = causes.pop(UNCLEAR, [])
    parts = [f'{shown} means {" or ".join(names)}' for shown, names in causes.items()]
    words = _capital('; '.join(parts)) + '.'
    if unclear:
        words += f' The outcome for {" or ".join(unclear)} is open.'
    return words


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
