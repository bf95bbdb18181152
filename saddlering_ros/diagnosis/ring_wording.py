"""The document of a verdict (the JSON of docs/diagnosis.md), and the document in plain words.

Terminal, report, live page and demo print from the document, and mypy checks the keys that they
read. Sentences that serve a declared model too stand in discrepancy/verdict/wording.py.
"""

from collections.abc import Callable, Collection, Mapping
import math
from typing import Any, cast, TypedDict

from saddlering_ros import quantities
from saddlering_ros.diagnosis.proposed_law import proposal_lines
from saddlering_ros.diagnosis.rig_dimensions import ENTRIES, REVERSED, title_of_dimension
from saddlering_ros.discrepancy import CauseEntry, ReductionEntry, SizeEntry, wording
from saddlering_ros.effects import catalogue
from saddlering_ros.effects.raceway_waves import by_row, RacewayWaves, rms_of
from saddlering_ros.identification.uncertainty import undetermined_words
from saddlering_ros.quantities import lowered, percent, quantity, verdict_line, WIDTH_95
from saddlering_ros.rig import PARAMETER_NAMES, PARAMETER_UNITS
from saddlering_ros.rig.units import stiffnesses_per_millimetre

Shares = dict[str, float]

MAIN_SIZE = 0.25
"""Share of the largest size of a cause from which the headline tells another one, too."""


class TotalReductionEntry(ReductionEntry):
    """Gain of all causes together; how: 'held out' or 'held out in turn'."""

    how: str


class ShapeEntry(TypedDict, total=False):
    """A part of the misfit that no cause explains."""

    channel: str
    coordinate: str
    p_value: float | None
    share_of_range: float
    shape: str


class ChannelEntry(TypedDict, total=False):
    """Misfits of a channel as shares of its range in the run; sound: small errors of the ring."""

    nrmse_before: float | None
    nrmse_after: float | None
    noise_floor: float | None
    sound: float | None


class RunEntry(TypedDict):
    """One run with its channels by name."""

    bag: str
    elevation_deg: float
    test: str
    held_out: bool
    channels: dict[str, ChannelEntry]


class ParametersEntry(TypedDict, total=False):
    """Contact parameters by name; `after` holds K1_std to D2_std as well."""

    before: dict[str, float]
    after: dict[str, Any]
    before_std: dict[str, float | None]
    undetermined: dict[str, dict[str, str]]


class CandidateEntry(TypedDict):
    """A model that was fitted: its effects, the last one new in its step."""

    effects: list[str]
    step: int
    p_value: float | None
    share_of_range: float | None
    delta_bic: float | None
    misfit: float | None
    parameters: dict[str, dict[str, float]]


class LimitEntry(TypedDict):
    """Detection limit of one effect in these data: sizes of its first parameter."""

    effect: str
    limit: float | None
    best_limit: float | None
    material_limit: float | None
    unit: str
    share: float
    testable: bool
    places: list[dict[str, Any]]


class VerdictDocument(TypedDict, total=False):
    """The whole document; causes: first the shapes of an `unknown`, then causes.

    remainder: what is left beyond noise, by run and channel. simulated_tests: of an `ambiguous`
    verdict, with shares of the draws that leave the true model alone. influence: what a stretch of
    a run adds to the evidence. immaterial: effects that are real and too small to matter. shapes:
    every test of the misfit against a coordinate, before and after. raceways: rms [m] of the waves
    of each row that were fitted beside the causes.
    """

    verdict: str
    causes: list[CauseEntry | ShapeEntry]
    runs: list[RunEntry]
    parameters: ParametersEntry
    next_test: str | None
    complete: bool
    remainder: list[dict[str, Any]]
    headline: str
    probabilities: Shares
    stability: float
    refits: list[dict[str, Any]]
    near_limit: list[str]
    influence: list[dict[str, Any]]
    held_out_evidence: list[dict[str, Any]]
    simulated_tests: list[dict[str, Any]]
    gain: TotalReductionEntry
    detection_limits: list[LimitEntry]
    immaterial: list[dict[str, Any]]
    unexplained: list[ShapeEntry]
    candidates: list[CandidateEntry]
    shapes: dict[str, list[ShapeEntry]]
    signature_cosines: dict[str, Shares]
    notes: list[str]
    provenance: dict[str, Any]
    seed: int
    seconds: float
    proposal: dict[str, Any] | None
    raceways: dict[str, float]


