"""Claims on steady lines of a few hertz, seen in whole runs while the load moves."""

from dataclasses import replace

from bench import LOAD, recorded, STEP, System, TIME
import numpy as np
import pytest

from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import diagnose_system, Effect, Parameter, Problem, RunBlocks

NOISE = 2e-3
FREQUENCY = 3.7


class Bench(System):
    """One channel straight in the load; it may pick up a line."""

    effects = (
        Effect('pickup', {'cosine': Parameter(-1.0, 1.0), 'sine': Parameter(-1.0, 1.0),
                          'frequency': Parameter(0.5, 500.0, scale='log')}, line=((0,),)),
        Effect('bend', {'size': Parameter(-0.5, 0.5)}))

    def at(self, load: np.ndarray, point: discrepancy.Point) -> np.ndarray:
        bend = point.effects.get('bend', {'size': 0.0})['size']
        return (point.base[0] * load + bend * load**2)[None, :]

    def predict_many(self, run: RunBlocks, points) -> np.ndarray:
        return np.array([self.at(run.inputs['load'], point) for point in points])


def two_runs(swing: np.ndarray, bend: float = 0.0) -> list:
    """Two runs with noise, what is added to both, and a bend."""
    runs = []
    for number, name in enumerate(('first', 'second')):
        noise = NOISE * np.random.default_rng(number).normal(size=(1, TIME.size))
        seen = LOAD + bend * LOAD**2 + swing + noise
        runs.append(recorded(name, seen, [discrepancy.RestSegment(seen[:, TIME < 4.0], STEP)]))
    return runs


def line(frequency: float = FREQUENCY) -> np.ndarray:
    """A line of 0.024, as means over steps show it."""
    shown = 0.024 * np.sinc(frequency * STEP)
    return shown * np.cos(2.0 * np.pi * frequency * TIME + 0.4)


def test_a_line_below_ten_hertz_is_named_while_the_load_moves() -> None:
    found = diagnose_system(Problem(Bench(), two_runs(line())))
    (cause,) = found.causes
    assert (found.verdict, cause.effect) == ('named', 'pickup')
    assert cause.parameters['frequency'].value == pytest.approx(FREQUENCY, abs=0.02)
    assert cause.parameters['cosine'].value == pytest.approx(0.024, rel=0.05)


def test_a_cause_beside_the_line_is_named_too() -> None:
    found = diagnose_system(Problem(Bench(), two_runs(line(), bend=0.1)))
    assert found.verdict == 'named'
    assert {cause.effect for cause in found.causes} == {'pickup', 'bend'}


def test_two_lines_of_one_effect_have_one_name_in_the_headline() -> None:
    found = diagnose_system(Problem(Bench(), two_runs(line() + line(5.3))))
    assert [cause.effect for cause in found.causes] == ['pickup', 'pickup']
    assert found.headline == 'The simulation lacks pickup.'


@pytest.mark.parametrize('swing', [
    line() * np.exp(-((TIME - 4.0) % 8.0) / 1.0),
    line() * (LOAD > 0.0) * 2.0,
    0.024 * np.cos(2.0 * np.pi * 0.4 * TIME),
], ids=['ringing after corners', 'under load only', 'slow sway'])
def test_a_swing_that_is_no_steady_line_is_not_named_one(swing: np.ndarray) -> None:
    found = diagnose_system(Problem(Bench(), two_runs(swing)))
    assert 'pickup' not in {cause.effect for cause in found.causes}


def test_a_line_at_which_the_drive_swings_is_not_named_a_pickup() -> None:
    drive = 0.1 * np.cos(2.0 * np.pi * FREQUENCY * TIME)
    runs = [replace(run, inputs={'load': LOAD + drive}, channels=run.channels + drive)
            for run in two_runs(line())]
    assert frequencies(runs) == []


def frequencies(runs: list) -> list[float]:
    """Frequencies of the lines that are named."""
    found = diagnose_system(Problem(Bench(), runs))
    lines = [item for item in found.causes if item.effect == 'pickup']
    return sorted(item.parameters['frequency'].value for item in lines)


