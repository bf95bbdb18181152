"""Every sentence of a verdict, for a ring and for a declared model, and the latter's summary."""

from collections.abc import Mapping, Sequence
from typing import Any

from saddlering_ros import quantities
from saddlering_ros.discrepancy.problem.system import Estimate, Parameter
from saddlering_ros.discrepancy.search.lack_of_fit import FastResidual
from saddlering_ros.discrepancy.verdict import results
from saddlering_ros.discrepancy.verdict.results import Diagnosis, HeldOutEvidence, Refit, Remainder
from saddlering_ros.quantities import percent, quantity

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
    return f'verdict: {verdict} ({quantities.VERDICT_WORDS[verdict]})'


def gain_words(fitted: float, held_out: float | None) -> str:
    """Misfit reductions as percentages."""
    words = f'{percent(fitted)} on fitted runs'
    return words if held_out is None else f'{words}, {percent(held_out)} on held-out runs'


def cause_lines(cause: results.CauseEntry, values: str) -> list[str]:
    """A cause with its parameters, which are `values` in words, its gain and its alternatives."""
    lines = [
        f'  {cause["effect"]}: {cause["title"]}{PARTIAL if cause.get("partial") else ""}',
        f'    {values}',
        f'    misfit reduction {gain_words(cause["gain"]["fit"], cause["gain"]["held_out"])}; '
        f'p {quantities.probability(cause["evidence"]["p_value"])}',
    ]
    if len(cause['group']) > 1:
        lines.append('    alternatives that explain these data equally well: '
                     f'{", ".join(cause["group"][1:])}')
    return lines


def estimate_words(estimate: Estimate) -> str:
    """A value with its standard deviation and unit."""
    if estimate.std or estimate.unit:
        return quantity(estimate.value, estimate.unit, estimate.std)
    return quantities.compact(estimate.value)


def estimates_words(estimates: Mapping[str, Estimate]) -> str:
    """Values by name, in one line."""
    return ', '.join(f'{name} {estimate_words(one)}' for name, one in estimates.items())


def headline_of(diagnosis: Diagnosis) -> str:
    """Whether a cause is established, and what is left."""
    rest = ''.join(rest_words(most.share_of_range, most.channel)
                   for most in diagnosis.remainder[:1])
    if diagnosis.verdict == 'none':
        return 'These data show nothing that the simulation lacks.'
    if diagnosis.verdict == 'unknown':
        partial = ' and '.join(cause.definition.title for cause in diagnosis.causes)
        part = f'; {partial} explains a part only' if partial else ''
        left = f'; a {rest}' if rest else ''
        return f'Something is wrong, and no cause is established{part}{left}.'
    names = ' and '.join(
        ' or '.join(cause.group) if len(cause.group) > 1 else cause.definition.title
        for cause in diagnosis.causes)
    mainly = '' if diagnosis.complete else 'mainly '
    share = share_words(diagnosis.gain.fit, diagnosis.gain.held_out)
    left = f' A {rest}.' if rest else ''
    return f'The simulation lacks {mainly}{names}: {share}.{left}'


def share_words(fitted: float, held_out: float | None) -> str:
    """'91 % of the misfit on held-out runs'."""
    share, kind = (fitted, 'fitted') if held_out is None else (held_out, 'held-out')
    return f'{percent(share)} of the misfit on {kind} runs'


def rest_words(share_of_range: float, channel: str) -> str:
    """'rest of 0.4 % of range in delta_y fits no cause'."""
    return f'rest of {percent(share_of_range)} of range in {channel} fits no cause'


def remainder_line(remainder: Sequence[Mapping[str, Any]]) -> str:
    """The largest rests that fit no cause, in three units; '' without a rest."""
    words = '; '.join(map(quantities.remainder_words, remainder[:MAX_RUNS]))
    return f'Beyond noise and causes remain: {words}.' if words else ''


def free_test_words(evidence: Sequence[HeldOutEvidence]) -> str:
    """What held-out runs say about open alternatives, as the test that needs no record; or ''."""
    kept = [one for one in evidence if one.remains]
    if not kept or len(kept) == len(evidence):
        return ''
    runs = ' and '.join(evidence[0].runs)
    names = ' or '.join(one.title for one in kept)
    share = sum(one.share for one in kept)
    certain = f'{"over " if share > MAX_SURE else ""}{percent(min(share, MAX_SURE))}'
    return (f'Fit {runs} too: of the alternatives, the model with {names} predicts {runs} '
            f'best ({certain} of their probability).')


def certainty_words(probabilities: Mapping[str, float], stability: float) -> str:
    """Probabilities and stability of a verdict in one line; nothing without probabilities."""
    if not probabilities:
        return ''
    told = quantities.shares_in_words(probabilities)
    words = ', '.join(f'{name} {share}' for name, share in told.items())
    named = set(probabilities) - {'none', 'unknown'}
    same = 'have the same first cause' if named else 'find no cause either'
    return f'Probabilities: {words}. {percent(stability)} of the refits {same}.'