def causes_of(document: VerdictDocument) -> list[CauseEntry]:
    """The causes that are effects of the catalogue."""
    return [cast(CauseEntry, cause) for cause in document['causes'] if 'effect' in cause]


COORDINATES = {
    'load': 'follows the load', 'direction': 'changes sign with the direction of the load',
    'rate': 'follows the rate of the load', 'time': 'follows time'}


def bag_name(bag: object) -> str:
    """The last part of a bag's path."""
    return str(bag).rstrip('/').rsplit('/', 1)[-1]


def title_of(effect_id: str) -> str:
    """The title of an effect or dimension, or its id if neither has it."""
    effect = catalogue().get(effect_id)
    return effect.title if effect is not None else title_of_dimension(effect_id) or effect_id


def lowered_titles(group: str, title: Callable[[str], str] = title_of) -> str:
    """The titles of 'first_id or second_id', in the form for the middle of a sentence."""
    return ' or '.join(lowered(title(name)) for name in group.split(' or '))


def headline(document: VerdictDocument) -> str:
    """The verdict in one sentence."""
    verdict = document['verdict']
    if verdict == 'none':
        return ('The simulation lacks nothing that these data could show: the residual is noise, '
                f'{_sound_words(document)}or smaller than {100.0 * quantities.MATERIAL:g} % of a '
                "channel's range.")
    if verdict == 'unknown':
        doubt = wording.doubt_words(
            document.get('probabilities', {}), document.get('gain', {}).get('held_out'))
        return f'{doubt}, and no cause of the catalogue is established{_where(document)}.'
    sizes: dict[tuple[str, ...], list[str]] = {}
    for cause in causes_of(document):
        sizes.setdefault(tuple(cause['group']), []).append(size_of(cause))
    causes = [wording.cause_words([lowered(title_of(name)) for name in group], wording.joined(own))
              for group, own in sizes.items()]
    beside = ''
    if waves := document.get('raceways'):
        beside = f' The model has {wave_words(waves)}, too.'
    if not document.get('remainder'):
        return wording.lacking_words(causes) + beside
    rest, gain = document['remainder'][0], document['gain']
    moved = [cause['share_of_range'] for cause in causes_of(document)]
    return wording.lacking_words(causes, wording.rest_words(rest, moved) + _beside(document, rest),
                                 gain['fit'], gain['held_out'], gain['how']) + beside


def wave_words(sizes: Mapping[str, float]) -> str:
    """Waves of the raceways by the rms [m] of each row."""
    told = [f'{quantity(size, "m", digits=2)} in the {row} row' for row, size in sizes.items()]
    return f'waves of the raceways (rms {wording.joined(told)})'


def base_words(raceways: Collection[object]) -> str:
    """What a model without causes is called; raceways: those whose waves it has."""
    return 'contact law with waves' if raceways else 'contact law alone'


def _where(document: VerdictDocument) -> str:
    """Where the misfit is largest over the noise; '' if it is nowhere above it."""
    may_be_none = wording.may_be_none(document.get('probabilities', {}))
    cases = []
    for name, place, item in _misfits(document):
        if item['nrmse_before'] and item['noise_floor']:
            errors = math.hypot(item['noise_floor'], item.get('sound') or 0.0)
            cases.append((
                item['nrmse_before'] / item['noise_floor'],
                f'; the misfit exceeds noise most in {name} of {place}: '
                f'{percent(item["nrmse_before"])} of range, where noise alone gives '
                f'{percent(item["noise_floor"])}'
                + f', and noise with small errors {percent(errors)}' * may_be_none))
    ratio, where = max(cases, default=(0.0, ''))
    return where if ratio > 1.0 else ''


def _misfits(document: VerdictDocument) -> list[tuple[str, str, ChannelEntry]]:
    """Channel, run and misfits of every channel of the motion."""
    return [(name, bag_name(run['bag']), item) for run in document.get('runs', [])
            for name, item in run['channels'].items() if name != 'parity']


def _beside(document: VerdictDocument, rest: Mapping[str, Any]) -> str:
    """What the model leaves with small errors of the ring, which a rest does not count."""
    most: dict[str, float] = {}
    for name, _, item in _misfits(document):
        left = item['nrmse_after'] or 0.0
        if left > math.hypot(rest['share_of_range'], item['noise_floor'] or 0.0):
            most[name] = max(left, most.get(name, 0.0))
    if not rest.get('along') or not most:
        return ''
    told = wording.joined([f'{percent(most[name])} in {name}'
                           for name in sorted(most, key=lambda name: -most[name])])
    return f' beside small errors of the ring (with these, the model leaves up to {told})'


