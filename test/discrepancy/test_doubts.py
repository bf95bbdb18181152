"""Claims on what makes a reader doubt a name: bounds, failures, bad declarations, repeats."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.discrepancy import (
    Channel,
    check,
    diagnose,
    Diagnosis,
    DiscrepancyError,
    Effect,
    Estimate,
    Model,
    Noise,
    Parameter,
    Run,
)
from saddlering_ros.discrepancy.verdict.published import ratio
from saddlering_ros.discrepancy.verdict.results import Cause, Gain, Shares
from saddlering_ros.discrepancy.verdict.wording import standing, suspect_words, weak_words
from saddlering_ros.pages import html
from saddlering_ros.pages.charts import Chart

TIME = np.linspace(0.0, 10.0, 400)
DRIVE = np.sin(TIME) + 0.5 * np.sin(2.3 * TIME)
STD = 0.01


def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    """A gain, and a dead zone about it whose width is the shape of the effect."""
    bent = np.tanh(DRIVE / parameters.get('bend.width', 1.0))
    return {'seen': parameters['gain'] * DRIVE + parameters.get('bend.size', 0.0) * bent}


BEND = Effect('A bend', {'size': Parameter(-2, 2), 'width': Parameter(0.1, 1.0, start=0.5)})
MODEL = Model(
    simulate, {'gain': Parameter(0.5, 2.0)}, {'bend': BEND}, {'seen': Channel(offset='free')})


def record(name: str, size: float = 0.3, gain: float = 1.0, seed: int = 1) -> Run:
    run = Run(name, TIME, outputs={'seen': TIME}, coordinates={'drive': DRIVE})
    values = {'gain': gain, 'bend.size': size, 'bend.width': 0.3}
    seen = simulate(values, run)['seen'] + STD * np.random.default_rng(seed).normal(size=400)
    return replace(run, outputs={'seen': seen})


def test_a_shape_that_its_bound_stopped_is_no_name() -> None:
    narrow = replace(BEND, parameters={'size': Parameter(-2, 2), 'width': Parameter(0.6, 1.0)})
    found = diagnose(replace(MODEL, effects={'bend': narrow}), [record('a')])
    assert found.verdict == 'unknown'
    assert [(cause.effect, cause.partial) for cause in found.causes] == [('bend', True)]
    assert diagnose(MODEL, [record('a')]).verdict == 'named'


@pytest.mark.parametrize(('low', 'verdict'), [(0.3, 'unknown'), (0.25, 'named')])
def test_a_sharp_shape_on_its_bound_is_no_name_even_if_nothing_pulls_it_beyond(
    low: float, verdict: str,
) -> None:
    edge = replace(BEND, parameters={'size': Parameter(-2, 2), 'width': Parameter(low, 1.0)})
    found = diagnose(replace(MODEL, effects={'bend': edge}), [record('a', seed=5)])
    width = found.causes[0].parameters['width']
    assert width.value == pytest.approx(0.3, abs=2.0 * width.std)
    assert found.verdict == verdict


def test_a_cause_that_is_real_and_leaves_something_visible_is_part_of_the_cause_only() -> None:
    run = record('a')
    drift = 0.1 * (TIME / TIME[-1]) ** 2
    found = diagnose(MODEL, [replace(run, outputs={'seen': run.outputs['seen'] + drift})])
    assert found.verdict == 'unknown'
    assert [(cause.effect, cause.partial) for cause in found.causes] == [('bend', True)]
    assert 'explains only a part of the misfit' in found.summary()


def test_a_record_of_one_run_states_what_is_missing() -> None:
    def is_told(*held_out: Run) -> bool:
        found = diagnose(MODEL, [record('a')], hold_out=held_out)
        return 'next test: Record a second run under other inputs' in found.summary()
    assert is_told()
    assert not is_told(record('b', seed=2))


def test_an_extension_that_predicts_worse_has_a_negative_gain() -> None:
    other = record('b', size=0.0, gain=1.3, seed=2)  # as the base alone would have it
    found = diagnose(MODEL, [record('a')], hold_out=[other])
    assert found.gain.fit > 0.5
    assert found.gain.held_out is not None
    assert found.gain.held_out < -0.2


@pytest.mark.parametrize(('before', 'after', 'gain'), [
    (4.0, 1.0, 0.5), (1.0, 1.0, 0.0), (1.0, 4.0, -1.0), (1.0, 400.0, -19.0), (0.0, 0.0, 0.0),
    (0.0, 1.0, -np.inf)])
def test_a_misfit_that_grows_is_a_negative_reduction(before, after, gain) -> None:
    assert ratio(before, after) == pytest.approx(gain)


def test_points_at_which_a_simulator_fails_are_lost_alone_and_stated() -> None:
    def fragile(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        if parameters['gain'] > 1.5:
            raise ArithmeticError('too stiff')
        if parameters['gain'] > 1.4:
            return {'seen': DRIVE[:100]}  # a solver that gave up
        if parameters['gain'] < 0.6:
            return {'seen': np.full(run.time.size, np.nan)}
        return simulate(parameters, run)

    found = diagnose(replace(MODEL, simulate=fragile), [record('a')])
    assert (found.verdict, found.causes[0].effect) == ('named', 'bend')
    assert 'ArithmeticError: too stiff; the last in run a at gain = 1.' in ' '.join(found.warnings)


def test_points_at_which_a_simulator_fails_are_one_sentence_for_all_runs() -> None:
    def fragile(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        whole = 1.0 if parameters['gain'] < 1.5 else np.nan
        return {'seen': whole * simulate(parameters, run)['seen']}

    found = diagnose(replace(MODEL, simulate=fragile), [
        record('a'), replace(record('b'), outputs={'seen': record('b').outputs['seen'] + 1e-3})])
    [words] = [line for line in found.warnings if 'failed at' in line]
    assert ': no finite result; the last in run b at gain = ' in words


def test_a_simulator_that_always_fails_is_an_error_that_tells_why() -> None:
    def broken(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        raise KeyError('stiffness')

    with pytest.raises(DiscrepancyError, match='stiffness'):
        diagnose(replace(MODEL, simulate=broken), [record('a')])


def test_a_batch_simulator_is_asked_for_many_points_at_once() -> None:
    asked: list[int] = []

    def many(points: list[dict[str, float]], run: Run) -> list[dict[str, np.ndarray]]:
        asked.append(len(points))
        return [simulate(point, run) for point in points]

    found = diagnose(replace(MODEL, simulate_many=many), [record('a')])
    assert (found.verdict, max(asked) > 10) == ('named', True)


def test_noise_declared_far_too_large_gives_no_name_and_a_warning() -> None:
    channel = Channel(offset='free', noise=Noise.white(0.5))
    found = diagnose(replace(MODEL, channels={'seen': channel}), [record('a')])
    assert found.verdict in ('none', 'unknown')
    assert 'noise overestimated' in ' '.join(found.warnings)


@pytest.mark.parametrize('times', [2.0, 5.0, 30.0])
def test_a_sound_machine_with_noise_declared_too_large_is_none_beside_one_warning(times) -> None:
    """"No conclusion is possible" stood beside `none` with a probability of 97 %."""
    found = seen_with(Noise.white(times * STD), std=STD)
    assert (found.verdict, found.probabilities['none'] > 0.9) == ('none', True)
    (warning,) = found.warnings
    assert 'noise overestimated' in warning
    assert 'nothing can be concluded on what is smaller than this noise' in warning


def test_a_misfit_under_noise_declared_too_large_that_is_no_noise_is_left_open() -> None:
    """A bend of twenty times the noise was `none` with a probability of 97 %."""
    channel = Channel(offset='free', noise=Noise.white(1.0))
    found = diagnose(replace(MODEL, channels={'seen': channel}), [record('a', size=0.2)])
    assert (found.verdict, found.complete) == ('unknown', False)
    assert found.probabilities == {'none': 0.5, 'unknown': 0.5}
    assert found.headline.startswith('Perhaps nothing is wrong')
    assert 'no noise of a smaller size either' in found.warnings[1]


@pytest.mark.parametrize(('noise', 'verdict'), [
    (Noise.white(STD), 'unknown'), (Noise.unknown(), 'named')])
def test_noise_that_is_learnt_takes_no_name_and_probabilities_follow_the_verdict(
    noise: Noise, verdict: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        'saddlering_ros.discrepancy.verdict.noise_doubts.wrong_level', lambda *_: 'over')
    model = replace(MODEL, channels={'seen': Channel(offset='free', noise=noise)})
    found = diagnose(model, [record('a')])
    assert found.verdict == verdict
    assert any('overestimated' in item for item in found.warnings) == (verdict == 'unknown')
    assert found.complete == (verdict == 'named')
    assert (found.probabilities['unknown'] > 0.5) == (verdict == 'unknown')


def test_a_constant_is_a_misfit_unless_it_is_free_or_usual() -> None:
    straight = replace(MODEL, effects={})

    def verdict(offset) -> str:
        run = record('a', size=0.0)
        run = replace(run, outputs={'seen': run.outputs['seen'] + 0.2})
        return diagnose(
            replace(straight, channels={'seen': Channel(offset=offset)}), [run]
        ).verdict

    assert [verdict(offset) for offset in ('free', 0.2, 0.01, 'none')] == [
        'none', 'none', 'unknown', 'unknown']


def test_an_angle_is_a_full_turn_in_its_unit() -> None:
    assert (Parameter.angle().high, Parameter.angle('deg').high) == (2.0 * np.pi, 360.0)


def returning(result: object) -> Model:
    return replace(MODEL, simulate=lambda parameters, run: result)


def second_amplitude(neutral: float | None) -> Model:
    """A bend with a second amplitude that acts where the first one is 0, and a phase."""
    def simulate(parameters, run):
        second = parameters['bend.back'] * np.cos(9.0 * TIME) * np.cos(parameters['bend.phase'])
        return {'seen': MODEL.simulate(parameters, run)['seen'] + second}

    bend = replace(BEND, parameters={
        **BEND.parameters, 'back': Parameter(0, 1, neutral=neutral), 'phase': Parameter.angle()})
    return replace(MODEL, effects={'bend': bend}, simulate=simulate)


def test_a_second_amplitude_is_absent_with_its_effect() -> None:
    assert diagnose(second_amplitude(0.0), [record('a', size=0.0)]).verdict == 'none'


@pytest.mark.parametrize(
    ('declare', 'words'),
    [
        (lambda: diagnose(MODEL, []), 'no runs'),
        (lambda: replace(MODEL, channels={}), 'no channels'),
        (lambda: Run('a', TIME[:3], outputs={'seen': TIME[:3]}), 'at least 8'),
        (lambda: Run('a', TIME[::-1], outputs={'seen': TIME}), 'must rise'),
        (lambda: Run('a', TIME, outputs={'seen': TIME[:9]}), 'shape'),
        (lambda: diagnose(MODEL, [Run('a', TIME, outputs={'sean': TIME})]), 'no output seen'),
        (lambda: Channel(offset='fre'), 'offset'),
        (lambda: Parameter(2, 1), 'low must be below high'),
        (lambda: Effect('x', {'size': Parameter(0, 1)}, starts=({'sise': 1.0},)), 'sise'),
        (lambda: replace(MODEL, base={'bend.size': Parameter(0, 1)}), 'two parameters'),
        (lambda: replace(MODEL, effects=[BEND]), 'effects is a list'),
        (lambda: replace(MODEL, channels={'seen': 'm'}), 'give Channel'),
        (lambda: Channel(noise=0.1), 'give Noise.white'),
        (lambda: replace(MODEL, effects={'f': Effect('f', {'x': Parameter(0.5, 2.0)})}),
         'neutral='),
        (lambda: diagnose(MODEL, record('a')), 'give a list of runs'),
        (lambda: diagnose(MODEL, [record('a'), record('a', seed=2)]), 'two runs are called a'),
        (lambda: diagnose(MODEL, [record('a'), record('b')]), 'it counts once'),
        (lambda: diagnose(MODEL, [Run('a', TIME, outputs={'seen': 0.0 * TIME})]),
         'does not vary'),
        (lambda: diagnose(MODEL, [record('a')], start={'gian': 1.0}), 'no base parameter'),
        (lambda: diagnose(MODEL, [record('a')], start={'gain': 5.0}), 'is outside'),
        (lambda: diagnose(MODEL, [record('a')], start={'gain': np.nan}), 'is outside'),
        (lambda: diagnose(second_amplitude(None), [record('a')]), 'back moves .* neutral='),
        (lambda: check(second_amplitude(None), [record('a')]), 'back moves .* neutral='),
        (lambda: diagnose(returning(None), [record('a')]), 'returned NoneType'),
        (lambda: diagnose(returning({'seen': 'text'}), [record('a')]), 'no array of numbers')])
def test_what_is_declared_wrongly_is_told_in_one_line(declare, words: str) -> None:
    with pytest.raises(DiscrepancyError, match=words) as caught:
        declare()
    assert '\n' not in str(caught.value)


def test_a_check_tells_what_cannot_be_seen_before_anything_is_diagnosed() -> None:
    idle = Effect('Nothing', {'size': Parameter(0, 1)})
    copy = Effect('More gain', {'more': Parameter(-0.5, 0.5)})

    def also(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        gain = parameters['gain'] + parameters['copy.more']
        return simulate({**parameters, 'gain': gain}, run)

    model = replace(MODEL, simulate=also, effects={**MODEL.effects, 'idle': idle, 'copy': copy})
    lines = str(check(model, [record('a')]))
    assert 'effect idle: changes nothing' in lines
    assert 'effect copy: cannot be told from the base' in lines
    assert 'base gain' in lines


def test_a_check_refits_the_base_to_a_large_change_of_an_effect() -> None:
    """Wear of a gain in a curve "reached 68 standard deviations", and no diagnosis can find it."""
    def bent(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        return {'seen': np.tanh(parameters['gain'] * (1.0 - parameters['worn.share']) * DRIVE)}

    worn = Effect('Wear', {'share': Parameter(0.0, 0.5)})
    model = Model(bent, {'gain': Parameter(0.5, 2.0)}, {'worn': worn}, {'seen': Channel()})
    run = Run('a', TIME, outputs={'seen': np.tanh(DRIVE) + 1e-3 * np.cos(1e5 * TIME)})
    assert 'effect worn: cannot be told from the base' in str(check(model, [run]))


@pytest.mark.usefixtures('no_pictures')
def test_the_summary_and_the_page_tell_verdict_cause_and_gain(tmp_path) -> None:
    found = diagnose(MODEL, [record('a')], hold_out=[record('b', seed=2)])
    assert 'verdict: named' in found.summary()
    assert 'A bend' in found.summary()
    found.write_report(tmp_path / 'report.html')
    page = (tmp_path / 'report.html').read_text()
    assert 'Verdict: named' in page
    assert 'seen in b, held out' in page
    assert 'Next step: ' in page


@pytest.mark.usefixtures('no_pictures')
def test_a_base_parameter_without_effect_is_not_determined_in_every_report(tmp_path) -> None:
    """`check` said so where the summary had "0 ± 132 -> 0.50 ± 1.00" of values from 0 to 1."""
    model = replace(MODEL, base={**MODEL.base, 'dead': Parameter(0, 1)})
    runs = [record('a'), record('b', seed=2)]
    assert 'base dead: 0.5, cannot be seen' in str(check(model, runs))
    found = diagnose(model, runs)
    assert '  dead: not determined -> not determined' in found.summary()
    assert '  gain: 1.3' in found.summary()
    found.write_report(tmp_path / 'report.html')
    assert (tmp_path / 'report.html').read_text().count('>not determined<') == 2


def test_the_page_of_a_model_shows_measured_and_simulated_curves_with_units_and_bands(
    tmp_path, monkeypatch,
) -> None:
    charts: dict[str, Chart] = {}
    monkeypatch.setattr(html, 'picture', lambda chart, name, _: charts.update({name: chart}) or '')
    channel = Channel('mm', offset='free', model_error=0.001)
    model = replace(MODEL, channels={'seen': channel}, time_unit='h')
    paused = np.where((TIME > 4.0) & (TIME < 6.0), np.nan, record('b', seed=2).outputs['seen'])
    found = diagnose(model, [record('a')], hold_out=[replace(record('b'), outputs={
        'seen': paused})])
    found.write_report(tmp_path / 'report.html')
    assert {'proof', 'misfit_1', 'misfit_2'} <= set(charts)
    upper, below, left = charts['proof'].panels
    assert (below.x_label, upper.y_label, below.y_label) == ('time / h', 'seen / mm', 'misfit\nmm')
    assert [item.name for item in charts['proof'].named] == [
        'measured', 'simulated, without causes', 'simulated, with the causes', '± 2 × noise',
        '± 2 × noise and declared model error']
    stretches = charts['influence'].panels[0].y_ticks
    assert stretches is not None
    assert all(words.endswith(' h') for words in stretches.words)
    measured = upper.series[0]  # no line across the pause
    breaks = np.flatnonzero(np.isnan(measured.y))
    assert [round(measured.x[place - 1]) for place in breaks] == [4]
    assert (left.y_label, left.bands) == ('with causes\nmm', below.bands)
    assert len({band.opacity for band in left.bands}) == 2
    (rest,) = left.series
    inside = np.abs(rest.y[~np.isnan(rest.y)]) < left.bands[0].high
    assert 0.9 < inside.mean() < 1.0


def seen_with(noise: Noise, std: float) -> Diagnosis:
    """A record of a sound machine with noise of `std`, diagnosed with a declared noise."""
    random = np.random.default_rng(3)
    run = Run('a', TIME, outputs={'seen': DRIVE + std * random.normal(size=TIME.size)})
    return diagnose(replace(MODEL, channels={'seen': Channel(noise=noise)}), [run])


def test_noise_declared_far_too_small_is_reported_and_leaves_no_clean_verdict() -> None:
    found = seen_with(Noise.white(0.1 * STD), std=0.5 * STD)
    assert found.verdict == 'unknown'
    assert found.probabilities['none'] == 0.0
    assert any(item.startswith('noise underestimated') for item in found.warnings)
    assert seen_with(Noise.white(STD), std=STD).warnings == ()


@pytest.mark.parametrize(('declared', 'words'), [(1e-5, 'times that of the declared'), (1e-3, '')])
def test_noise_declared_far_too_small_is_reported_where_it_is_too_small_to_matter(
        declared: float, words: str) -> None:
    """`none` had no warning, a probability of 0 for none, and limits 100 times too small."""
    found = seen_with(Noise.white(declared), std=1e-3)
    assert (found.verdict, bool(words)) == ('none', bool(found.warnings))
    assert words in ''.join(found.warnings)
    assert found.probabilities['none'] > 0.9


@pytest.mark.parametrize('name', ['b', 'c'])
def test_a_rest_that_only_a_test_of_consistency_finds_is_told_of_its_run(name: str) -> None:
    """The first run was named, because no slow structure is larger than noise in any run."""
    channel = Channel(offset='free', noise=Noise.white(1.0))
    runs = [record(one, size=0.3 * (one == name), seed=seed) for seed, one in enumerate('abcd')]
    found = diagnose(replace(MODEL, effects={}, channels={'seen': channel}), runs)
    assert not found.residual_after.slow.sizes['seen'].any()
    assert [rest.run for rest in found.remainder] == [name]


def test_no_rest_is_larger_than_the_residual() -> None:
    """A gain whose bound is far off left 47 % of range where the residual was 2.7 %."""
    found = diagnose(replace(MODEL, base={'gain': Parameter(0.5, 0.98)}), [record('a')])
    left = found.fits.after.prediction - found.fits.metric.problem.measured
    largest = max(test.visible for test in found.residual_after.consistency)
    assert 0.0 < largest <= left.std() + 1e-9
    [base] = [line for line in found.summary().splitlines() if line.startswith('  gain: ')]
    assert base.endswith(', at its bound')


def test_few_samples_of_many_that_hold_half_of_a_misfit_are_told() -> None:
    """The number of ways to choose 124 of 100 000 samples overflowed, and nothing was told."""
    time, random = np.linspace(0.0, 100.0, 100_000), np.random.default_rng(3)
    seen = np.sin(time) + STD * random.normal(size=time.size)
    seen[random.choice(time.size, 900, replace=False)] += 0.4 * random.normal(size=900)
    model = Model(lambda parameters, run: {'seen': parameters['gain'] * np.sin(time)},
                  {'gain': Parameter(0.5, 2.0)}, {},
                  {'seen': Channel(noise=Noise.white(STD))})
    found = diagnose(model, [Run('a', time, outputs={'seen': seen})])
    assert any('of 100000 samples' in words for words in found.warnings)


def test_records_without_any_noise_get_a_name_and_no_doubt_about_noise() -> None:
    run = Run('a', TIME, outputs={'seen': TIME})
    exact = simulate({'gain': 1.0, 'bend.size': 0.3, 'bend.width': 0.3}, run)
    found = diagnose(MODEL, [replace(run, outputs=exact)])
    assert (found.verdict, found.warnings) == ('named', ())


def test_a_second_cause_is_looked_for_in_runs_without_coordinates() -> None:
    def forgetful(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        late = parameters['drift.rate'] * TIME / 10.0
        return {'seen': simulate(parameters, run)['seen'] + late}

    drift = Effect('Drift', {'rate': Parameter(-1, 1)})
    model = replace(MODEL, simulate=forgetful, effects={'bend': BEND, 'drift': drift})
    run = record('a')
    drifted = {'seen': run.outputs['seen'] + 0.05 * TIME / 10.0 + 0.03 * np.sin(5.0 * TIME)}
    found = diagnose(model, [replace(run, outputs=drifted, coordinates={})])
    assert found.causes[0].effect == 'bend'


@pytest.mark.parametrize(('deviation', 'gain', 'words'), [
    (0.6, 0.01, 'may not be there'), (0.1, 0.01, 'explains only a part'),
    (0.6, 0.92, 'explains only a part')])  # its shape can replace its size
def test_a_small_cause_whose_interval_includes_its_absence_is_not_said_to_explain_a_part(
        deviation, gain, words) -> None:
    cause = Cause('bend', BEND, 0, ('bend',), {'size': Estimate(0.5, deviation, 'N')}, 1e-9, 40.0,
                  0.05, Gain(gain, 0.8, 'held out'), partial=True)
    assert standing(['a rest'], cause.entry()).startswith(f' ({words}')
    assert standing(['a rest'], replace(cause, partial=False).entry()) == ''


@pytest.mark.parametrize(('fitted', 'predicted', 'words'), [
    (0.99, 0.0, '99 % of the power of the misfit beyond noise is explained by a on fitted runs, '
     'but 0 % on predicted ones, and at least 85 % is required'),
    (0.60, 0.7, '60 % of the power of the misfit beyond noise is explained by a, and at least')])
def test_a_cause_that_one_run_alone_shows_is_not_said_to_explain_nothing(
        fitted, predicted, words) -> None:
    shares = Shares({'y': fitted}, {'y': predicted}, ('slow', 0.0), ('y', 0.0), ('y', 0.0), None)
    assert weak_words('a', shares, 0.85).startswith(words)


@pytest.mark.parametrize(('fitted', 'predicted', 'is_enough'), [
    ((0.98, 0.0), (0.64, 0.0), True), ((0.98, 0.0), (0.55, 0.0), False),
    ((0.95, 0.0), (0.84, 0.0), False), ((0.86, 0.0), (0.86, 0.0), True),
    ((0.98, 0.75), (0.55, 0.75), False)])  # another view is no part of what it takes nearly all of
def test_a_law_that_takes_nearly_all_of_fitted_runs_may_take_less_of_predicted_ones(
        fitted, predicted, is_enough) -> None:
    shares = Shares(*(dict(zip('yz', each, strict=True)) for each in (fitted, predicted)),
                    ('slow', 0.5), ('y', 0.5), ('y', 0.5), (0.2, 0.8))
    assert (shares.best >= shares.required) == is_enough


def three_bends(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    """Three channels with a bend of their own each; the first has two names."""
    sizes = {name: parameters.get(f'{name}.size', 0.0) for name in ('p', 'twin', 'q', 'r')}
    square = DRIVE**2
    bends = {'a': sizes['p'] + sizes['twin'], 'b': sizes['q'], 'c': sizes['r']}
    return {name: parameters[f'gain_{name}'] * DRIVE + size * square
            for name, size in bends.items()}


@pytest.mark.parametrize(('names', 'verdict'), [('pqr', 'named'), (['p', 'twin', 'q', 'r'],
                                                                   'unknown')])
def test_three_effects_are_no_answer_if_one_of_them_has_an_alternative(names, verdict) -> None:
    effects = {name: Effect(name, {'size': Parameter(-1.0, 1.0)}) for name in names}
    channels = {name: Channel(offset='free') for name in 'abc'}
    gains = {f'gain_{name}': Parameter(0.5, 2.0) for name in 'abc'}
    model = Model(three_bends, gains, effects, channels)
    run = Run('one', TIME, outputs=dict.fromkeys('abc', TIME), coordinates={'drive': DRIVE})
    random = np.random.default_rng(4)
    ones = dict.fromkeys(gains, 1.0)
    exact = three_bends({**ones, 'p.size': 0.1, 'q.size': 0.15, 'r.size': -0.1}, run)
    seen = {key: value + STD * random.normal(size=400) for key, value in exact.items()}
    found = diagnose(model, [replace(run, outputs=seen)])
    assert found.verdict == verdict
    assert len(found.causes) == 3


@pytest.mark.parametrize(
    ('part', 'words'),
    [(slice(None), 'are the same recording: give it once .one is held out'),
     (slice(100, 300), 'a part of a recording: give it once .one is held out'),
     (slice(300, 400), 'a part of a recording')])
def test_no_part_of_a_recording_is_both_fitted_and_held_out(part: slice, words: str) -> None:
    run = record('a')
    later = Run('b', TIME[part] + 100.0, outputs={'seen': run.outputs['seen'][part]},
                coordinates={'drive': DRIVE[part]})
    with pytest.raises(DiscrepancyError, match=words):
        diagnose(MODEL, [run], hold_out=[later])


def test_of_many_doubts_about_the_best_explanation_the_first_ones_are_stated() -> None:
    doubts = [f'doubt {number}' for number in range(1, 11)]
    assert suspect_words('a bend', doubts).endswith(': doubt 1; doubt 2; doubt 3; and 7 more')
    # A size at its bound was told of twice.
    assert suspect_words('a bend', ['doubt 1', *doubts]) == suspect_words('a bend', doubts)
    assert suspect_words('a bend', doubts[:3]).endswith(': doubt 1; doubt 2; doubt 3')
