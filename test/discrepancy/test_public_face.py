"""A claim on the engine's face: the ring is a user of it like any other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sources import imported
from threadpoolctl import threadpool_info

import saddlering_ros
from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import Channel, diagnose, diagnosis, Effect, Model, Parameter, Run

PACKAGE = Path(saddlering_ros.__file__).parent
NAME = 'saddlering_ros.discrepancy'


WAVE = Effect('A wave', {'size': Parameter(0, 3)})


def straight(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    """A line and a sine, as `record` has them."""
    return {'y': parameters['slope'] * run.inputs['x']
            + parameters['wave.size'] * np.sin(9.0 * run.inputs['x'])}


def lines(simulate: Callable[..., Any]) -> Model:
    return Model(simulate, base={'slope': Parameter(0, 4)}, channels={'y': Channel()},
                 effects={'wave': WAVE})


def record(seed: int = 0, huge: float = 0.0, true: float = 2.0) -> Run:
    x = np.linspace(0.0, 4.0, 200)
    y = true * x + np.sin(9.0 * x) + 0.05 * np.random.default_rng(seed).normal(size=x.size)
    y[7] += huge
    return Run(f'run {seed}', x, {'x': x}, {'y': y})


def found(simulate: Callable[..., Any], *runs: Run) -> discrepancy.Diagnosis:
    answer = diagnose(lines(simulate), runs or [record(0), record(1)])
    assert [cause.effect for cause in answer.causes] == ['wave']
    return answer


def test_nothing_outside_the_engine_imports_what_it_does_not_export() -> None:
    users = [path for path in PACKAGE.rglob('*.py') if 'discrepancy' not in path.parts]
    users += (PACKAGE.parent / 'examples').rglob('*.py')
    wrong = [
        f'{path.relative_to(PACKAGE.parent)}: {module}.{name}'
        for path in users
        for module, name in imported(path)
        if module.startswith(f'{NAME}.') or (module == NAME and name not in discrepancy.__all__)]
    assert len(users) > 100
    assert wrong == []


def test_the_engine_imports_no_ring() -> None:
    rooms = ('ring', 'effects', 'rig', 'diagnosis', 'bags', 'identification', 'virtual_rig')
    wrong = [
        f'{path.name}: {module}'
        for path in (PACKAGE / 'discrepancy').rglob('*.py')
        for module, _ in imported(path)
        if module.split('.')[:1] == ['saddlering_ros'] and module.split('.')[1:2]
        and module.split('.')[1] in rooms]
    assert wrong == []


@pytest.mark.parametrize(('declare', 'words'), [
    (lambda: Channel(model_error=None), 'channel: model_error is None: a share of the range'),
    (lambda: Channel(offset=None), "channel: offset is None: give 'free', 'none' or a"),
    (lambda: Parameter(None, 1.0), 'parameter: low must be below high, and both finite, not None'),
    (lambda: Run('a', ['early'] * 9, {}, {'y': range(9)}), 'run a: time is no array of numbers'),
    (lambda: Run('a', np.arange(9).astype('M8[s]'), {}, {'y': range(9)}),
     'run a: time is no array of numbers: they are dates or durations: give numbers'),
    (lambda: diagnose(lines(straight), [record()], start={'slope': '2'}),
     "start: slope is '2': give a number"),
    (lambda: Run('a', range(9), {}, {'y': [[1], [2, 3]]}), 'run a: outputs y is no array of num'),
    (lambda: Run('a', range(9), {}, {'y': [1j] * 9}), 'run a: outputs y is no array of num'),
    (lambda: Parameter('0', '1'), "parameter: low must be below high, and both finite, not '0'"),
    (lambda: Model(straight, {'a': Parameter(0, 1)}, channels={'y': Channel()}, effects={
        'one': Effect('Friction', {'f': Parameter(0, 1)}),
        'two': Effect('Friction', {'f': Parameter(0, 1)})}), 'model: two effects have the title'),
    (lambda: replace(lines(straight), effects={'none': WAVE}), "model: effects has the name 'no"),
    (lambda: replace(lines(straight), effects={'a or b': WAVE}), "model: effects has the name 'a"),
    (lambda: replace(lines(straight), effects={'': WAVE}), "model: effects has the name '': give"),
    (lambda: replace(lines(straight), effects={1: WAVE}), 'model: effects has the name 1: give'),
    (lambda: Effect('', {'f': Parameter(0, 1)}), "effect: its title is '': give a text in one"),
    (lambda: Effect('C\nD', {'f': Parameter(0, 1)}), "effect: its title is 'C\\nD': give a text"),
    (lambda: Effect('C', {'f\n': Parameter(0, 1)}), 'effect C: declare at least one parameter'),
    (lambda: Effect('C', [Parameter(0, 1)]), 'effect C: declare at least one parameter, the size'),
    (lambda: replace(record(), name=3), 'run: its name is 3: give a text in'),
    (lambda: replace(record(), name='a\nb'), "run: its name is 'a\\nb': give a text in one"),
    (lambda: replace(lines(straight), channels={'y\n': Channel()}),
     "model: channels has the name 'y\\n': give another one"),
    (lambda: diagnose(lines(straight), [record()], hold_out=record(1)),
     'diagnose: hold_out is a Run: give a list of runs'),
    (lambda: diagnose(lines(straight), [record(huge=1e300)]),
     'channel y has readings up to 1e+300: give NaN where a sample is missing, or'),
    (lambda: diagnose(lines(straight), [
        replace(record(), outputs={'y': 1e-200 * np.arange(200)})]),
     'channel y has readings up to 1.99e-198: give NaN where a sample is missing, or'),
    (lambda: diagnose(lines(straight), [record()], hold_out=[record(1, huge=-np.inf)]),
     'run run 1: channel y reads -inf at time 0.140704 (such readings: 1 of 200): give NaN where'),
    (lambda: diagnose(lines(straight), [record()], hold_out=[record(1, huge=9.9e37)]),
     'run run 1: channel y reads 9.9e+37 at time 0.140704 (such readings: 1 of 200): give NaN'),
    (lambda: Parameter(0, 1, start='2'), "parameter: start is '2': give a number"),
    (lambda: Parameter(0, 1, neutral='0'), "parameter: neutral is '0': give a number"),
    (lambda: Parameter(0, 1, unit=None), 'parameter: unit is None: give a text'),
    (lambda: Parameter(0, 1, limiting_case=[0]), 'parameter: limiting_case is a list: give a nu'),
    (lambda: Parameter.angle('degree'), "parameter: the unit of an angle is 'degree': give rad"),
    (lambda: Effect('C', {'f': (0, 1)}), 'effect C: declare at least one parameter, the size'),
    (lambda: Effect('C', {'f': Parameter(0, 1)}, variants=(1, 2)),
     'effect C: one of its variants is 1: give a mapping from names to values'),
    (lambda: Effect('C', {'f': Parameter(0, 1)}, starts={'f': 1}),
     "effect C: one of its starts is 'f': give a mapping from names to values"),
    (lambda: Channel(unit=None), 'channel: unit is None: give a text'),
    (lambda: replace(lines(straight), time_unit=None), 'model: time_unit is None: give a text'),
    (lambda: replace(lines(straight), base={'slope': (0, 4)}),
     'model: base slope is (0, 4): give Parameter(...)'),
    (lambda: replace(record(), time=np.zeros((9, 1))), 'run run 0: time has shape (9, 1): give'),
    (lambda: replace(record(), outputs=np.ones(200)), 'run run 0: outputs is a ndarray: give a'),
    (lambda: replace(record(), inputs=[1.0]), 'run run 0: inputs is a list: give a mapping from'),
    (lambda: diagnose(straight, [record()]), 'diagnose: model is a function: give Model(...)'),
    (lambda: diagnose(lines(straight), [record()], hold_out=[{}]),
     'diagnose: one of the runs of a Model is a dict: give Run(...)'),
    (lambda: diagnose(lines(straight), [record()], start=[2]),
     'diagnose: start is a list: give a mapping from names to numbers'),
    (lambda: diagnose(lines(straight), [record()], settings={'max_causes': 1}),
     'diagnose: settings is a dict: give Settings(...)')])
def test_a_declaration_of_another_kind_is_refused_in_one_line(declare, words) -> None:
    with pytest.raises(discrepancy.DiscrepancyError) as refused:
        declare()
    assert str(refused.value).startswith(words)
    assert '\n' not in str(refused.value)


def test_a_simulator_may_return_the_same_array_each_time() -> None:
    buffer = np.zeros(200)

    def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        buffer[:] = straight(parameters, run)['y']
        return {'y': buffer}

    def together(asked: list[dict[str, float]], run: Run) -> list[dict[str, np.ndarray]]:
        return [simulate(one, run) for one in asked]

    in_batches = replace(lines(simulate), simulate_many=together)
    size = found(straight).causes[0].parameters['size'].value
    assert found(simulate).causes[0].parameters['size'].value == size
    answer = diagnose(in_batches, [record(0), record(1)])
    assert answer.causes[0].parameters['size'].value == size


def test_a_simulator_with_another_result_for_the_same_parameters_is_refused() -> None:
    chance = np.random.default_rng(1)

    def draws(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        return {'y': straight(parameters, run)['y'] + chance.normal(size=200)}

    def changes_its_input(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        answer = straight(parameters, run)
        run.inputs['x'] *= 1.001
        return answer

    for simulate in (draws, changes_its_input):
        with pytest.raises(discrepancy.DiscrepancyError,
                           match='another result for the same parameters, by '):
            diagnose(lines(simulate), [record(0), record(1)])


def test_a_simulator_that_writes_into_the_time_of_a_run_moves_no_stretch_of_it() -> None:
    def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        run.time[:] += 3.0
        return straight(parameters, run)

    apart = replace(record(0), inputs={'x': record(0).time}), replace(
        record(1), inputs={'x': record(1).time})
    assert found(simulate, *apart).influence == found(straight).influence


def test_what_a_simulator_writes_into_a_run_changes_no_array_of_the_caller() -> None:
    def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        np.clip(run.inputs['x'], 0.0, 4.0, out=run.inputs['x'])
        run.outputs['y'][:] = straight(parameters, run)['y']
        return run.outputs

    runs = record(0), record(1)
    discrepancy.check(lines(simulate), runs)
    size = found(simulate, *runs).causes[0].parameters['size'].value
    assert size == found(straight).causes[0].parameters['size'].value
    assert np.array_equal(runs[0].outputs['y'], record(0).outputs['y'])


@pytest.mark.parametrize('wrong', [np.nan, 1e9])
def test_a_check_says_that_a_simulator_fails_at_every_start_of_an_effect(wrong: float) -> None:
    def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        return {'y': straight(parameters, run)['y'] * (wrong if parameters['wave.size'] else 1.0)}

    said = list(discrepancy.check(lines(simulate), [record(0), record(1)]))
    assert 'effect wave: the simulator fails at every start' in said
    answer = diagnose(lines(simulate), [record(0), record(1)])
    assert ('no finite result' in answer.warnings[-1]) == np.isnan(wrong)
    assert ('a million ranges off the readings' in answer.warnings[-1]) == np.isfinite(wrong)


def test_a_simulator_that_drifts_from_call_to_call_gets_a_warning() -> None:
    calls = []

    def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        calls.append(1)
        return {'y': straight(parameters, run)['y'] + 1e-5 * len(calls)}

    answer = diagnose(lines(simulate), [record(0), record(1)])
    assert any('since its first call, the simulator' in sentence for sentence in answer.warnings)
    assert not any('since its first' in sentence for sentence in found(straight).warnings)


@pytest.mark.parametrize(('digits', 'is_told'), [(1, True), (6, False)])
def test_a_simulator_that_gives_few_digits_gets_a_warning(digits: int, is_told: bool) -> None:
    def printed(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        return {'y': np.round(straight(parameters, run)['y'], digits)}

    told = [words for words in found(printed).warnings if 'answers in steps' in words]
    checked = str(discrepancy.check(lines(printed), [record(0), record(1)]))
    assert (bool(told), 'answers in steps' in checked) == (is_told, is_told)


def test_a_reading_that_is_masked_is_missing() -> None:
    run = record()
    masked = np.ma.array(run.outputs['y'], mask=False)
    masked[20:40] = -9999.0
    masked[20:40] = np.ma.masked
    answer = found(straight, Run('run 0', run.time, run.inputs, {'y': masked}))
    assert answer.causes[0].parameters['size'].value == pytest.approx(1.0, abs=0.1)


def test_few_readings_that_hold_the_misfit_are_told() -> None:
    def few(answer: discrepancy.Diagnosis) -> list[str]:
        return [one for one in answer.warnings if ' samples, the largest at ' in one]

    # One reading in 200 hides the wave.
    answer = diagnose(lines(straight), [record(0, huge=1000.0), record(1, huge=1000.0)])
    assert not any(cause.partial is False for cause in answer.causes)
    assert [one.split(' of the power')[0] for one in few(answer)] == [
        'y in run 0: 1 of 200 samples, the largest at 0.1407035176, make up 100 %']
    slow = [
        replace(run, outputs={'y': np.where(np.arange(200) % 4 < 3, np.nan, run.outputs['y'])})
        for run in (record(0, huge=1e3), record(1, huge=1e3))]
    assert '1 of 50 samples' in few(diagnose(lines(straight), slow))[0]
    assert not few(found(straight))


@pytest.mark.parametrize(('code', 'is_told'), [(-999.25, True), (-9999.0, True), (0.5, False)])
def test_a_recorder_that_writes_a_code_for_no_reading_is_told(code: float, is_told: bool) -> None:
    """Thirty codes in one of three runs went without a word, beside a complete verdict."""
    runs = [record(number) for number in range(3)]
    readings = np.where(np.arange(200) // 12 == 5, code, runs[0].outputs['y'])
    answer = diagnose(lines(straight), [replace(runs[0], outputs={'y': readings}), *runs[1:]])
    assert is_told == any('y in run 0: ' in one and ' of 200 samples, the largest at ' in one
                          for one in answer.warnings)
    # Codes widen the noise that is learnt, and with it what counts as noise.
    assert (answer.verdict, answer.complete) == ('unknown', False) or not is_told


def test_a_free_constant_of_a_thousand_ranges_hides_no_cause() -> None:
    free = replace(lines(straight), channels={'y': Channel(offset='free')})
    size, rest = [], []
    for constant in (0.0, 1e4):
        answer = diagnose(free, [replace(run, outputs={'y': run.outputs['y'] + constant})
                                 for run in (record(0), record(1))])
        size.append(answer.causes[0].parameters['size'].value)
        rest.append(answer.remainder)
        assert answer.verdict == 'named'
    assert size[1] == pytest.approx(size[0], rel=1e-4)
    assert rest == [(), ()]


def test_what_a_bound_leaves_does_not_go_along_a_constant() -> None:
    answer = diagnose(lines(straight), [record(0, true=-2.0), record(1, true=-2.0)])
    assert 'no coordinate, as a constant does' not in {rest.along for rest in answer.remainder}


def test_none_names_the_effects_that_the_data_cannot_test() -> None:
    def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        answer = straight(parameters, run)['y']
        return {'y': answer + parameters['gain.size'] * run.inputs['x'] + np.sin(9 * run.time)}

    both = {'wave': WAVE, 'gain': Effect('A gain', {'size': Parameter(0, 1)})}
    answer = diagnose(replace(lines(simulate), effects=both), [record(0), record(1)])
    assert answer.verdict == 'none'
    assert 'These data cannot test A gain.' in answer.summary().splitlines()


def test_unknown_names_an_effect_that_the_simulator_leaves_out() -> None:
    answer = diagnose(lines(lambda parameters, run: {'y': parameters['slope'] * run.inputs['x']}),
                      [record(0), record(1)])
    assert answer.verdict == 'unknown'
    assert 'These data cannot test A wave.' in answer.summary().splitlines()


def test_inputs_may_be_lists() -> None:
    run = record()
    assert found(straight, Run('run 0', list(run.time), {'x': list(run.inputs['x'])}, {
        'y': list(run.outputs['y'])})).verdict == 'named'


def test_a_refused_simulator_says_where_it_is_not_finite_and_which_input_is_not() -> None:
    def wrong(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        return {'y': parameters['slope'] * run.inputs['x'] + run.time}

    run = record()
    x = run.inputs['x'].copy()
    x[5:9] = np.nan
    with pytest.raises(discrepancy.DiscrepancyError) as refused:
        diagnose(lines(straight), [Run('a', run.time, {'x': x}, run.outputs)])
    assert 'y in 4 of 200 samples, from time 0.100503 on' in str(refused.value)
    assert 'input x has values that are no finite numbers' in str(refused.value)
    with pytest.raises(discrepancy.DiscrepancyError,
                       match=r'input x has shape \(195,\), time \(200,\)'):
        diagnose(lines(wrong), [Run('a', run.time, {'x': x[5:]}, run.outputs)])


def test_names_with_dollar_signs_are_drawn_as_they_are(tmp_path: Path) -> None:
    first, second = record(0), record(1)
    answer = found(straight, replace(first, name='$_a_$'), replace(second, name='cost $^{ in $'))
    answer.write_report(tmp_path / 'page.html')
    assert '$_a_$' in (tmp_path / 'page.html').read_text()


def test_parameters_that_only_have_a_ratio_get_no_narrow_interval() -> None:
    """Mass and spring of a free oscillation have a frequency: the spring was 5.128 +- 0.002."""
    def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        frequency = np.sqrt(parameters['spring'] / parameters['mass'])
        more = parameters['magnet.force'] / parameters['mass'] * np.sin(3.0 * run.time)
        return {'y': np.cos(frequency * run.time) + more}

    model = Model(
        simulate, base={'mass': Parameter(0.5, 4.0), 'spring': Parameter(0.5, 8.0)},
        effects={'magnet': Effect('A magnet', {'force': Parameter(0, 1)})},
        channels={'y': Channel()})
    time = np.linspace(0.0, 20.0, 400)
    true = {'mass': 2.0, 'spring': 3.0, 'magnet.force': 0.2}
    runs = []
    for seed in (0, 1):
        run = Run(f'run {seed}', time, {}, {'y': time})
        noise = 1e-3 * np.random.default_rng(seed).normal(size=time.size)
        runs.append(Run(run.name, time, {}, {'y': simulate(true, run)['y'] + noise}))
    answer = diagnose(model, runs)
    assert answer.base['spring'].std > 0.5
    assert abs(answer.base['spring'].value - 3.0) < 3.0 * answer.base['spring'].std
    seen = {line.split(':')[0]: line for line in discrepancy.check(model, runs)}
    assert seen['base mass'].endswith('cannot be told from the other base parameters')


def test_the_last_report_of_progress_is_the_whole(monkeypatch) -> None:
    """Doubts about the noise took 20 s after a report of the whole, with all threads of BLAS."""
    shares: list[float] = []
    after: list[tuple[float, set[int]]] = []
    real = diagnosis.with_slow_noise

    def with_slow_noise(*given: Any) -> Any:
        threads = {one['num_threads'] for one in threadpool_info() if one['user_api'] == 'blas'}
        after.append((shares[-1], threads))
        return real(*given)

    monkeypatch.setattr(diagnosis, 'with_slow_noise', with_slow_noise)
    diagnose(lines(straight), [record(0), record(1)],
             on_progress=lambda said: shares.append(said.share))
    assert shares[-1] == 1.0
    assert shares == sorted(shares)
    assert after[0][0] < 1.0
    assert after[0][1] <= {1}


@pytest.mark.parametrize('error', [OSError, SystemExit])
def test_a_simulator_that_fails_for_one_run_is_refused_with_the_reason(error) -> None:
    def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        if run.name == 'run 1':
            raise error('no road file')
        return straight(parameters, run)

    with pytest.raises(
            discrepancy.DiscrepancyError, match=(
                rf'parameters \({error.__name__}: no road file; the last in run run 1 at ')):
        diagnose(lines(simulate), [record(0), record(1)])