def partial_words(document: VerdictDocument) -> str:
    """What explains a part of the misfit of an `unknown`, and the shapes of its residual."""
    if document['verdict'] != 'unknown':
        return ''
    standing = wording.PARTIAL if document.get('remainder') else (
        f'may explain the misfit, but {wording.OPEN}')
    words = [f'{title_of(cause["effect"])} ({size_of(cause)}) '
             f'{wording.ABSENT if cause.get("may_be_absent") else standing}.'
             for cause in causes_of(document)]
    shapes = '; '.join(shape_words(cause) for cause in document['causes']
                       if 'effect' not in cause)
    return ' '.join([*words, f'Shape of the residual: {shapes}.' if shapes else '']).strip()


def tried(document: VerdictDocument) -> str:
    """What was tried before an `unknown`; '' for other verdicts."""
    if document['verdict'] != 'unknown':
        return ''
    return wording.tried_words(
        len(document.get('detection_limits') or ()), len(document.get('candidates') or ()),
        has_law=bool(document.get('proposal')))


def _sound_words(document: VerdictDocument) -> str:
    """Where small errors of a sound ring explain the residual: the channel with the largest.

    One beyond what `validate` allows comes first, with the size of a cause that it may hide.
    """
    cases = [(misfit > quantities.allowed_misfit(floor, sound), misfit, floor, sound, name)
             for name, _, item in _misfits(document) for misfit, floor, sound in [(
                 item['nrmse_before'] or 0.0, item['noise_floor'] or 0.0,
                 item.get('sound') or 0.0)] if misfit > quantities.allowed_misfit(floor)]
    if not cases:
        return ''
    is_more, misfit, floor, sound, name = max(cases)
    expected = percent(math.hypot(floor, sound))
    hidden = percent(math.sqrt(misfit**2 - floor**2))
    but = (f'although noise and these leave only {expected} rms: a cause of up to {hidden} of '
           'range may be hidden there' if is_more else
           f'where noise and these leave {expected} rms')
    return ('or the effect of unequal rollers, clearances and the weight of a sound ring '
            f'({percent(misfit)} of range in {name}, {but}), ')


def gain_sentence(document: VerdictDocument) -> str:
    """The misfit reduction of the extension, with that on held-out runs if there are some."""
    gain = document.get('gain')
    # A steady line is no part of the model: its own gain is told with the cause.
    if (not causes_of(document) or gain is None or gain.get('fit') is None
            or gain.get('how') == 'none'):
        return ''
    how = wording.PREDICTED.get(gain.get('how', ''), 'other runs')
    held_out = gain.get('held_out')
    words = wording.change_words([(held_out, how), (gain['fit'], 'fitted runs')])
    unchecked = ' No run was held out to check this.' if held_out is None else ''
    return f'The extended model {words}.{unchecked}'


def size_of(cause: CauseEntry) -> str:
    """Place and size of a cause, and others: 'probe 2 gain +3.0 ± 0.2 % or probe 4 gain -3 %'.

    Of several sizes those that surely move most, each as a multiple of its typical size. Of a
    place of several parts, of which one is sure, all. Of a line: 'amplitude 2.10 µm at 50.0 Hz'.
    """
    fitted, effect, moved = sizes_of(cause), catalogue().get(cause['effect']), {}
    for parameter in effect.parameters if effect is not None else ():
        if parameter.amplitude and parameter.name in fitted:
            size = fitted[parameter.name]
            sure = abs(size['value'] - parameter.neutral) - WIDTH_95 * size['std']
            moved[parameter.name] = max(sure, 0.0) / parameter.scale
    most = max(moved.values(), default=0.0)
    main = [name for name in moved if most and moved[name] >= MAIN_SIZE * most]
    parts = {name for one in (effect.variants if effect else ()) for name in one.frees}
    if len(main) == 1 and not parts & {*main}:
        main = [name for name in moved if name in parts or name in main]
    sizes = _size_words(cause['effect'], {name: fitted[name] for name in main or list(fitted)[:1]})
    words = ' '.join(filter(None, (place_of(cause), ', '.join(sizes))))
    if _is_line(cause['effect']):
        words += f' at {quantity(fitted["frequency"]["value"], fitted["frequency"]["unit"])}'
    return words + elsewhere_words(cause)


