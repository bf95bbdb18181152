"""Chapters of a report, each made from a verdict's JSON or from the curves of the runs."""

from collections.abc import Collection, Mapping, Sequence
import math
from typing import Any

import numpy as np

from saddlering_ros import quantities
from saddlering_ros.diagnosis import ring_wording
from saddlering_ros.diagnosis.rig_dimensions import entry_of
from saddlering_ros.diagnosis.ring_wording import bag_name, causes_of, value_words, VerdictDocument
from saddlering_ros.discrepancy import CauseEntry, wording
from saddlering_ros.effects import catalogue
from saddlering_ros.identification.result import beside_errors_words, INTERVALS
from saddlering_ros.identification.uncertainty import UNDETERMINED
from saddlering_ros.pages import html
from saddlering_ros.pages.html import Cell, code, number
from saddlering_ros.quantities import compact, percent, probability, quantity, span
from saddlering_ros.report import figures
from saddlering_ros.report.figures import Array, RunCurves, SYMBOLS
from saddlering_ros.rig import CHANNELS, PARAMETER_NAMES, PARAMETER_UNITS, ParameterSet
from saddlering_ros.rig.units import stiffnesses_per_millimetre

CANDIDATES_SHOWN = 12  # a page; the JSON has all
TESTS_SHOWN = 6  # a page; the JSON has all


def verdict_banner(document: VerdictDocument, curves: Sequence[RunCurves] = ()) -> str:
    """The verdict, the next test, the misfit reduction, and the figure that shows the cause.

    The figure shows the channel whose misfit the verdict changes most, or has the largest misfit.
    """
    verdict, next_test = document['verdict'], document.get('next_test')
    has_cause, shown = verdict in ('named', 'ambiguous'), {run.name: run for run in curves}
    cases = [
        (run['held_out'], (misfit['nrmse_before'] or 0.0)
         - ((misfit['nrmse_after'] or 0.0) if has_cause else 0.0), shown[bag_name(run['bag'])],
         name)
        for run in document['runs'] if bag_name(run['bag']) in shown
        for name, misfit in run['channels'].items() if name != 'parity']
    return html.verdict(
        verdict, ring_wording.headline(document),
        html.paragraph(ring_wording.partial_words(document)),
        html.paragraph(f'Next test: {next_test}' if next_test else '', 'next'),
        html.paragraph(ring_wording.gain_sentence(document)),
        *map(html.paragraph, wording.certainty_lines(document, ring_wording.lowered_titles)),
        html.paragraph(ring_wording.tried(document)),
        proof_picture(*max(cases, key=lambda case: case[:2])[2:]) if cases else '')


def proof_picture(run: RunCurves, channel: str) -> str:
    """One channel of one run, large, with its residual below."""
    return html.picture(
        figures.proof(run, channel), 'proof', f'{run.label}, {SYMBOLS[channel]}: measured and '
        'simulated; below, the residual, with bands of twice the noise floor and, where known, '
        'of a sound ring.')


def causes(document: VerdictDocument) -> str:
    """Each cause with its numbers, its look-alikes and the test that would confirm the cause."""
    shapes = [ring_wording.shape_words(cause) for cause in document['causes']
              if 'effect' not in cause]
    return html.section(
        'Causes', html.paragraph('The residual has this shape:' if shapes else ''),
        html.bullets(shapes),
        *(_cause(cause, document) for cause in ring_wording.causes_of(document)),
        simulated_tests(document))


def simulated_tests(document: VerdictDocument) -> str:
    """Possible next tests with how often each leaves the true cause alone, the best first."""
    rows = [[test['test'], f'{"" if test["refitted"] else "up to "}{percent(test["share_alone"])}',
             ' to '.join(map(percent, test['interval_95'])) if test['refitted'] else '–',
             percent(test['share_kept']), 'refits' if test['refitted'] else 'linear forecast']
            for test in (document.get('simulated_tests') or [])[:TESTS_SHOWN]]
    return html.table(
        ['possible next test', number('leaves the true cause alone'), number('95 % interval'),
         number('keeps the true cause'), 'judged by'], rows,
        'Simulated draws of each test, with each open cause as the truth in turn. A linear '
        'forecast can promise too much')


