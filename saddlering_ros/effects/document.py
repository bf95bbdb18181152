"""The catalogue as a page to read: `python -m saddlering_ros.effects.document` writes it."""

from __future__ import annotations

from collections.abc import Iterator
import sys

from saddlering_ros.effects import catalogue
from saddlering_ros.effects.base import Effect, EffectParameter, STAGES
from saddlering_ros.effects.rig_tests import RIG_TESTS

OPENING = """\
# Catalogue of effects

What can part a measurement from the simulation. Each effect below is one file of
`saddlering_ros/effects/`, found by walking that folder; this page is written from those files by
`python -m saddlering_ros.effects.document > docs/catalogue.md`, and a test holds the two together.

An effect in a parameter file extends the model wherever it is simulated, live or offline:

    effects:
      radial_friction: {force: 8000.0, presliding: 2.0e-6}
      probe_gain: {probe: 3.0, gain: 0.02}

Units are SI. A parameter left out takes the value in the column *start*, a choice left out its
first value. *Typical* is a size that a rig may well show. Bounds and typical sizes are project
assumptions, not properties of a measured rig.
"""

ADDING = """\
## Adding an effect

Write one file with a subclass of `Effect` (saddlering_ros/effects/base.py) named after its id: the
words above, its parameters with bounds, the first of them the one that makes it vanish, and
`extend`, which sets parameters of `RingExtension` (saddlering_ros/effects/extension.py). Nothing
else changes: simulator, diagnosis, parameter files and this page find it in the folder.
"""


def catalogue_page() -> str:
    """The whole page as Markdown."""
    effects = catalogue().values()
    parts = [OPENING, *_overview(list(effects))]
    for stage in STAGES:
        parts.append(f'\n## {stage.capitalize()}\n')
        parts += [_section(effect) for effect in effects if effect.stage == stage]
    return '\n'.join([*parts, *_tests(), ADDING])


def _tests() -> Iterator[str]:
    """The tests that the next test of a verdict is chosen from."""
    yield ('\n## Tests that tell causes apart\n\nThe next test of a verdict is the one that gives '
           'most of the open causes an outcome of their own; of tests that tell as much, the '
           'first in this table.\n\n| test | what to do | what other causes show |\n|---|---|---|')
    for test in RIG_TESTS:
        yield f'| `{test.id}` | {test.instruction} | {test.otherwise or "may show anything"} |'
    yield ''


def _overview(effects: list[Effect]) -> Iterator[str]:
    yield '| id | effect | stage | shows in |\n|---|---|---|---|'
    for stage in STAGES:
        for effect in effects:
            if effect.stage == stage:
                runs = ' (dynamic runs only)' if effect.dynamic_only else ''
                yield (f'| [{effect.id}](#{effect.id}) | {effect.title} | {stage} '
                       f'| {", ".join(effect.channels)}{runs} |')


def _section(effect: Effect) -> str:
    lines = [f'### {effect.id}\n', f'**{effect.title}.** {effect.words}\n',
             f'Added to the model: {_formula(effect)}\n',
             '| parameter | unit | from | to | typical | start | meaning |',
             '|---|---|---|---|---|---|---|']
    lines += [_parameter(parameter) for parameter in effect.parameters]
    lines += [f'\nChoice `{choice.name}`: {choice.words}.' for choice in effect.choices]
    lines.append(f'\nSettled by: {_sentence(effect.settled_by)}\n')
    shown = [f'`{test.id}`: {words}' for test in RIG_TESTS
             if (words := getattr(effect.outcomes, test.id))]
    if shown:
        lines.append(f'[Tests](#tests-that-tell-causes-apart) would show {"; ".join(shown)}.\n')
    return '\n'.join(lines)


def _parameter(parameter: EffectParameter) -> str:
    numbers = ' | '.join(f'{value:.3g}' for value in (
        parameter.low, parameter.high, parameter.scale, parameter.start))
    return f'| {parameter.name} | {parameter.unit} | {numbers} | {parameter.words} |'


def _formula(effect: Effect) -> str:
    first_line = (sys.modules[type(effect).__module__].__doc__ or '').splitlines()[0]
    return first_line[:1].lower() + first_line[1:]


def _sentence(text: str) -> str:
    return text[:1].lower() + text[1:]


if __name__ == '__main__':
    sys.stdout.write(catalogue_page())