def elsewhere_words(cause: CauseEntry) -> str:
    """Every other place that these data leave open, with its size: ' or probe 4 gain -3.1 %'."""
    effect_id, choices = cause['effect'], choices_of(cause['effect'])
    name = next(name for name in cause['parameters'] if name not in choices)
    return ''.join(
        f' or {variant_words(effect_id, {choice: values[choice] for choice in choices})} {name} '
        f'{value_words(effect_id, name, values[name], cause["parameters"][name]["unit"])}'
        for values in cause.get('elsewhere', ()))


def parameter_words(cause: CauseEntry) -> str:
    """Place of a cause and all its fitted parameters, and other open places, in one line."""
    fitted = {name: size for name, size in sizes_of(cause).items()
              if size['std'] or size['unit'] not in ('', '1')}
    told = ', '.join(filter(None, (place_of(cause), *_size_words(cause['effect'], fitted))))
    return told + elsewhere_words(cause) if told else size_of(cause)


def _is_line(effect_id: str) -> bool:
    effect = catalogue().get(effect_id)
    return effect is not None and effect.line


def sizes_of(cause: CauseEntry) -> dict[str, SizeEntry]:
    """The fitted parameters of a cause by name; a steady line has an amplitude and a frequency."""
    choices = choices_of(cause['effect'])
    sizes = {name: size for name, size in cause['parameters'].items() if name not in choices}
    if not _is_line(cause['effect']):
        return sizes
    cosine, sine, frequency = sizes.values()
    value = math.hypot(cosine['value'], sine['value'])
    # The phase of a line is free, so that its two parts have the same error.
    return {'amplitude': {**cosine, 'value': value}, 'frequency': frequency}


def _size_words(effect_id: str, sizes: Mapping[str, SizeEntry]) -> list[str]:
    """Parameters with their values and errors, in a suitable unit and with their signs."""
    return [f'{name} ' + value_words(effect_id, name, size['value'], size['unit'], size['std'])
            for name, size in sizes.items()]


def value_words(effect_id: str, name: str, value: float, unit: str = '',
                std: float | None = None) -> str:
    """A value with its error: shares in percent, a sign if both signs are possible.

    unit: '' for that of the catalogue.
    """
    effect = catalogue().get(effect_id)
    for parameter in effect.parameters if effect is not None else ():
        if parameter.name == name:
            unit = unit or parameter.unit
            if parameter.amplitude and unit == '1':
                return quantities.signed_percent(value, std, is_signed=not parameter.one_sided)
    return quantity(value, '' if unit == '1' else unit, std)


def limit_words(effect_id: str, size: float | None, unit: str) -> str:
    """A detection limit, which is a size of the first parameter of an effect."""
    effect = catalogue().get(effect_id)
    if size is None or (effect is None and unit != '1'):
        return quantity(size, unit)
    return quantities.signed_percent(size) if effect is None else value_words(
        effect_id, effect.parameters[0].name, size, unit)


def effect_rows(effects: Mapping[str, Mapping[str, float]]) -> list[list[str]]:
    """Every 'effect.parameter' of a file with its value; of waves the rms of each row."""
    return [[f'{effect}.{name}', value_words(effect, name, value, 'm' if is_waves else '')]
            for effect, values in effects.items() for is_waves in [effect == RacewayWaves.id]
            for name, value in (rms_of(by_row(values)) if is_waves else values).items()]


def choices_of(effect_id: str) -> frozenset[str]:
    """Names of the parameters of an effect that are chosen and not fitted."""
    if effect_id == REVERSED:
        return frozenset({'probe'})
    effect = catalogue().get(effect_id)
    return frozenset() if effect is None else frozenset(choice.name for choice in effect.choices)


def place_of(cause: CauseEntry) -> str:
    """The variant of a cause in words, for instance the probe; '' if it has one form only."""
    names = choices_of(cause['effect'])
    choices = {name: size['value'] for name, size in cause['parameters'].items() if name in names}
    return variant_words(cause['effect'], choices) if choices else ''


def variant_words(effect_id: str, choices: Mapping[str, float]) -> str:
    """The variant of an effect with these fixed values, in words."""
    effect = catalogue().get(effect_id)
    for variant in effect.variants if effect is not None else ():
        if variant.label and all(variant.values.get(k) == v for k, v in choices.items()):
            return variant.label
    return ', '.join(f'{name} {value:g}' for name, value in choices.items())