def _cause(cause: CauseEntry, document: VerdictDocument) -> str:
    effect_id, title = cause['effect'], ring_wording.title_of(cause['effect'])
    effects, where = catalogue(), ring_wording.place_of(cause)
    effect = effects.get(effect_id)
    words = {} if effect is None else {item.name: item.words for item in effect.parameters}
    fitted = [['where', where + ring_wording.elsewhere_words(cause), '']] if where else []
    fitted += [[name, value_words(effect_id, name, item['value'], item['unit'], item['std']),
                words.get(name, '')]
               for name, item in ring_wording.sizes_of(cause).items()]
    tried = {item['effects'][-1]: item['delta_bic'] for item in reversed(
        document.get('candidates') or []) if item['effects']}
    alike: list[list[str | Cell]] = [
        [ring_wording.title_of(name), code(name), compact(tried.get(name), 4),
         effects[name].settled_by if name in effects else
         f'{entry_of(name)} of the rig file, compared with the drawing and the ring.']
        for name in cause['group']]
    is_alone = len(alike) == 1
    is_next = quantities.lowered(title) in (document.get('next_test') or '')
    partial = wording.standing(document.get('remainder'), cause)
    evidence, gain = cause['evidence'], cause['gain']
    predicted = wording.PREDICTED.get(document['gain'].get('how', ''), 'held-out runs')
    return '\n'.join([
        f'<h3>{html.escape(title)} <code>{html.escape(effect_id)}</code>{partial}</h3>',
        html.paragraph('' if effect is None else effect.words),
        html.table(['parameter', number('value ± standard deviation'), ''], fitted),
        html.table(['', number('')], [
            ['misfit reduction on fitted runs', percent(gain['fit'])],
            [f'misfit reduction on {predicted}', percent(gain['held_out'])],
            ["largest share of a channel's range", percent(cause['share_of_range'])],
            ['probability by chance alone', probability(evidence['p_value'])],
            ['evidence (ΔBIC)', compact(evidence['delta_bic'])]]),
        html.table(['alternatives for these data', 'id', number('alone at first (ΔBIC)'),
                    'measurement that tells them apart'], [] if is_alone else alike),
        html.paragraph(f'To confirm it: {effect.settled_by}'
                       if effect is not None and is_alone and not is_next else '', 'note')])


FROM_ZERO = 'Counted from the zero of the run. '
RED = ('Red: more than twice what noise and small errors of a sound ring leave, and more than '
       '0.1 % of range. ')


def misfit(document: VerdictDocument) -> str:
    """Runs and channels before and after against the noise."""
    runs, is_extended = document['runs'], bool(ring_wording.causes_of(document))
    rows: list[list[str | Cell]] = []
    for run in runs:
        for name, channel in run['channels'].items():
            floor = channel['noise_floor']
            allowed = quantities.allowed_misfit(floor, channel.get('sound'))
            shares = [number(percent(value), '' if value is None or floor is None else
                             'bad' if value > allowed else 'good')
                      for value in (channel['nrmse_before'], channel['nrmse_after'])]
            rows.append([
                bag_name(run['bag']), run['test'], f'{run["elevation_deg"]:g}°',
                'held out' if run['held_out'] else 'fitted', code(name), shares[0],
                shares[1] if is_extended else '', percent(floor)])
    return html.section(
        'Misfit by run and channel',
        html.picture(
            figures.misfit(document), 'misfit', 'Rms misfit of each channel '
            f'in each run, beside noise alone and a sound ring. {FROM_ZERO}'),
        html.folded('Table of the figure', html.table(
            ['run', 'test', number('elevation'), 'role', 'channel',
             number(ring_wording.base_words(document.get('raceways', ()))),
             number('extended model'), number('noise floor')], rows,
            f"Rms misfit over the channel's range in that run. {FROM_ZERO}Small errors of the "
            'ring are a part of it, and no part of the rest that fits no cause. Parity is zero '
            f'for a rigid ring: its range is noise, so that its shares are large. {RED}')))