def limit_lines(near_limit: Sequence[str]) -> list[str]:
    return [f'near its limit: {reason}' for reason in near_limit]


def influence_words(influence: Sequence[tuple[str, float, float, float]]) -> str:
    """Which runs and stretches hold the evidence: run, start, end [s] and evidence of each.

    Shares count from what speaks for the causes, as on the page. Nothing without such a run.
    """
    runs: dict[str, list[tuple[float, float, float]]] = {}
    for run, start, end, evidence in influence:
        runs.setdefault(run, []).append((evidence, start, end))
    sums = {run: sum(evidence for evidence, *_ in parts) for run, parts in runs.items()}
    if max(sums.values(), default=0.0) <= 0.0:
        return ''
    whole = sum(max(evidence, 0.0) for *_, evidence in influence)
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


# Warnings: why causes have no name.

ONE_RUN = 'one run only: that the causes predict other runs is not shown'
WORSE_RUN = 'in one of the fitted runs the misfit is larger with the causes'
NO_SMALL_ERRORS = ('what remains is larger than small errors of everything that the catalogue '
                   'lists could be')
AS_LARGE = 'another cause, which is not established, moves about as much: which is main is open'
BY_CHANCE = 'an error like the one that remains could be this large by chance'
THREE_EFFECTS = 'three effects act in one channel: so many can fit any misfit'


def partial_words(ids: Sequence[str], explained: float, where: str) -> str:
    return (f'{remaining_words(explained)} remains, which is more than noise and model error in '
            f'{where}: {" and ".join(ids)} can only be a part of the cause')


def shape_words(ids: Sequence[str], where: str) -> str:
    return (f'{" and ".join(ids)}: what remains is too much of one shape, {where}, for errors of '
            'their laws or of the machine: they may stand for another cause')


def inputs_words(names: Sequence[str]) -> str:
    return (f'{" and ".join(names)}: the error of an input resembles other causes; it is '
            'established only without another cause, and only if it leaves no more than noise')


def crowded_words(count: int) -> str:
    return (f'{count} effects were needed for one channel: so many effects can fit any misfit, '
            'and none of them is certain')


def too_many_words(count: int, replaced: Sequence[str]) -> str:
    return (f'{count} effects were needed, and other effects can replace '
            f'{" and ".join(replaced)}: so many models can fit any misfit, and none of them is '
            'certain')


def replaced_words(name: str) -> str:
    return f'beside another cause, other effects can replace {name}'


def shape_at_bound_words(name: str, shape: Parameter, value: float) -> str:
    return (f'{name}: its {shape.name} is at the bound of {quantity(value, shape.unit)}: the '
            'cause has another shape than the bounds allow, so that it is not named')


def size_at_bound_words(name: str, size: Parameter, value: float) -> str:
    return (f'{name}: its {size.name} is at the bound of {quantity(value, size.unit)}: the size '
            'exceeds the expected range, or another cause contributes, so that it is not named')


def uncertain_size_words(name: str, low: float, high: float, unit: str) -> str:
    return (f'{name}: the 95 % interval of its size, {low:.3g} to {high:.3g} {unit}'.rstrip()
            + ', includes its absence')


def weak_words(name: str, taken: float, needed: float) -> str:
    return (f'{name} takes {percent(max(taken, 0.0))} of the power of the misfit beyond noise; '
            f'a cause is established from {percent(needed)} on, because a wrong cause can take '
            'nearly as much')


def outlier_words(name: str, times: float) -> str:
    return (f'{name} moves {times:.0f} times as much as the small errors of everything else that '
            'the catalogue lists; these explain what remains')


def no_outlier_words(name: str, times: float, needed: float) -> str:
    return (f'{name} moves {times:.0f} times as much as the small errors beside it; a cause is '
            f'established from {needed:.0f} times on')


def close_words(name: str, others: Sequence[str]) -> str:
    return f'without {name}, {" and ".join(others)} fit nearly as well beside small errors'


def suspect_words(ids: Sequence[str], doubts: Sequence[str]) -> str:
    return (f'if what remains is error of the model, the main cause is {" and ".join(ids)}, '
            f'and it is not established: {"; ".join(doubts)}')


def worse_view_words(view: str) -> str:
    return f'in {view}, where the causes move most, the misfit is larger with them'


def uncertain_gain_words(low: float, high: float) -> str:
    return (f'on runs that it predicts, the reduction of the misfit is between {percent(low)} and '
            f'{percent(high)}')


def worse_prediction_words(name: str, rise: float, *, is_held_out: bool) -> str:
    runs = 'held-out runs' if is_held_out else 'runs held out in turn'
    return (f'the model with {name} predicts {runs} worse: the misfit there rises by '
            f'{percent(rise)}, so that it is not named')


