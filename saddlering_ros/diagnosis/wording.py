"""A verdict's JSON in plain words."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from saddlering_ros.effects import catalogue
from saddlering_ros.rig.quantities import percent, quantity

Document = Mapping[str, Any]

COORDINATES = {
    'load': 'follows the load', 'direction': 'turns round with the direction of the load',
    'rate': 'follows the rate of the load', 'time': 'follows time',
}

CHANCE = 0.01
"""Probability above which as much could have come by chance."""

MATERIAL = 1e-3
"""Share of a channel's range under which a misfit does not matter."""

WORDS = {
    'none': 'nothing missing that these data could show', 'named': 'the cause stands out',
    'ambiguous': 'more than one cause explains it', 'unknown': 'no known cause explains it',
}


def title_of(effect_id: str) -> str:
    """An effect's title, or its id where the catalogue does not hold it."""
    known = catalogue().get(effect_id)
    return effect_id if known is None else known.title


def lowered(title: str) -> str:
    """A title in the middle of a sentence."""
    return title[:1].lower() + title[1:] if title[1:2].islower() else title


def effects_of(document: Document) -> list[Mapping[str, Any]]:
    """The causes that are effects of the catalogue (an unknown's shapes left out)."""
    return [cause for cause in document['causes'] if 'effect' in cause]


def headline(document: Document) -> str:
    """The verdict in one or two sentences."""
    verdict = document['verdict']
    if verdict == 'none':
        return ('The simulation lacks nothing that these data could show: what is left is noise, '
                "or smaller than 0.1 % of a channel's range.")
    if verdict == 'unknown':
        return ('Something is wrong that no cause in the catalogue explains. '
                + _shapes(document['causes']))
    causes = effects_of(document)
    if verdict == 'ambiguous':
        return ('Something is missing from the simulation. '
                + ' '.join(_open_cause(cause) for cause in causes))
    found = _joined([f'{lowered(title_of(cause["effect"]))}{_size(cause)}' for cause in causes])
    return f'The simulation lacks {found}.'


def gain_sentence(document: Document) -> str:
    """What the extension is worth, on runs kept apart where there are some."""
    gain = document.get('gain') or {}
    if document['verdict'] == 'none' or gain.get('fit') is None:
        return ''
    fitted = percent(gain['fit'])
    if gain.get('held_out') is None:
        return (f'With it the misfit falls by {fitted} on the runs it was fitted to; no run was '
                'kept apart to check it on.')
    kept = percent(gain['held_out'])
    how = {'held out': 'runs kept back, which neither named it nor fitted it',
           'left out in turn': 'runs left out in turn'}.get(gain.get('how', ''), 'other runs')
    return f'With it the misfit falls by {kept} on {how} ({fitted} where fitted).'


def size_of(cause: Mapping[str, Any]) -> str:
    """The first parameter of a cause, its size, with error and unit."""
    name, item = next(iter(cause['parameters'].items()))
    return f'{name} {quantity(item["value"], item["unit"], item["std"])}'


def parameter_words(cause: Mapping[str, Any]) -> str:
    """All parameters of a cause in one line; a choice shows the words of its variant."""
    parts, choices = [], {}
    for name, item in cause['parameters'].items():
        if not item['std'] and not item['unit']:
            choices[name] = item['value']
            continue
        parts.append(f'{name} {quantity(item["value"], item["unit"], item["std"])}')
    if choices:
        parts.append(variant_words(cause['effect'], choices))
    return ', '.join(parts)


def variant_words(effect_id: str, choices: Mapping[str, float]) -> str:
    """Which variant of an effect has these fixed values, in words."""
    known = catalogue().get(effect_id)
    for variant in known.variants if known is not None else ():
        if variant.label and all(variant.values.get(k) == v for k, v in choices.items()):
            return variant.label
    return ', '.join(f'{name} {value:g}' for name, value in choices.items())


def signature_words(label: str) -> str:
    """'probe_lag:2' with the words of that variant: 'probe_lag, probe 3'."""
    effect_id, _, place = label.partition(':')
    known = catalogue().get(effect_id)
    if known is None or not place.isdigit() or int(place) >= len(known.variants):
        return label
    words = known.variants[int(place)].label
    return f'{effect_id}, {words}' if words else effect_id


def why_lost(item: Mapping[str, Any], best: Mapping[str, Any], chosen: Collection[str],
             alike: Collection[str]) -> str:
    """What became of a candidate beside the best of its step, and why."""
    effect_id = item['effects'][-1]
    if item is best and effect_id in chosen:
        return 'chosen: explains most'
    if (item['p_value'] or 0.0) > CHANCE:
        return 'lost: no better than chance'
    behind = (best['delta_bic'] or 0.0) - (item['delta_bic'] or 0.0)
    if effect_id in chosen:
        return 'chosen in another step'
    if effect_id in alike:
        return f'not told apart: {behind:.3g} less evidence, a form like it'
    if (item['share_of_range'] or 0.0) < MATERIAL:
        return 'lost: too small to matter'
    if item is best:
        return 'best here, yet not enough to be named'
    return f'lost: {behind:.3g} less evidence than the best'


def shape_words(shape: Mapping[str, Any]) -> str:
    """'delta_x follows the load, 0.4 % of range rms'."""
    words = COORDINATES.get(shape['coordinate'], shape['coordinate'])
    return f'{shape["channel"]} {words}, {percent(shape["share_of_range"])} of range rms'


def _shapes(causes: Sequence[Mapping[str, Any]]) -> str:
    shapes = [shape_words(cause) for cause in causes if 'coordinate' in cause]
    return f'What is left: {"; ".join(shapes)}.' if shapes else ''


def _open_cause(cause: Mapping[str, Any]) -> str:
    if len(cause['group']) == 1:
        return f'One cause is {lowered(title_of(cause["effect"]))}{_size(cause)}.'
    names = [lowered(title_of(name)) for name in cause['group']]
    return f'These data cannot tell which it is: {" or ".join(names)}.'


def _size(cause: Mapping[str, Any]) -> str:
    return f' ({size_of(cause)})'


def _joined(parts: Sequence[str]) -> str:
    if len(parts) < 2:
        return ''.join(parts)
    return f'{", ".join(parts[:-1])} and {parts[-1]}'
