"""Every sentence of a verdict, for a ring and for a declared model."""

from collections.abc import Callable, Mapping, Sequence
import math
from typing import Any

from saddlering_ros import quantities
from saddlering_ros.discrepancy.problem.system import Estimate, Parameter
from saddlering_ros.discrepancy.search.lack_of_fit import FastResidual
from saddlering_ros.discrepancy.search.space import bound_reached
from saddlering_ros.discrepancy.verdict import results
from saddlering_ros.discrepancy.verdict.results import Diagnosis, HeldOutEvidence, Remainder
from saddlering_ros.quantities import first_of, percent, quantity

PARTIAL, OPEN = 'explains only a part of the misfit', 'is not established'
ABSENT = 'may not be there: the 95 % interval of its size includes its absence'
ANOTHER_LAW = 'the true law over {} has another shape'
"""Words on a cause of an `unknown`: where a rest is left, where none is, where its size may be
that of no effect, and where a law of another shape over a coordinate predicts its residual."""

MAX_RUNS = 4
"""Runs whose share of the evidence is reported in a line."""

MIN_AGAINST = 0.01
"""Share of the evidence from which a run that speaks against the causes is reported."""

MAX_SURE = 0.99
"""Largest probability that is reported for alternatives."""

PREDICTS = 0.5
"""Misfit reduction on predicted runs from which a cause speaks against small errors alone, though
it is not established: half."""

PREDICTED = {'held out': 'held-out runs', 'held out in turn': 'runs held out in turn'}
"""Runs that a gain was measured on beside the fitted ones, by `Gain.how`."""


class OfPrediction(str):
    """A warning on how well a model predicts runs to which it was not fitted."""


def gain_words(fitted: float, held_out: float | None, how: str = 'held out') -> str:
    """Misfit reductions as percentages; how: of `Gain`."""
    words, others = f'{percent(fitted)} on fitted runs', PREDICTED.get(how, 'held-out runs')
    return words if held_out is None else f'{words}, {percent(held_out)} on {others}'


def change_words(shares: Sequence[tuple[float | None, str]]) -> str:
    """'reduces the misfit by 94 % on held-out runs, and raises it by 2 % on fitted runs'.

    shares: misfit reductions and the runs of each; None is left out.
    """
    words: list[str] = []
    last = ''
    for share, runs in shares:
        if share is not None:
            verb = 'reduces' if share >= 0.0 else 'raises'
            it = '' if verb == last else f'{verb} {"it" if words else "the misfit"} '
            words.append(f'{it}by {percent(abs(share))} on {runs}')
            last = verb
    return ', and '.join(words)


def standing(remainder: Sequence[object] | None, cause: results.CauseEntry) -> str:
    """What keeps a cause from being established, behind its title; '' for one that is."""
    words = ABSENT if cause.get('may_be_absent') else PARTIAL if remainder else OPEN
    if law := cause.get('another_law'):
        words = ANOTHER_LAW.format(law['along'])
    return f' ({words})' if cause.get('partial') else ''


def cause_lines(cause: results.CauseEntry, values: str, title_of: Callable[[str], str], how: str,
                remainder: Sequence[object] | None) -> list[str]:
    """A cause with its parameters, which are `values` in words, its gain and its alternatives."""
    gain = cause['gain']
    lines = [
        f'  {cause["title"]} [{cause["effect"]}]{standing(remainder, cause)}',
        f'    {values}',
        f'    misfit reduction {gain_words(gain["fit"], gain["held_out"], how)}; '
        f'p {quantities.probability(cause["evidence"]["p_value"])}']
    if len(cause['group']) > 1:
        lines.append('    alternatives that explain these data equally well: '
                     f'{", ".join(map(title_of, cause["group"][1:]))}')
    return lines


def estimate_words(estimate: Estimate) -> str:
    """A value with its standard deviation and unit."""
    if estimate.std or estimate.unit:
        return quantity(estimate.value, estimate.unit, estimate.std)
    return quantities.compact(estimate.value)


def base_words(estimates: Mapping[str, Estimate], parameter: Parameter) -> str:
    """The estimate of a base parameter and whether it is at its bound, or that it is none."""
    one = estimates[parameter.name]
    if not parameter.is_determined(one.value, one.std):
        return 'not determined'
    return estimate_words(one) + at_bound(parameter, one.value)