def paper_split(curves: Sequence[RunCurves]) -> str:
    """Measured and simulated as the published tests show them: one figure per kind of test.

    At most three runs each: the first at each elevation, fitted ones before those held out.
    """
    parts = []
    for test, words in (('static', 'over load'), ('dynamic', 'over time')):
        chosen: dict[float, RunCurves] = {}
        for run in sorted(curves, key=lambda run: run.held_out):
            if run.test == test:
                chosen.setdefault(round(run.elevation_deg, 1), run)
        if chosen:
            parts.append(html.picture(
                figures.comparison(list(chosen.values())[:3]), f'comparison_{test}',
                f'{test.capitalize()} tests {words}: δx, δy and γ, measured and simulated; below '
                'each, measured minus simulated, with bands of twice the noise floor and, where '
                'known, of a sound ring.'))
    return html.section('Simulation and measurement', *parts)


def residual_map(curves: Sequence[RunCurves]) -> str:
    """The misfit over load, by run and branch, before and after."""
    if not curves:
        return ''
    return html.section('Residual map', html.picture(
        figures.residual_map(curves), 'residual_map', 'Mean of measured minus simulated in '
        'units of the noise floor. Columns: load. Rows: run and branch. White: no more than '
        'noise; brown: simulation too large; violet: simulation too small; grey: not measured.'))


def residuals(curves: Sequence[RunCurves]) -> str:
    """One figure per run: misfit of every channel over load, branch, time, rate and frequency."""
    return html.section('Misfit, run by run', html.paragraph(
        'A half-difference other than zero is a loop (friction, creep, delay). A curved mean '
        'comes from stiffness, clearance or the load path.', 'soft'), *(
        html.folded(run.label, html.picture(
            figures.residuals(run), f'misfit_{run.name}', 'Measured minus simulated. Columns: '
            'over load (triangles up: load rising); mean and half-difference of both branches; '
            'over time; ' + ('' if run.test == 'static' else 'over load rate; ')
            + 'amplitude spectrum.')) for run in curves))


def shape_tests(document: VerdictDocument) -> str:
    """Tests on the residual: channel by coordinate, before and after."""
    shapes = document.get('shapes')
    if not shapes:
        return ''
    before, after = ({(item['channel'], item['coordinate']): item for item in shapes[key]}
                     for key in ('before', 'after'))
    coordinates, tested = (sorted({key[place] for key in before}) for place in (1, 0))
    rows: list[list[str | Cell]] = []
    for channel in [name for name in CHANNELS if name in tested]:  # no parity without a probe
        rows.append([code(channel)])
        for coordinate in coordinates:
            pair = before.get((channel, coordinate)), after.get((channel, coordinate))
            if pair[0] is None or pair[1] is None:
                rows[-1].append(number('–'))
                continue
            shares = ' → '.join(percent(item['share_of_range']) for item in pair if item)
            chances = ' → '.join(probability(item['p_value']) for item in pair if item)
            rows[-1].append(Cell(
                f'{html.escape(shares)}<br><span class="soft">p {html.escape(chances)}</span>',
                is_number=True, is_html=True, mark='bad' if quantities.is_left(
                    pair[1]['p_value'], pair[1]['share_of_range']) else ''))
    return html.section(
        'Dependence of the misfit on load, direction, rate and time',
        html.table(['channel', *(number(f'on {name}') for name in coordinates)], rows,
                   'Rms of the part of the misfit that follows each coordinate, as a share of '
                   'range (of parity: that of the motion), and its p-value (with the correlated '
                   'noise measured at rest); '
                   'without → with the extension. Red: p < 0.01 and over 0.1 % of range.'))


