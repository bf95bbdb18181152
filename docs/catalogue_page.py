"""The catalogue as a page to read, which `python docs/generate.py` writes."""

from __future__ import annotations

from collections.abc import Iterator
import sys

from saddlering_ros.effects import catalogue
from saddlering_ros.effects.base import EffectParameter, RIG_TESTS, RingEffect
from saddlering_ros.effects.extension import STAGES
from saddlering_ros.quantities import compact

OPENING = """\
# Catalogue of effects

A reference of the causes that a diagnosis can name. Each effect is one file of
`saddlering_ros/effects/`; [Adding effects](../effects.md#effects-with-code) shows how to write
one. `python docs/generate.py` writes this page from those files.

An effect in a parameter file extends the model in every simulation, live and offline:

    effects:
      radial_friction: {force: 8000.0, presliding: 2.0e-6}
      probe_gain: {probe: 3.0, gain: 0.02}

`raceway_waves`, the amplitudes of waves of the raceways, may stand in such a file, too. No
diagnosis names them as a cause ([Raceways that wave](../diagnosis.md#raceways-that-wave)).

Units are SI. The default of a parameter is the value in the column *start*, that of a choice its
first value. *Typical* is a size that a real rig may have. Bounds and typical sizes are project
assumptions, not properties of a measured rig. They are those of a rig of 25 t with a pitch radius
of 0.6 m. On another rig forces scale with its full scale, moments also with its radius, and
compliances inversely.
"""


def catalogue_page() -> str:
    """The whole page as Markdown."""
    effects = catalogue().values()
    parts = [OPENING, *_overview(list(effects))]
    for stage in STAGES:
        parts.append(f'\n## {stage.capitalize()}\n')
        parts += [_section(effect) for effect in effects if effect.stage == stage]
    return '\n'.join([*parts, *_tests()])


def _tests() -> Iterator[str]:
    """The tests that the next test of a verdict is chosen from."""
    yield ('\n## Tests that tell causes apart\n\nThe next test of a named cause is the test that '
           'tells it from most of its look-alikes. Among equal tests, the first one of this table '
           'is chosen. The next test of an `ambiguous` verdict is '
           '[simulated](../diagnosis.md#the-next-test-of-an-ambiguous-verdict).\n\n'
           '| test | instruction | result for other causes |\n|---|---|---|')
    for test in RIG_TESTS:
        yield f'| `{test.id}` | {test.instruction} | {test.otherwise or "open"} |'
    yield ''


def _overview(effects: list[RingEffect]) -> Iterator[str]:
    yield '| id | effect | stage | shows in |\n|---|---|---|---|'
    for stage in STAGES:
        for effect in effects:
            if effect.stage == stage:
                runs = ' (dynamic runs only)' if effect.dynamic_only else ''
                yield (f'| [{effect.id}](#{effect.id}) | {effect.title} | {stage} '
                       f'| {", ".join(effect.channels)}{runs} |')


def _section(effect: RingEffect) -> str:
    lines = [f'### {effect.id}\n', f'**{effect.title}.** {effect.words}\n',
             f'Added to the model: {_formula(effect)}\n',
             '| parameter | unit | from | to | typical | start | meaning |',
             '|---|---|---|---|---|---|---|']
    lines += [_parameter(parameter) for parameter in effect.parameters]
    lines += [f'\nChoice `{choice.name}`: {choice.words}.' for choice in effect.choices]
    lines.append(f'\nConfirmed by: {_sentence(effect.settled_by)}\n')
    shown = [f'`{test.id}`: {words}' for test in RIG_TESTS
             if (words := effect.outcomes.get(test.id))]
    if shown:
        lines.append(f'[Tests](#tests-that-tell-causes-apart) would show {"; ".join(shown)}.\n')
    return '\n'.join(lines)


def _parameter(parameter: EffectParameter) -> str:
    numbers = ' | '.join(compact(value) for value in (
        parameter.low, parameter.high, parameter.scale, parameter.start))
    return f'| {parameter.name} | {parameter.unit} | {numbers} | {parameter.words} |'


def _formula(effect: RingEffect) -> str:
    first_line = (sys.modules[type(effect).__module__].__doc__ or '').splitlines()[0]
    return first_line[:1].lower() + first_line[1:]


def _sentence(text: str) -> str:
    return text[:1].lower() + text[1:]