def at_bound(parameter: Parameter, value: float) -> str:
    """What follows a value that lies at a bound of its parameter; '' for any other."""
    return '' if bound_reached(parameter, parameter.to_unit(value)) is None else ', at its bound'


def estimates_words(estimates: Mapping[str, Estimate]) -> str:
    """Values by name, in one line."""
    return ', '.join(f'{name} {estimate_words(one)}' for name, one in estimates.items())


def headline_of(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence: whether a cause is established, and the largest remainder."""
    if diagnosis.verdict == 'none':
        return 'These data show nothing that the simulation lacks.'
    moved = [cause.visible for cause in diagnosis.causes if not cause.partial]
    rest = ''.join(rest_words(vars(most), moved) for most in diagnosis.remainder[:1])
    if diagnosis.verdict == 'unknown':
        doubt = doubt_words(diagnosis.probabilities, diagnosis.gain.held_out)
        first = next(iter(diagnosis.causes), None)
        if first and first.another_law and (diagnosis.gain.held_out or 0.0) >= PREDICTS:
            doubt = (f'Something acts over {first.another_law["along"]} as '
                     f'{diagnosis.title_of(first.effect)} does, by a law of another shape')
        return f'{doubt}, and no cause is established{rest}.'
    gain = diagnosis.gain
    causes = dict.fromkeys(
        cause_words(list(map(diagnosis.title_of, cause.group))) for cause in diagnosis.causes)
    return lacking_words(list(causes), rest, gain.fit, gain.held_out, gain.how)


def may_be_none(probabilities: Mapping[str, float]) -> bool:
    """Whether `none` is the likeliest outcome."""
    return bool(probabilities) and max(probabilities.values()) == probabilities.get('none')


def doubt_words(probabilities: Mapping[str, float], held_out: float | None = None) -> str:
    """The start of the headline of an `unknown`, of which `none` may be the likeliest outcome.

    held_out: misfit reduction on predicted runs by causes that are not established.
    """
    if not may_be_none(probabilities):
        return 'Something is wrong'
    if (held_out or 0.0) >= PREDICTS:
        return 'Either something is wrong, or noise and small errors left this misfit'
    return 'Perhaps nothing is wrong, because noise and small errors can leave this misfit'


def cause_words(titles: Sequence[str], size: str = '') -> str:
    """'dry friction (force 4.9 kN)', or 'either a or b (these data cannot tell which)'."""
    if len(titles) > 1:
        return f'either {" or ".join(titles)} (these data cannot tell which)'
    return f'{titles[0]} ({size})' if size else titles[0]


def lacking_words(
    causes: Sequence[str], rest: str = '', fitted: float = 0.0, held_out: float | None = None,
    how: str = 'none') -> str:
    """Established causes, beside a rest with their gain; how: of `Gain`.

    Steady lines alone have a gain of their own each, because they are no part of the model.
    """
    if not rest or how == 'none':
        return f'The simulation lacks {joined(causes)}{rest}.'
    share, runs = ((fitted, 'fitted runs') if held_out is None else
                   (held_out, PREDICTED.get(how, 'held-out runs')))
    mainly = '' if rest.startswith('; a larger') else 'mainly '
    return (f'The simulation lacks {mainly}{joined(causes)}: {percent(share)} of the misfit on '
            f'{runs}{rest}.')


def rest_words(rest: Mapping[str, Any], moved: Sequence[float] = ()) -> str:
    """The end of a headline: '; a rest of 0.4 % of range in delta_y fits no cause'.

    moved: shares of range by established causes, which a rest may exceed. A rest that follows no
    coordinate is that of a held-out run.
    """
    larger = 'larger ' * (0.0 < max(moved, default=0.0) < rest['share_of_range'])
    of_run = f' of held-out {rest["run"]}' if rest.get('along') == '' else ''
    return (f'; a {larger}rest of {percent(rest["share_of_range"])} of range in '
            f'{rest["channel"]}{of_run} fits no cause')


def fit_too_words(remainder: Sequence[Remainder]) -> str:
    """The test that needs no record if held-out runs keep a misfit of their own; else ''."""
    runs = list(dict.fromkeys(rest.run for rest in remainder if not rest.along))
    return f'Fit {joined(runs)} too, which the model does not predict.' if runs else ''


def joined(titles: Sequence[str]) -> str:
    """'a, b and c'."""
    return ', '.join(titles[:-1]) + ' and ' * (len(titles) > 1) + titles[-1]


def excluded_titles(evidence: Sequence[HeldOutEvidence]) -> list[str]:
    """Open alternatives of which no model remains where held-out runs are fitted, too."""
    kept = {one.title for one in evidence if one.remains}
    return list(dict.fromkeys(one.title for one in evidence if one.title not in kept))


def free_test_words(evidence: Sequence[HeldOutEvidence]) -> str:
    """What held-out runs say about open alternatives, as the test that needs no record; or ''.

    evidence: the most likely alternative first.
    """
    if not evidence:
        return ''
    best, runs = evidence[0], joined(evidence[0].runs)
    share = sum(one.share for one in evidence if one.title == best.title)
    words = (f'the model with {best.title} predicts {runs} best '
             f'({"over " if share > MAX_SURE else ""}{percent(min(share, MAX_SURE))} of the '
             'probability of the alternatives)')
    excluded = excluded_titles(evidence)
    if not excluded:
        return f'Held-out {runs} cannot separate the alternatives: {words}.'
    return f'Fit {runs} too: {words}, and this excludes {joined(excluded)}.'


def certainty_lines(document: Mapping[str, Any], title_of: Callable[[str], str]) -> list[str]:
    """How certain a verdict is, in lines, from the document of a ring or of a declared model.

    Its probabilities and stability, why it is near its limit, what is left, and its evidence.
    """
    influence = document.get('influence', []) if any(
        'effect' in cause for cause in document['causes']) else []
    # The largest rests that fit no cause, in three units.
    rests = '; '.join(
        map(quantities.remainder_words, (document.get('remainder') or ())[:MAX_RUNS]))
    return [*filter(None, (
        certainty_words(
            {title_of(group): share for group, share in document.get('probabilities', {}).items()},
            document.get('stability', 1.0) if document.get('refits', True) else None),
        *(f'The verdict is near its limit: {reason}.'
          for reason in document.get('near_limit', [])),
        f'Beyond noise, causes and small errors remain: {rests}.' if rests else '',
        influence_words([
            (one['run'], one['start'], one['end'], one['evidence']) for one in influence],
            document.get('time_unit', 's'))))]


def certainty_document(diagnosis: Diagnosis) -> dict[str, Any]:
    """What lines and pictures of certainty read, for a diagnosis without a document of its own."""
    return {'time_unit': diagnosis.fits.metric.problem.time_unit,
            'causes': [{'effect': cause.effect} for cause in diagnosis.causes],
            **diagnosis.certainty()}


def certainty_words(probabilities: Mapping[str, float], stability: float | None) -> str:
    """Probabilities and stability of a verdict in one line; nothing without probabilities.

    stability: None without refits.
    """
    if not probabilities:
        return ''
    told = quantities.shares_in_words(probabilities)
    words = ', '.join(f'{name} {share}' for name, share in told.items())
    named = set(probabilities) - {'none', 'unknown'}
    same = 'have the same first cause' if named else 'find no cause'
    refits = '' if stability is None else f' {percent(stability)} of the refits {same}.'
    return f'Probabilities: {words}.{refits}'


def influence_words(influence: Sequence[tuple[str, float, float, float]], time_unit: str) -> str:
    """Which runs and stretches hold the evidence: run, start, end [time_unit], evidence of each.

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
            words.append(f'{run} {percent(sums[run] / whole)} (the largest part from '
                         f'{quantities.span(start, end, time_unit, 3)})')
    against = [run for run, share in sums.items() if share < -MIN_AGAINST * whole]
    more = f'; against the causes: {", ".join(against)}' if against else ''
    return f'Evidence by run: {", ".join(words)}{more}.'


def tried_words(compared: int, refitted: int, *, has_law: bool | None) -> str:
    """What was tried before a verdict `unknown`; nothing if no effect was compared.

    has_law: None where no law is looked for.
    """
    if not compared:
        return ''
    law = {True: ' A law for the misfit is proposed.', None: '',
           False: ' No law is proposed, because none over load, direction, rate or time passed '
                  'the test of a cause.'}[has_law]
    causes, models = (f'{count} {what} {"was" if count == 1 else "were"}' for count, what in (
        (compared, 'cause' + 's' * (compared != 1)), (refitted, 'model' + 's' * (refitted != 1))))
    return f'{causes} compared with the misfit, and {models} refitted.{law}'


def remaining_words(explained: float) -> str:
    """What a share of the misfit leaves: '12 % of the power ..'; '< 1 %' is never '0 %'."""
    left = 100.0 * (1.0 - explained)
    return (f'{left:.0f}' if left >= 0.5 else '< 1') + ' % of the power of the misfit beyond noise'


# Warnings: why causes have no name.

ONE_RUN = OfPrediction(
    'there is one run only, so that no prediction of another run supports the causes')
SINGLE_RUN = ('Record a second run under other inputs: with one run nothing shows whether this '
              'verdict predicts another one.')
WORSE_RUN = 'in the fitted run {} the misfit is larger with {} than without'
ODD_RUN = ('the runs fit together without {}: it alone shows a cause, as a test under other '
           'conditions can, or something was different in it, such as the zero of a sensor: '
           'repeat this test')
WORSE_VIEW = 'in {}, which the causes change most, the misfit is larger with the causes'
ONE_VIEW = ('{} in {} alone explains the misfit nearly as well, so that what the cause does '
            'elsewhere is not confirmed')
UNEVEN_RUN = '{} keeps {} of range in {}, more than twice what each other run keeps'
NO_SMALL_ERRORS = ('the residual is larger than small errors of all effects in the catalogue '
                   'could be')
AS_LARGE = 'large too, but not established: {}; which of the causes is the main one is open'
BY_CHANCE = 'an error as large as the one that remains could imitate a cause by chance'
THREE_EFFECTS = 'three effects act in one channel: three effects together can fit any misfit'
CROWDED = ('{} effects were needed for one channel: so many effects can fit any misfit, and none '
           'of them is certain')
TOO_MANY = ('{} effects were needed, and other effects can replace {}: so many models can fit any '
            'misfit, and none of them is certain')
REPLACED = 'beside the other causes, other effects explain as much as {}'
PARTIAL_CAUSES = '{} remains, more than model error in {}: {} can explain only a part of it'
VIEW_LEFT = ('{}: {} of the misfit in {} is left, more than errors of these laws or of the '
             'machine could leave: the true cause may be another one')
SHAPE_LEFT = ('{}: the residual follows one coordinate ({}) more than errors of these laws or of '
              'the machine could: the true cause may be another one')
WRONG_INPUTS = ('{}: the error of an input resembles other causes, and is established only if it '
                'is the only cause and leaves no more than noise')
SHAPE_AT_BOUND = ('{} is not named, because its {} is at the bound of {}: the true cause may '
                  'have a shape outside the bounds')
SIZE_AT_BOUND = ('{} is not named, because its {} is at the bound of {}: the size exceeds the '
                 'expected range, or another cause contributes')
BASE_AT_BOUND = ('{}: the misfit falls further beyond this bound, which a cause can imitate: see '
                 'to the units of the readings, or give wider bounds')
UNCERTAIN = '{}: the 95 % interval of its {}, {}, includes {}'
OUTLIER = ('{} has {:.0f} times the effect of the small errors of all other entries of the '
           'catalogue; these errors explain the remainder')
NO_OUTLIER = ('{} has {:.0f} times the effect of the small errors beside it, and at least {:.0f} '
              'times is required')
NARROW_LAW = ('{}: a law of another shape over {} predicts {} of the misfit that this law leaves '
              'in other runs')
BENT_LAW = ('{}: a curve over {} predicts {} of the misfit that this law leaves in other runs: '
            'the law has another shape, or a further cause acts over the same coordinate')
UNLIKE_CHANNELS = ('{}: with a size for each channel it predicts {} of the misfit that it leaves '
                   'in other runs: the law is another one')
SHARED_DIRECTION = ('{}: {}, of another size or sign, has {} of the power of its change beyond '
                    'the base, and an effect outside the catalogue could have as much')
UNSTEADY_SIZE = ('{}: if its size is fitted for each {}, it is {} to {} of the common size, more '
                 'than its interval allows: the true cause has another law')
CHANGED_SIZE = ('{} does not keep its size: in held-out {} it has {} of what the fitted runs '
                'give, because it changed between the runs, or because its law is another one')
UNSHARED = ('{} of the refits have the same first cause, and more than {} is required: most of '
            'the others end in {}')


def suspect_words(title: str, doubts: Sequence[str]) -> str:
    return (f'if the remainder is model error, the best explanation is {title}, which is not '
            f'established: {first_of(doubts)}')


def weak_words(title: str, shares: results.Shares, needed: float) -> str:
    fitted = max(shares.fitted.values(), default=0.0)
    digits = 2 if percent(shares.best) != percent(needed) else 3  # '85 %' is too little for 85 %
    taken = percent(max(shares.best, 0.0), digits)
    where = '' if fitted < needed else f' on fitted runs, but {taken} on predicted ones'
    words = (f'{percent(fitted) if where else taken} of the power of the misfit beyond noise is '
             f'explained by {title}{where}, and at least {percent(needed)} is required, because a '
             'wrong cause can explain nearly as much')
    return OfPrediction(words) if where else words


def uncertain_gain_words(interval: tuple[float, float]) -> OfPrediction:
    low, high = map(percent, interval)
    end = 'they are predicted worse' if interval[1] < 0.0 else 'there may be none'
    return OfPrediction(f'the misfit reduction on predicted runs is between {low} and {high} '
                        f'(95 % interval), so that {end}')


def close_words(title: str, others: Sequence[str], how: str = 'nearly as well') -> str:
    """how: 'nearly as well', or 'better'."""
    if not others:
        return f'small errors alone explain the misfit nearly as well as {title}'
    return f'beside small errors, {joined(others)} without {title} explain the misfit {how}'


def worse_prediction_words(title: str, rise: float, how: str) -> OfPrediction:
    return OfPrediction(
        f'{title}: not named, because the model with this cause predicts {PREDICTED[how]} worse: '
        f'the misfit there rises by {percent(rise)}')


def some_runs_words(title: str, runs: Sequence[str], parameter: Parameter,
                    size: tuple[float, float], elsewhere: tuple[float, float]) -> str:
    """size: in these runs; elsewhere: share of it in the others; both with deviation."""
    there = (quantities.signed_percent(*size) if parameter.unit == '1'
             else quantity(size[0], parameter.unit, size[1]))
    is_allowed = parameter.low <= size[0] <= parameter.high
    return (f'{title} acts in {joined(runs)} only (size {there} there, '
            f'{"" if is_allowed else "to first order, beyond its bounds, "}'
            f'{quantities.signed_percent(*elsewhere, is_signed=False)} of it elsewhere): '
            'something changed between the runs, or the law depends on what differs between them')


def unpredicted_words(rest: Remainder, *, has_causes: bool) -> OfPrediction:
    fitted = 'the causes' if has_causes else 'the fitted runs show no cause, and'
    return OfPrediction(
        f'{fitted} do not predict held-out {rest.run}: {percent(rest.share_of_range)} of range in '
        f'{rest.channel} remains there: look for what changed between the runs, or fit it too')


# Warnings beside a name.

NOT_CONVERGED = ('a fit on which the verdict rests had not converged: give more rounds by '
                 'Settings(max_rounds=...), narrower bounds or better starts')
ROUGH = ('the simulator answers in steps, or with errors of its solver: the step by which the '
         'sensitivity to {} is found changes no channel by more than {} times these errors. Sizes '
         'may be wrong: give more digits, or a tighter tolerance')
REST_IS_ERROR = ('the remainder is more than noise and fits no cause: every interval and '
                 'comparison of causes counts the remainder as model error')
SLOW_NOISE = ('the misfit is as random as noise with a correlation time of about {} would be: if '
              'the sensors have such noise, nothing is wrong: declare it (Noise.spectrum, '
              'Noise.from_rest). Noise as slow as this is not learnt from a misfit, because a '
              'cause can look alike')
WANDERING = ('the misfit is as random as noise that wanders slowly: if the sensors have it, '
             'nothing is wrong: declare it, {}. Such noise is not learnt unasked, because a cause '
             'can look alike')
BESIDE_WANDERING = ('what {} leaves is as random as noise that wanders slowly: if the sensors '
                    'have it, declare it, {}, and diagnose again')
NEVER_MOVES = ('{0}: the simulator gives one value throughout each run, whatever the parameters: '
               'check what simulate returns for {0}')
FEW_SAMPLES = ('{} in {}: {} of {} samples, the largest at {}, make up {} of the power of the '
               'misfit and widen noise and range: give NaN if the recorder erred there; if a '
               'channel or an input jumps there, check its time stamps')
BEGINS_AGAIN = ('{} times, first at {}, the readings jump by nearly their range where the '
                'simulation does not: unwrap an angle (numpy.unwrap), or let simulate wrap it as '
                'the sensor does')
SLOWER = ('each reading is repeated: if the channel is slower than the others, give NaN between '
          'its samples')
STANDS_STILL = ('{} of {} samples, first at {}, repeat the reading beside them and hold {} of the '
                'misfit: give NaN where the sensor stood still or was at its limit')
BEYOND_DECLARED = '{} in {}: {} of range remains, more than the declared model error of {}'
OTHER_FORM = ('{} remains with the causes, most of it in {}: the law of a cause in the catalogue '
              'is idealised, which explains this remainder')
BEYOND_NOISE = (
    '{} in {}: the misfit is {:.3g} times that of the declared noise, and with {} of range too '
    'small to matter; either the declared noise and the detection limits are too small, or the '
    'model errs by as much')
WRONG_LAW_HIDES = ('what a wrong law leaves could hide in noise that is overestimated, so that no '
                   'cause is established')
NOT_NOISE = ('the misfit in {} is no noise of a smaller size either: neighbouring samples are '
             'alike, by a cause that the overestimated noise hides or by noise that is correlated')
HIDDEN = ('the interval of {} counts no cause too small to show: {} of {} would change the size '
          'by {}')


USUAL_FACTORS, BASE_LEAVES_OPEN = sorted([
    *(10.0**power for power in range(-9, 10)), 57.3, 1 / 57.3, 9.81, 1 / 9.81]), 1.35
"""Factors between units: of prefixes, of degrees and radians, of kilogram-force and newton; and
the error of a factor that the bounds of the base parameters usually permit."""


def unit_words(channel: str, factor: float) -> str:
    near = ' or '.join(quantities.compact(math.copysign(one, factor)) for one in USUAL_FACTORS
                       if abs(math.log(one / abs(factor))) < math.log(BASE_LEAVES_OPEN))
    return (f'{channel}: the readings are about {quantities.compact(factor, 2)} times what the '
            f'simulator gives{near and f" ({near}?)"}: check the unit and the sign of {channel} '
            'in the readings and in simulate')


def fast_words(fast: FastResidual, time_unit: str) -> str:
    """'delta_y moves at about 37 mHz in static_50': it oscillates, or follows steps of a load."""
    unit = 'Hz' if time_unit == 's' else f'per {time_unit or "unit of time"}'
    return (f'{fast.view} moves at about {quantity(fast.frequency, unit, digits=2)} in '
            f'{fast.run}')


# Why a verdict is near its limit.

UNSTABLE = '{} of {} refits have another first cause: {}'
OTHER_WITHOUT_RUN = '{}, the first cause is {}: the verdict depends on that run'
BARELY_REAL = '{} has {:.1f} times the evidence that a cause needs'
BARELY_TAKEN = ('the causes explain {} of the power of the misfit beyond noise, and at least {} '
                'is required')


def almost_a_cause_words(title: str, share: float, visible: float) -> str:
    """share: of the evidence that a cause needs; visible: what it changes, as a share of range."""
    if share < 1.0:
        return f'{title} has {percent(share)} of the evidence that a cause needs'
    return (f'{title} has the evidence that a cause needs, but changes only {percent(visible)} of '
            'range, which is too small to matter')