def candidates(document: VerdictDocument) -> str:
    """Every fitted candidate with its evidence, and real effects that are too small."""
    fitted, small = document.get('candidates') or [], document.get('immaterial') or []
    chosen = {cause['effect'] for cause in causes_of(document)}
    alike = {name for cause in causes_of(document) for name in cause['group']}
    parts = [html.paragraph(
        'Each candidate was refitted with the contact parameters free, on all fitted runs and all '
        'four probes. ΔBIC above 10 is strong evidence for the candidate.', 'soft')
        if fitted else '']
    for step in sorted({model['step'] for model in fitted}):
        members = sorted((model for model in fitted if model['step'] == step),
                         key=lambda model: -(model['delta_bic'] or 0.0))
        left = len(members) - CANDIDATES_SHOWN
        parts += [html.heading('First cause' if step == 1 else f'Cause number {step}'), html.table(
            ['model', 'fitted', number('evidence (ΔBIC)'), number('p'), number('share of range'),
             'outcome'],
            [[Cell(' + '.join(f'<code>{html.escape(name)}</code>' for name in model['effects']),
                   is_html=True),
              _fitted_words(model),
              compact(model['delta_bic'], 4), probability(model['p_value']),
              percent(model['share_of_range']),
              ring_wording.why_lost(model, members[0], chosen, alike)]
             for model in members[:CANDIDATES_SHOWN]]), html.paragraph(
            f'{left} further candidates explain less.' if left > 0 else '', 'note')]
    return html.section(
        'Evidence', *parts, html.heading('Real, but too small to matter') if small else '',
        html.bullets([
            f'{" + ".join(map(ring_wording.title_of, model["effects"]))}: '
            f'{percent(model["share_of_range"])} of range, p {probability(model["p_value"])}'
            for model in small]))


def _fitted_words(model: Mapping[str, Any]) -> str:
    """Sizes of the effect that a candidate model has last, and its choices."""
    effect_id = model['effects'][-1]
    values, effect = model['parameters'].get(effect_id, {}), catalogue().get(effect_id)
    units = {} if effect is None else {item.name: item.unit for item in effect.parameters}
    choices = {name: value for name, value in values.items() if name not in units}
    parts = [ring_wording.variant_words(effect_id, choices)] if choices else []
    return ', '.join(parts + [f'{name} {value_words(effect_id, name, value, units[name])}'
                              for name, value in values.items() if name in units])


def detection_limits(document: VerdictDocument) -> str:
    """The smallest size of every effect that these data could have shown."""
    rows: list[list[str | Cell]] = []
    for entry in document.get('detection_limits') or []:
        dark, places = sum(place['limit'] is None for place in entry['places']), entry['places']
        never = f'; never in {dark} of {len(places)} configurations' if dark else ''
        limit, best, material = (
            ring_wording.limit_words(entry['effect'], size, entry['unit'])
            for size in (entry['limit'], entry['best_limit'], entry['material_limit']))
        rows.append([
            ring_wording.title_of(entry['effect']), code(entry['effect']),
            limit + never if entry['testable'] else number('cannot be seen', 'bad'),
            best if entry['testable'] else '', material, percent(entry['share'])])
    return html.section('Detection limits of these data', html.folded(
        'Detection limit of every cause in the catalogue',
        html.table(
            ['cause', 'id', *map(number, (
                'detection limit', 'limit, best configuration', 'material from',
                'own share of signature'))], rows,
            'Detection limit: size of the first parameter that is found nine times in ten, in '
            'nine of ten configurations (probe, arc) in which the cause shows. Material: changes '
            'a channel by 0.1 % of its range. The last column is the share of the signature that '
            'contact parameters cannot imitate.'))) if rows else ''


def notes(document: VerdictDocument) -> str:
    """Limits of the data, and how the diagnosis was run."""
    took = [f'The diagnosis took {document["seconds"]:.0f} s; seed {document.get("seed")}.'
            ] if document.get('seconds') is not None else []
    return html.section('Notes', html.bullets([*(document.get('notes') or []), *took]))


def proposal(document: VerdictDocument, force_unit: str = 't') -> str:
    """The proposed law with its curve, misfit reduction and doubts; empty without a law."""
    law = document.get('proposal')
    if not law:
        return ''
    gain, kept = law['gain'], law['gain']['held_out']
    parts = [html.paragraph('A proposal; the verdict stays unknown.', 'soft'), html.paragraph(
        'The law ' + wording.change_words(
            [(gain['fit'], 'fitted runs'), (kept, 'held-out runs')]) + '.')]
    for place, term in enumerate(law['terms'], start=1):
        words = f'{term["channel"]} += {term["law"]} in {term["coordinate"]}'
        parts += [
            html.heading(words), html.commands([term['formula']]),
            html.table(['parameter', number('value ± standard deviation')], [
                [code(name), quantity(item['value'], item['unit'], item['std'])]
                for name, item in term['parameters'].items()]),
            html.picture(figures.proposed_law(term, force_unit), f'proposal_{place}',
                         f'{words}: the addition, with twice its standard deviation (dotted).')]
    files = ', '.join(law['effect_files'])
    return html.section(
        'A law that would explain the misfit', *parts,
        html.heading('Doubts') if law['doubts'] else '', html.bullets(law['doubts']),
        html.paragraph(f'Effect file, for the next diagnosis: {files}.' if files else '', 'note'))