def test_a_fast_line_that_means_over_blocks_fold_has_one_name() -> None:
    fast, runs = 1.0 / STEP + FREQUENCY, []
    for number, run in enumerate(two_runs(3.0 * line(1.0 / STEP + FREQUENCY))):
        own = STEP / 10.0 * np.arange(240)
        noise = NOISE * np.random.default_rng(9 + number).normal(size=own.size)
        rest = 0.072 * np.cos(2.0 * np.pi * fast * own) + noise
        runs.append(replace(run, rest=(discrepancy.RestSegment(rest[None, :], STEP / 10.0),)))
    assert frequencies(runs) == pytest.approx([fast], abs=0.03)


def with_a_gap(run: RunBlocks) -> RunBlocks:
    kept = (TIME < 9.0) | (TIME > 12.0)
    return replace(run, time=run.time[kept], width=run.width[kept], direction=run.direction[kept],
                   channels=run.channels[:, kept], inputs={'load': LOAD[kept]})


def with_samples_missing(run: RunBlocks) -> RunBlocks:
    there = ~((np.arange(TIME.size) >= 200) & (np.arange(TIME.size) < 215))[None, :]
    return replace(run, channels=run.channels * there, present=there)


def held_test(seed: int, size: float) -> RunBlocks:
    """A static test of 24 holds of 5 s at 25 Hz, with noise and a line."""
    random = np.random.default_rng(seed)
    levels = np.concatenate([np.arange(1, 13), np.arange(11, -1, -1)]) / 12.0
    rest, time, seen, load, hold = [], [], [], [], []
    for number, level in enumerate(levels):
        own = 7.0 * number + 0.04 * np.arange(125)
        swing = size * np.cos(2.0 * np.pi * FREQUENCY * own) + NOISE * random.normal(size=125)
        rest.append(discrepancy.RestSegment((level + swing)[None, :], 0.04))
        for part in np.array_split(np.arange(125), 4):
            time.append(own[part].mean())
            seen.append(level + swing[part].mean())
            load.append(level)
            hold.append(float(number))
    drive = np.array(load)
    return RunBlocks(f'static {seed}', 'bench', np.array(time), np.full(drive.size, 1.25),
                     np.array(seen)[None, :], {'load': drive}, tuple(rest), hold=np.array(hold),
                     direction=np.repeat(np.where(np.arange(24) < 12, 1.0, -1.0), 4))


@pytest.mark.parametrize(('runs', 'seen'), [
    (two_runs(line() + 0.6 * line(2.3)), [2.3, FREQUENCY]),
    ([with_a_gap(run) for run in two_runs(line())], [FREQUENCY]),
    ([with_samples_missing(run) for run in two_runs(line())], [FREQUENCY]),
    ([held_test(1, 0.024), held_test(2, 0.024)], [FREQUENCY]),
], ids=['two lines', 'a gap', 'samples missing', 'holds of static tests alone'])
def test_lines_are_named_wherever_they_show(runs: list, seen: list[float]) -> None:
    assert frequencies(runs) == pytest.approx(seen, abs=0.03)


@pytest.mark.parametrize('runs', [
    two_runs(np.zeros(TIME.size)), [held_test(1, 0.0), held_test(2, 0.0)]], ids=['runs', 'holds'])
def test_noise_alone_shows_no_line(runs: list) -> None:
    assert diagnose_system(Problem(Bench(), runs)).verdict == 'none'


def test_a_swing_of_two_periods_in_the_one_fast_run_is_no_line() -> None:
    runs = []
    for name, step, count in (('long', 1.0, 400), ('short', 0.02, 128)):
        time = step * np.arange(count)
        load = np.interp(time / time[-1], [0.0, 0.2, 0.6, 1.0], [0.0, 0.0, 1.0, 0.0])
        noise = NOISE * np.random.default_rng(count).normal(size=(1, count))
        swing = 0.1 * np.cos(2.0 * np.pi * 0.8 * time) * (name == 'short')
        seen = load + swing + noise
        runs.append(RunBlocks(
            name, 'bench', time, np.full(count, step), seen, {'load': load},
            (discrepancy.RestSegment(seen[:, load == 0.0], step),),
            direction=np.sign(np.gradient(load))))
    found = diagnose_system(Problem(Bench(), runs))
    assert 'pickup' not in {cause.effect for cause in found.causes}
