"""A verdict's JSON in plain words."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from saddlering_ros.diagnosis.contract import (
    CandidateEntry,
    CauseEntry,
    causes_of,
    ShapeEntry,
    shapes_of,
    SizeEntry,
    VerdictDocument,
)
from saddlering_ros.effects import catalogue
from saddlering_ros.quantities import CHANCE, compact, MATERIAL, percent, quantity, signed_percent

Document = VerdictDocument

COORDINATES = {
    'load': 'follows the load', 'direction': 'changes sign with the direction of the load',
    'rate': 'follows the rate of the load', 'time': 'follows time',
}


def title_of(effect_id: str) -> str:
    """The title of an effect, or its id if the catalogue does not have it."""
    known = catalogue().get(effect_id)
    return effect_id if known is None else known.title


def lowered(title: str) -> str:
    """A title in the form for the middle of a sentence."""
    return title[:1].lower() + title[1:] if title[1:2].islower() else title


def headline(document: Document) -> str:
    """The verdict in one or two sentences."""
    verdict = document['verdict']
    if verdict == 'none':
        return ('The simulation lacks nothing that these data could show. The residual is noise, '
                f"or smaller than {100.0 * MATERIAL:g} % of a channel's range.")
    if verdict == 'unknown':
        return ('Something is wrong, and no cause of the catalogue explains the misfit. '
                + _shapes(shapes_of(document)))
    causes = causes_of(document)
    if verdict == 'ambiguous':
        return ('The simulation lacks a cause. '
                + ' '.join(_open_cause(cause) for cause in causes))
    found = _joined([f'{lowered(title_of(cause["effect"]))}{_size(cause)}' for cause in causes])
    return f'The simulation lacks {found}.'


def gain_sentence(document: Document) -> str:
    """The misfit reduction of the extension, with that on held-out runs if there are some."""
    gain = document.get('gain')
    if document['verdict'] == 'none' or gain is None or gain.get('fit') is None:
        return ''
    fitted = percent(gain['fit'])
    if gain.get('held_out') is None:
        return (f'The extended model reduces the misfit by {fitted} on fitted runs. No run was '
                'held out to check this.')
    kept = percent(gain['held_out'])
    how = {'held out': 'held-out runs',
           'held out in turn': 'runs held out in turn'}.get(gain.get('how', ''), 'other runs')
    return (f'The extended model reduces the misfit by {kept} on {how}, and by {fitted} on '
            'fitted runs.')


def size_of(cause: CauseEntry) -> str:
    """Place of a cause and the size of its first parameter: 'probe 2 gain +3.0 ± 0.2 %'."""
    name, item = next((name, item) for name, item in cause['parameters'].items()
                      if name not in choices_of(cause['effect']))
    return ' '.join(filter(None, (place_of(cause), parameter_value(cause['effect'], name, item))))


def parameter_words(cause: CauseEntry) -> str:
    """Place of a cause and all its fitted parameters, in one line."""
    choices = choices_of(cause['effect'])
    parts = [place_of(cause)] + [
        parameter_value(cause['effect'], name, item)
        for name, item in cause['parameters'].items()
        if name not in choices and (item['std'] or item['unit'] not in ('', '1'))]
    return ', '.join(filter(None, parts)) or size_of(cause)


def parameter_value(effect_id: str, name: str, item: SizeEntry) -> str:
    """A parameter with its value and error, in a suitable unit and with its sign."""
    return f'{name} {value_words(effect_id, name, item["value"], item["unit"], item["std"])}'


def value_words(
    effect_id: str, name: str, value: float, unit: str, std: float | None = None,
) -> str:
    """A value with its error: shares in percent, a sign if both signs are possible."""
    known = catalogue().get(effect_id)
    found = next((one for one in known.parameters if one.name == name), None) if known else None
    if found is not None and found.amplitude and unit in ('', '1'):
        return signed_percent(value, std, is_signed=not found.one_sided)
    return quantity(value, '' if unit == '1' else unit, std)


def choices_of(effect_id: str) -> frozenset[str]:
    """Names of the parameters of an effect that are chosen and not fitted."""
    known = catalogue().get(effect_id)
    return frozenset() if known is None else frozenset(choice.name for choice in known.choices)


def place_of(cause: CauseEntry) -> str:
    """The variant of a cause in words, for instance the probe; '' if it has one form only."""
    names = choices_of(cause['effect'])
    choices = {name: item['value'] for name, item in cause['parameters'].items() if name in names}
    return variant_words(cause['effect'], choices) if choices else ''


def variant_words(effect_id: str, choices: Mapping[str, float]) -> str:
    """The variant of an effect with these fixed values, in words."""
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


def why_lost(item: CandidateEntry, best: CandidateEntry, chosen: Collection[str],
             alike: Collection[str]) -> str:
    """Whether a candidate was chosen or dropped beside the best of its step, and why."""
    effect_id = item['effects'][-1]
    if item is best and effect_id in chosen:
        return 'chosen: it explains most'
    if (item['p_value'] or 0.0) > CHANCE:
        return 'dropped: no better than chance'
    behind = (best['delta_bic'] or 0.0) - (item['delta_bic'] or 0.0)
    if effect_id in chosen:
        return 'chosen in another step'
    if effect_id in alike:
        return f'alternative: {compact(behind)} less evidence, a similar signature'
    if (item['share_of_range'] or 0.0) < MATERIAL:
        return 'dropped: too small to matter'
    if item is best:
        return 'best of this step, but not enough to be named'
    return f'dropped: {compact(behind)} less evidence than the best'


def shape_words(shape: ShapeEntry) -> str:
    """'delta_x follows the load, 0.4 % of range rms'; an oscillation has words of its own."""
    if shape.get('shape'):
        return str(shape['shape'])
    words = COORDINATES.get(shape['coordinate'], shape['coordinate'])
    return f'{shape["channel"]} {words}, {percent(shape["share_of_range"])} of range rms'


def swing_words(channel: str, frequency: float, run: str, share_of_range: float) -> str:
    """'gamma oscillates at about 12 Hz in dynamic_50, 0.3 % of range rms'."""
    return (f'{channel} oscillates at about {quantity(frequency, "Hz", digits=2)} in {run}, '
            f'{percent(share_of_range)} of range rms')


def _shapes(left: Sequence[ShapeEntry]) -> str:
    shapes = [shape_words(shape) for shape in left]
    return f'The residual: {"; ".join(shapes)}.' if shapes else ''


def _open_cause(cause: CauseEntry) -> str:
    if len(cause['group']) == 1:
        return f'One cause is {lowered(title_of(cause["effect"]))}{_size(cause)}.'
    names = [lowered(title_of(name)) for name in cause['group']]
    return f'These data cannot tell the possible causes apart: {" or ".join(names)}.'


def _size(cause: CauseEntry) -> str:
    return f' ({size_of(cause)})'


def _joined(parts: Sequence[str]) -> str:
    if len(parts) < 2:
        return ''.join(parts)
    return f'{", ".join(parts[:-1])} and {parts[-1]}'