STRONG = 0.9
"""A correlation of parameters beyond which neither is known without the other."""

Row = list[str | Cell]
HEAD = ('parameter', number('value ± standard deviation'), number('95 % interval'), '')
ASSUMPTION = ('Every dimension of the rig is an assumption of this project, so the parameters are '
              "equivalent ones: they reproduce the ring's response, not a single roller's.")
OF_NOISE = ('Where no cause is in the model, standard deviations of a parameter file count noise '
            'alone. They hold for another test of the same ring. The intervals of identify also '
            'allow for unequal rollers.')


def identified(document: Mapping[str, Any], words: str = '') -> str:
    """Result of an identification: values, errors, intervals, undetermined parameters."""
    items, beside = document['parameters'], document.get('beside_errors')
    rows = _of_parameters(items)
    rows += _per_millimetre({name: item['value'] for name, item in items.items()},
                            [name for name, item in items.items() if item['reason']])
    covariance = np.array([[math.nan if value is None else value for value in row]
                           for row in document.get('covariance') or []])
    return html.section(
        'Identification',
        html.paragraph(f'{document["evaluations"]} simulations in {document["elapsed"]:.1f} s; '
                       f'{document["status"]}.'),
        html.table(HEAD, rows, words), html.paragraph(INTERVALS, 'note'),
        html.table(HEAD, _of_parameters(beside['parameters']), 'Beside small errors of the ring')
        + html.paragraph(beside_errors_words(
            beside['noise_factor'], beside['raceway_waves'])) if beside else '',
        html.picture(figures.joint_regions(document), 'joint_regions',
                     'K and n of a row, with noise and unequal rollers. A parameter without an '
                     'interval is not determined.')
        if document.get('joint') else '',
        correlation(covariance if covariance.shape == (6, 6) else None),
        html.paragraph(ASSUMPTION, 'note'), html.bullets(list(document.get('notes') or [])))


def _of_parameters(items: Mapping[str, Mapping[str, Any]]) -> list[Row]:
    """A row for each identified parameter."""
    return [[code(name), quantity(item['value'], item['unit'], item['std']),
             span(*item['interval']) if item['interval'] else '–',
             f'{UNDETERMINED}: {item["reason"]}' if item['reason'] else
             ('at its bound' if item['at_bound'] else '')] for name, item in items.items()]


def before_and_after(document: VerdictDocument, covariance: Array | None = None) -> str:
    """Contact parameters before and after, with intervals, correlation, and the bias removed."""
    first, last = document['parameters']['before'], document['parameters']['after']
    reasons = document['parameters'].get('undetermined', {}).get('after', {})
    is_extended = bool(causes_of(document))  # Without a cause, columns of the change are empty.
    rows: list[Row] = []
    for name in PARAMETER_NAMES:
        if name not in first or name not in last:
            continue
        std = None if name in reasons else last.get(f'{name}_std')
        ratio = first[name] / last[name]
        moved = '–' if name in reasons else '0 %' if abs(ratio - 1.0) < 5e-4 else (
            f'{100.0 * (ratio - 1.0):+.2g} %' if 0.5 < ratio < 1.5 else f'× {ratio:.2g}')
        rows.append([
            code(name), quantity(first[name], PARAMETER_UNITS[name]) if is_extended else '',
            quantity(last[name], PARAMETER_UNITS[name], std), interval(name, last[name], std),
            moved if is_extended else '',
            f'{abs(first[name] - last[name]) / std:.1f}' if std and is_extended else '–',
            f'{UNDETERMINED}: {reasons[name]}' if name in reasons else ''])
    rows += [[name, before_words if is_extended else '', after_words, *[''] * 3, reason]
             for (name, before_words, *_), (_, after_words, _, reason) in zip(
                 _per_millimetre(first, ()), _per_millimetre(last, reasons), strict=True)]
    return html.section(
        'Contact parameters',
        html.table(['parameter', *map(number, (
            'before', f'{"after" if is_extended else "value"} ± standard deviation',
            '95 % interval', 'bias removed', 'bias / std')), ''], rows),
        correlation(covariance),
        html.paragraph(ASSUMPTION + ' K and n of a row are strongly correlated: judge them '
                       'together.', 'note'))