def why_lost(candidate: CandidateEntry, best: CandidateEntry, chosen: Collection[str],
             alike: Collection[str]) -> str:
    """Whether a candidate was chosen or dropped beside the best of its step, and why."""
    effect_id = candidate['effects'][-1]
    if candidate is best and effect_id in chosen:
        return 'chosen: it explains most'
    if (candidate['p_value'] or 0.0) > quantities.CHANCE:
        return 'dropped: no better than chance'
    behind = (best['delta_bic'] or 0.0) - (candidate['delta_bic'] or 0.0)
    if effect_id in chosen:
        return 'chosen in another step'
    if effect_id in alike:
        return f'alternative: {quantities.compact(behind)} less evidence, a similar signature'
    if (candidate['share_of_range'] or 0.0) < quantities.MATERIAL:
        return 'dropped: too small to matter'
    if candidate is best:
        return 'best of this step, but not enough to be named'
    return f'dropped: {quantities.compact(behind)} less evidence than the best'


def shape_words(shape: ShapeEntry) -> str:
    """'delta_x follows the load, 0.4 % of range rms'; a fast part has words of its own."""
    if shape.get('shape'):
        return str(shape['shape'])
    words = COORDINATES.get(shape['coordinate'], shape['coordinate'])
    return f'{shape["channel"]} {words}, {percent(shape["share_of_range"])} of range rms'


def document_text(document: VerdictDocument) -> str:
    """Verdict, next test, misfit reduction, open questions, in plain lines."""
    verdict = document['verdict']
    lines = [verdict_line(verdict), headline(document),
             partial_words(document), gain_sentence(document),
             *wording.certainty_lines(document, lowered_titles), tried(document)]
    sizes = [f'{ENTRIES[limit["effect"]]} {quantity(limit["limit"], limit["unit"], digits=2)}'
             for limit in document.get('detection_limits') or []
             if limit['effect'] in ENTRIES and limit['testable']]
    if sizes and verdict == 'none':
        lines.append(f'Errors of the rig file below these sizes may not show: {", ".join(sizes)}.')
    if document['next_test']:
        lines.append(f'next test: {document["next_test"]}')
    lines = [*filter(None, lines), '']
    for cause in causes_of(document):
        lines += wording.cause_lines(
            cause, parameter_words(cause), lowered_titles, document['gain'].get('how', ''),
            document.get('remainder'))
    lines += proposal_lines(document.get('proposal'))
    is_extended = bool(causes_of(document))
    if lines[-1]:
        lines.append('')
    lines += ["Misfit by run and channel, rms in % of the channel's range (of parity its own, "
              'which is noise; elsewhere that of the motion), counted from the zero of the run '
              f'({base_words(document.get("raceways", ()))} / '
              + ('extended model / noise)' if is_extended else 'noise)')
              + (', small errors of the ring counted:' if document.get('remainder') else ':')]
    for run in document['runs']:
        columns = ['nrmse_before', *(['nrmse_after'] if is_extended else []), 'noise_floor']
        shares = ', '.join(
            f'{name} ' + ' / '.join('-' if (share := cast(Shares, misfit)[key]) is None else
                                    f'{100.0 * share:.2f}' for key in columns)
            for name, misfit in run['channels'].items())
        role = ' (held out)' if run['held_out'] else ''
        lines.append(f'  {bag_name(run["bag"])}{role}: {shares}')
    lines += ['', 'Contact parameters (before -> after):' if is_extended else
              'Contact parameters:', *_parameter_lines(document, is_extended)]
    return '\n'.join([*lines, *(f'note: {note}' for note in document['notes'])])


def _parameter_lines(document: VerdictDocument, is_extended: bool) -> list[str]:
    before, after = document['parameters']['before'], document['parameters']['after']
    open_after = document['parameters'].get('undetermined', {}).get('after', {})
    lines = []
    for name in PARAMETER_NAMES:
        if name in before and name in after:
            shown = quantity(after[name], PARAMETER_UNITS[name], after.get(f'{name}_std'))
            shown = f'{quantity(before[name])} -> {shown}' if is_extended else shown
            lines.append(f'  {name}: {shown}')
            if name in open_after:
                lines[-1] = '  ' + undetermined_words(name, shown, open_after[name])
    first, last = map(stiffnesses_per_millimetre, (before, after))
    for name in sorted(first.keys() & last):
        best_known = 'best known ' if {name, f'n{name[1]}'} & open_after.keys() else ''
        shown = f'{quantity(first[name])} -> ' if is_extended else ''
        lines.append(f'  {name}: {best_known}{shown}{quantity(last[name], "N/mm^n")}')
    return lines