def unsteady_size_words(name: str, kind: str, least: float, most: float) -> str:
    return (f'{name}: with a size for each {kind}, it is {percent(least)} to {percent(most)} of '
            'the fitted one, which its interval does not allow: the law is another one')


def narrow_law_words(name: str, coordinate: str, share: float) -> str:
    return (f'{name}: a law of another shape over {coordinate} predicts {percent(share)} of what '
            'this one leaves in other runs')


def unshared_words(share: float, needed: float) -> str:
    return (f'{percent(share)} of the refits have the same first cause; an established cause has '
            f'{percent(needed)}: in most of them another cause comes first')


def shared_direction_words(name: str, other: str, share: float) -> str:
    return (f'{other}, of another size or sign, has {percent(share)} of the power of what {name} '
            'changes beyond the base: an effect that is not in the catalogue could have as much')


# Warnings beside a name.

NOT_CONVERGED = ('a fit on which the verdict rests had not converged: give more rounds by '
                 'Settings(max_rounds=...), narrower bounds or better starts')
REST_IS_ERROR = ('what remains is more than noise and fits no cause: every interval and '
                 'comparison of causes counts it as error of the model')


def beyond_declared_words(name: str, rest: Remainder, declared: float) -> str:
    return (f'{name} in {rest.run}: {percent(rest.share_of_range)} of range is left, more than '
            f'the declared model error of {percent(declared)}')


def other_form_words(explained: float, where: str) -> str:
    return (f'{remaining_words(explained)} remains with the extension, most of it in {where}: the '
            'law of the cause has another form, which explains it')


def oscillation_words(fast: FastResidual) -> str:
    return (f'{fast.view} oscillates at about {quantity(fast.frequency, "Hz", digits=2)} in '
            f'{fast.run} ({percent(fast.visible)} of range), which no cause explains')


# Why a verdict is near its limit.


def one_run_words(refit: Refit) -> str:
    return f'{refit.change} the first cause is {refit.first or "none"}: it hangs on that run'


def unstable_words(others: Sequence[Refit], count: int) -> str:
    return f'{len(others)} of {count} refits end in another first cause: ' + '; '.join(
        f'{refit.change}: {refit.first or "none"}' for refit in others[:3])


def almost_a_cause_words(name: str, share: float) -> str:
    return f'{name} reaches {percent(share)} of the evidence at which it would be a cause'


def barely_real_words(name: str, times: float) -> str:
    return f'{name} has {times:.1f} times the evidence at which a cause is real'


def barely_taken_words(taken: float, needed: float) -> str:
    return (f'the causes take {percent(taken)} of the misfit beyond noise; with less than '
            f'{percent(needed)} they would not be established')


# The summary of a declared model.


def summary_text(diagnosis: Diagnosis) -> str:
    """Verdict, causes, misfit reduction, parameters, warnings of a declared model."""
    lines = [verdict_line(diagnosis.verdict), diagnosis.headline]
    for cause in diagnosis.causes:
        lines += cause_lines(cause.entry(), estimates_words(cause.parameters))
    if diagnosis.next_test:
        share = ''.join(f' The test leaves the true cause alone in {round(100 * best.share)} of '
                        '100 simulated draws.' for best in diagnosis.separations[:1])
        lines.append(f'next test: {diagnosis.next_test}{share}')
    gain = diagnosis.gain
    if diagnosis.causes:
        lines.append(f'misfit reduction: {gain_words(gain.fit, gain.held_out)}')
    lines.append(certainty_words(diagnosis.probabilities, diagnosis.stability))
    lines += limit_lines(diagnosis.near_limit)
    lines.append(remainder_line([vars(rest) for rest in diagnosis.remainder]))
    if diagnosis.causes:
        lines.append(influence_words([
            (one.run, one.start, one.end, one.evidence) for one in diagnosis.influence]))
    if diagnosis.verdict == 'unknown':
        lines.append(tried_words(
            len(diagnosis.observability.limits), len(diagnosis.search.candidates),
            has_law=diagnosis.law is not None))
        after = diagnosis.residual_after
        tests = sorted((*after.consistency, *after.shapes), key=lambda test: test.p_value)
        lines += [
            f'  residual: {shape.view} along {shape.coordinate}, {percent(shape.visible)} of range'
            for shape in tests[:4] if shape.p_value < quantities.CHANCE]
    lines += ['', 'base parameters (alone -> with the causes):', *(
        f'  {name}: {estimate_words(diagnosis.base_alone[name])} -> {estimate_words(estimate)}'
        for name, estimate in diagnosis.base.items())]
    lines += [f'warning: {warning}' for warning in diagnosis.warnings]
    if not diagnosis.converged:
        lines.append('not converged: a fit on which the verdict rests ended before its optimum')
    return '\n'.join(lines)