def interval(name: str, value: float, std: float | None) -> str:
    """The 95 % interval about a parameter, of K and D by a factor as `identify` has it."""
    if not std:
        return '–'
    half = quantities.WIDTH_95 * std
    factor = math.exp(min(half / value, 50.0))
    return span(value - half, value + half) if name[0] == 'n' else span(
        value / factor, value * factor)


def _per_millimetre(values: Mapping[str, float], undetermined: Collection[str]) -> list[Row]:
    """K1 and K2 of parameters by name, each with its stiffness as catalogues give it."""
    return [[code(name), quantity(stiffness, 'N/mm^n'), '',
             UNDETERMINED if {name, f'n{name[1]}'} & set(undetermined) else '']
            for name, stiffness in stiffnesses_per_millimetre(values).items()]


def of_file(parameters: ParameterSet) -> str:
    """The parameter file: contact law with errors, effects, correlation, where it came from."""
    source, covariance = parameters.source, parameters.source.covariance
    spread = [None] * 6 if covariance is None else np.sqrt(np.diag(covariance)).tolist()
    values_of = dict(zip(PARAMETER_NAMES, parameters.contact.to_array().tolist(), strict=True))
    rows: list[Row] = []
    for (name, value), std in zip(values_of.items(), spread, strict=True):
        reason = source.undetermined.get(name)
        std = std if reason is None else None
        rows.append([code(name), quantity(value, PARAMETER_UNITS[name], std),
                     interval(name, value, std),
                     '' if reason is None else f'{UNDETERMINED}: {reason}'])
    rows += _per_millimetre(values_of, source.undetermined)
    rows += [[code(name), words, '', '']
             for name, words in ring_wording.effect_rows(parameters.effects)]
    words = 'As given' if source.method == 'given' else f'By the method "{source.method}"'
    words += f' from {", ".join(source.bags)}' if source.bags else ''
    return html.section(
        'Parameters',
        html.table(HEAD, rows, words + (f': {source.note}' if source.note else '')),
        correlation(covariance),
        html.paragraph('' if covariance is None or source.method == 'given' else OF_NOISE, 'note'),
        html.paragraph(ASSUMPTION, 'note'))


def correlation(covariance: Array | None) -> str:
    """A table of correlations of the contact parameters; empty if they are not known."""
    if covariance is None or not np.isfinite(covariance).all():
        return ''
    spread = np.sqrt(np.diag(covariance))
    scale = np.outer(spread, spread)
    shares = np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 0.0)
    rows: list[Row] = [
        [code(name), *(_heat(share) if size > 0.0 else Cell('–', mark='heat')
                       for share, size in zip(*of, strict=True))]
        for name, *of in zip(PARAMETER_NAMES, shares, scale, strict=True)]
    strong = '; '.join(
        f'{PARAMETER_NAMES[i]} and {PARAMETER_NAMES[j]}'
        for i, j in zip(*np.triu_indices(6, 1), strict=True) if abs(shares[i, j]) > STRONG)
    return html.heading('Correlation') + html.table(
        ['', *map(number, PARAMETER_NAMES)], rows) + html.paragraph(
        f'Strongly correlated: {strong}.' if strong else 'No correlation exceeds 0.9.', 'note')


def _heat(value: float) -> Cell:
    hue = '31,111,178' if value >= 0.0 else '209,73,91'
    return Cell(f'<span style="background:rgba({hue},{0.45 * abs(value):.2f});padding:1px 7px">'
                f'{value:+.2f}</span>'.replace('-', '−'), is_number=True, is_html=True)
