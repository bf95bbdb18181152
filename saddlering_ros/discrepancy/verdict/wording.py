"""Sentences of a verdict, for a ring and for a declared model alike, and the latter's summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from saddlering_ros.discrepancy.next_test import HeldOutEvidence
from saddlering_ros.discrepancy.verdict.results import CauseEntry, Diagnosis, Estimate
from saddlering_ros.quantities import (
    CHANCE,
    compact,
    percent,
    probability,
    quantity,
    shares_in_words,
    VERDICT_WORDS,
)

PARTIAL = ' (explains part of the misfit only)'
"""Words behind the title of a cause that is real beside something else that is wrong."""


MAX_RUNS = 4
"""Runs whose share of the evidence is told in a line."""

MIN_AGAINST = 0.01
"""Share of the evidence from which a run that speaks against the causes is told."""

MAX_SURE = 0.99
"""Largest probability that is told of alternatives."""


def verdict_line(verdict: str) -> str:
    """The verdict and what it means."""
    return f'verdict: {verdict} ({VERDICT_WORDS[verdict]})'


def gain_words(fitted: float, held_out: float | None) -> str:
    """Misfit reductions as percentages."""
    words = f'{percent(fitted)} on fitted runs'
    return words if held_out is None else f'{words}, {percent(held_out)} on held-out runs'


def cause_lines(cause: CauseEntry, values: str) -> list[str]:
    """A cause with its parameters, which are `values` in words, its gain and its alternatives."""
    lines = [
        f'  {cause["effect"]}: {cause["title"]}{PARTIAL if cause.get("partial") else ""}',
        f'    {values}',
        f'    misfit reduction {gain_words(cause["gain"]["fit"], cause["gain"]["held_out"])}; '
        f'p {probability(cause["evidence"]["p_value"])}',
    ]
    if len(cause['group']) > 1:
        lines.append('    alternatives that explain these data equally well: '
                     f'{", ".join(cause["group"][1:])}')
    return lines


def estimate_words(estimate: Estimate) -> str:
    """A value with its standard deviation and unit."""
    if estimate.std or estimate.unit:
        return quantity(estimate.value, estimate.unit, estimate.std)
    return compact(estimate.value)


def estimates_words(estimates: Mapping[str, Estimate]) -> str:
    """Values by name, in one line."""
    return ', '.join(f'{name} {estimate_words(one)}' for name, one in estimates.items())


def headline_of(diagnosis: Diagnosis) -> str:
    """Whether a cause is established, and what is left."""
    rest = ''
    if diagnosis.remainder:
        most = diagnosis.remainder[0]
        rest = rest_words(most.share_of_range, most.channel)
    if diagnosis.verdict == 'none':
        return 'These data show nothing that the simulation lacks.'
    if diagnosis.verdict == 'unknown':
        partial = ' and '.join(cause.definition.title for cause in diagnosis.causes)
        part = f'; {partial} explains a part only' if partial else ''
        return f'Something is wrong, and no cause is established{part}.{rest}'
    names = ' and '.join(
        ' or '.join(cause.group) if len(cause.group) > 1 else cause.definition.title
        for cause in diagnosis.causes)
    mainly = '' if diagnosis.complete else 'mainly '
    gain = diagnosis.gain
    return (f'The simulation lacks {mainly}{names}: '
            f'{share_words(gain.fit, gain.held_out)}.{rest}')


def share_words(fitted: float, held_out: float | None) -> str:
    """'91 % of the misfit on held-out runs'."""
    if held_out is None:
        return f'{percent(fitted)} of the misfit on fitted runs'
    return f'{percent(held_out)} of the misfit on held-out runs'


def rest_words(share_of_range: float, channel: str) -> str:
    """' A rest of 0.4 % of range in delta_y fits no cause.'."""
    return f' A rest of {percent(share_of_range)} of range in {channel} fits no cause.'


def free_test_words(evidence: Sequence[HeldOutEvidence]) -> str:
    """What held-out runs say about open alternatives, as the test that needs no record; or ''."""
    kept = [one for one in evidence if one.remains]
    if not kept or len(kept) == len(evidence):
        return ''
    runs = ' and '.join(evidence[0].runs)
    names = ' or '.join(one.title for one in kept)
    share = sum(one.share for one in kept)
    certain = f'{"over " if share > MAX_SURE else ""}{percent(min(share, MAX_SURE))}'
    return (f'Fit {runs} too: of the alternatives, {names} predicts {runs} best '
            f'({certain} of their probability).')


def certainty_words(probabilities: Mapping[str, float], stability: float) -> str:
    """Probabilities and stability of a verdict in one line; nothing without probabilities."""
    if not probabilities:
        return ''
    told = ', '.join(f'{name} {words}' for name, words in shares_in_words(probabilities).items())
    named = set(probabilities) - {'none', 'unknown'}
    same = 'have the same first cause' if named else 'find no cause either'
    return f'Probabilities: {told}. {percent(stability)} of the refits {same}.'


def limit_lines(near_limit: Sequence[str]) -> list[str]:
    """Why a verdict is near its limit, one line each."""
    return [f'near its limit: {reason}' for reason in near_limit]


def influence_words(influence: Sequence[tuple[str, float, float, float]]) -> str:
    """Which runs and stretches hold the evidence: run, start, end [s] and evidence of each.

    Nothing without evidence.
    """
    runs: dict[str, list[tuple[float, float, float]]] = {}
    for run, start, end, evidence in influence:
        runs.setdefault(run, []).append((evidence, start, end))
    sums = {run: sum(part[0] for part in parts) for run, parts in runs.items()}
    whole = sum(sums.values())
    if whole <= 0.0:
        return ''
    words = []
    for run in sorted(sums, key=lambda name: -sums[name])[:MAX_RUNS]:
        _, start, end = max(runs[run])
        if sums[run] > 0.0:
            words.append(f'{run} {percent(sums[run] / whole)} (most of it from {start:.3g} to '
                         f'{end:.3g} s)')
    against = [run for run, share in sums.items() if share < -MIN_AGAINST * whole]
    more = f'; against the causes: {", ".join(against)}' if against else ''
    return f'Evidence by run: {", ".join(words)}{more}.'


def tried_words(compared: int, refitted: int, *, has_law: bool) -> str:
    """What was tried before a verdict `unknown`; nothing if no effect was compared."""
    if not compared:
        return ''
    law = ('A law is proposed for it.' if has_law else 'No law over load, direction, rate or time '
           'passed the test of a cause, so that none is proposed.')
    return f'Tried: {compared} causes compared with the misfit, {refitted} models refitted. {law}'


def remaining_words(explained: float) -> str:
    """What a share of the misfit leaves: '12 % of the misfit'; '< 1 %' is never '0 %'."""
    left = 100.0 * (1.0 - explained)
    return f'{left:.0f} % of the misfit' if left >= 0.5 else '< 1 % of the misfit'


def summary_text(diagnosis: Diagnosis) -> str:
    """Verdict, causes, misfit reduction, parameters, warnings of a declared model."""
    lines = [verdict_line(diagnosis.verdict), diagnosis.headline]
    for cause in diagnosis.causes:
        lines += cause_lines(cause.entry(), estimates_words(cause.parameters))
    if diagnosis.separations:
        best = diagnosis.separations[0]
        lines.append(f'next test: {diagnosis.next_test} The test leaves the true cause alone in '
                     f'{round(100 * best.share)} of 100 simulated draws.')
    elif diagnosis.next_test:
        lines.append(f'next test: {diagnosis.next_test}')
    if diagnosis.causes:
        gain = diagnosis.gain
        lines.append(f'misfit reduction: {gain_words(gain.fit, gain.held_out)}')
    lines.append(certainty_words(diagnosis.probabilities, diagnosis.stability))
    lines += limit_lines(diagnosis.near_limit)
    if diagnosis.causes:
        lines.append(influence_words([
            (one.run, one.start, one.end, one.evidence) for one in diagnosis.influence]))
    if diagnosis.verdict == 'unknown':
        lines.append(tried_words(
            len(diagnosis.observability.limits), len(diagnosis.search.candidates),
            has_law=diagnosis.law is not None))
        after = diagnosis.residual_after
        tests = sorted((*after.consistency, *after.shapes), key=lambda test: test.p_value)
        shapes = [test for test in tests if test.p_value < CHANCE][:4]
        lines += [
            f'  residual: {shape.view} along {shape.coordinate}, {percent(shape.visible)} of range'
            for shape in shapes
        ]
    lines += ['', 'base parameters (alone -> with the causes):']
    lines += [
        f'  {name}: {estimate_words(diagnosis.base_alone[name])} -> {estimate_words(estimate)}'
        for name, estimate in diagnosis.base.items()
    ]
    lines += [f'warning: {warning}' for warning in diagnosis.warnings]
    if not diagnosis.converged:
        lines.append('not converged: a fit on which the verdict rests ended before its optimum')
    return '\n'.join(lines)
