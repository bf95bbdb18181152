"""Claims on the rule of the blind campaign: a sound program keeps it, a sabotaged one does not."""

from collections.abc import Callable
import random

import pytest

from benchmarks.examiner import broken_promises, score
from saddlering_ros.virtual_rig.effects import EFFECTS

NAMES = tuple(sorted(name for name, effect in EFFECTS.items() if effect.in_catalogue))
Groups = tuple[tuple[str, ...], ...]
Answer = tuple[str, Groups]
Draw = tuple[str, tuple[str, ...], Answer]


def campaign(seed: int, draws: int = 300) -> list[Draw]:
    """Draws of all kinds with the answers of a program that keeps its promises."""
    chance = random.Random(seed)
    found: list[Draw] = []
    for number in range(draws):
        kind = ('clean', 'single', 'single', 'pair', 'outside')[number % 5]
        hidden = tuple(chance.sample(NAMES, {'single': 1, 'pair': 2}.get(kind, 0)))
        right: Answer = ('named', tuple((name,) for name in hidden)) if hidden else ('none', ())
        if kind == 'outside':
            hidden, right = ('out:tilt_backlash',), ('unknown', (('settling',),))
        missed = kind != 'clean' and chance.random() < 0.08
        found.append((kind, hidden, ('none', ()) if missed else right))
    return found


def broken(draws: list[Draw]) -> list[str]:
    return broken_promises([(kind, score(kind, hidden, *answer)[0])
                            for kind, hidden, answer in draws])


def stray(hidden: tuple[str, ...], chance: random.Random) -> tuple[str, ...]:
    return (chance.choice([name for name in NAMES if name not in hidden]),)


SABOTAGE: dict[str, Callable[[Draw, random.Random], Answer]] = {
    'names at random': lambda draw, chance: ('named', ((chance.choice(NAMES),),)),
    'groups of four at random': lambda draw, chance: (
        'ambiguous', (tuple(chance.sample(NAMES, 4)),)),
    'never a cause': lambda draw, chance: ('none', ()),
    'always unknown': lambda draw, chance: ('unknown', draw[2][1]),
    'everything in one group': lambda draw, chance: ('ambiguous', (NAMES,)),
    'one more name beside the right one': lambda draw, chance: (
        'named', (*draw[2][1], stray(draw[1], chance))),
    'a cause on every sound rig': lambda draw, chance: (
        draw[2] if draw[1] else ('named', (stray((), chance),))),
}
"""What a naming step that is broken would answer."""


def test_a_program_with_the_measured_rates_keeps_the_rule() -> None:
    assert sum(bool(broken(campaign(seed))) for seed in range(50)) <= 1


@pytest.mark.parametrize('sabotage', SABOTAGE)
@pytest.mark.parametrize('draws', [40, 300])
def test_a_sabotaged_naming_step_breaks_the_rule(sabotage: str, draws: int) -> None:
    for seed in range(5):
        chance = random.Random(seed)
        assert broken([(draw[0], draw[1], SABOTAGE[sabotage](draw, chance))
                       for draw in campaign(seed, draws)])
