"""The verdict in words for a terminal, from the same document as the report and the live page."""

from __future__ import annotations

from saddlering_ros.diagnosis.contract import CauseEntry, causes_of, RunEntry, shapes_of
from saddlering_ros.diagnosis.verdict import Verdict
from saddlering_ros.diagnosis.wording import (
    Document,
    gain_sentence,
    headline,
    parameter_words,
    shape_words,
)
from saddlering_ros.estimation.identifiability import undetermined_words
from saddlering_ros.quantities import percent, probability, quantity, VERDICT_WORDS
from saddlering_ros.rig import PARAMETER_NAMES, PARAMETER_UNITS, stiffness_per_millimetre


def verdict_text(verdict: Verdict) -> str:
    """Finding, next test, misfit reduction, open questions."""
    return document_text(verdict.to_json())


def document_text(document: Document) -> str:
    """The same from a verdict's JSON; plain lines."""
    verdict = document['verdict']
    lines = [f'verdict: {verdict} ({VERDICT_WORDS[verdict]})', headline(document),
             gain_sentence(document)]
    if document['next_test']:
        lines.append(f'next test: {document["next_test"]}')
    lines = [*filter(None, lines), '']
    for cause in causes_of(document):
        lines += _cause_lines(cause)
    if verdict == 'unknown':
        lines.append('Misfit that no effect of the catalogue explains:')
        lines += [f'  {shape_words(item)}' for item in shapes_of(document)]
    lines += proposal_lines(document)
    lines += ['', "Misfit by run and channel, rms in % of the channel's range "
              '(contact law alone / extended model / noise):']
    lines += [_run_line(run) for run in document['runs']]
    lines += ['', 'Contact parameters (before -> after):', *_parameter_lines(document)]
    return '\n'.join([*lines, *(f'note: {note}' for note in document['notes'])])


def proposal_lines(document: Document) -> list[str]:
    """The proposed law, its misfit reduction, and its doubts."""
    law = document.get('proposal')
    if not law:
        return []
    lines = ['', 'A law that would explain the misfit (a proposal; the verdict stays unknown):']
    for term in law['terms']:
        lines.append(f'  {term["channel"]} += {term["law"]} in {term["coordinate"]}: '
                     f'{term["formula"]}')
        lines += [
            f'    {name} {quantity(item["value"], item["unit"], item["std"])}'
            for name, item in term['parameters'].items()]
    gain = law['gain']
    kept = gain['held_out']
    held_out = '' if kept is None else f', {percent(kept)} on held-out runs'
    lines.append(f'  misfit reduction {percent(gain["fit"])} on fitted runs{held_out}')
    lines += [f'  doubt: {doubt}' for doubt in law['doubts']]
    return [*lines, *(f'  effect file: {path}' for path in law['effect_files'])]


def _cause_lines(cause: CauseEntry) -> list[str]:
    gain = cause['gain']
    kept = gain['held_out']
    held_out = '' if kept is None else f', {percent(kept)} on held-out runs'
    lines = [
        f'  {cause["effect"]}: {cause["title"]}'
        + (' (explains part of the misfit only)' if cause.get('partial') else ''),
        f'    {parameter_words(cause)}',
        f'    misfit reduction {percent(gain["fit"])} on fitted runs{held_out}; '
        f'p {probability(cause["evidence"]["p_value"])}',
    ]
    if len(cause['group']) > 1:
        lines.append('    alternatives that explain these data equally well: '
                     f'{", ".join(cause["group"][1:])}')
    return lines


def _run_line(run: RunEntry) -> str:
    shares = ', '.join(
        f'{name} ' + ' / '.join(
            '-' if share is None else f'{100.0 * share:.2f}'
            for share in (item['nrmse_before'], item['nrmse_after'], item['noise_floor']))
        for name, item in run['channels'].items())
    name = str(run['bag']).rstrip('/').rsplit('/', 1)[-1]
    return f'  {name}{" (held out)" if run["held_out"] else ""}: {shares}'


def _parameter_lines(document: Document) -> list[str]:
    before, after = document['parameters']['before'], document['parameters']['after']
    open_after = document['parameters'].get('undetermined', {}).get('after', {})
    lines = []
    for name in PARAMETER_NAMES:
        if name in before and name in after:
            shown = quantity(after[name], PARAMETER_UNITS[name], after.get(f'{name}_std'))
            lines.append(f'  {name}: {quantity(before[name])} -> {shown}')
            if name in open_after:
                lines[-1] = '  ' + undetermined_words(
                    name, f'{quantity(before[name])} -> {shown}', open_after[name])
    for row in (1, 2):
        names = (f'K{row}', f'n{row}')
        if all(name in item for name in names for item in (before, after)):
            first, last = (stiffness_per_millimetre(*(item[name] for name in names))
                           for item in (before, after))
            lines.append(f'  K{row}: {quantity(first)} -> {quantity(last, "N/mm^n")}')
    return lines
