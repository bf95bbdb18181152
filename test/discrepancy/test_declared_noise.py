"""Claims on noise that is declared, measured or learnt, channel by channel."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from saddlering_ros.discrepancy import Channel, DiscrepancyError, Model, Parameter, Run
from saddlering_ros.discrepancy.noise import Noise, wrong_level
from saddlering_ros.discrepancy.problem.model import ModelSystem
from saddlering_ros.estimation import record_noise
from saddlering_ros.estimation.process import ChannelNoise, EstimationError
from saddlering_ros.estimation.record_noise import ChannelRecord, continued, widened
from saddlering_ros.estimation.whitening import build_whitener

STEP = 0.01
TIME = np.arange(4000) * STEP


def relaxing(random: np.random.Generator, std: float, tau: float, size: int = 4000) -> np.ndarray:
    keep = np.exp(-STEP / tau)
    drive = random.normal(size=size) * std * np.sqrt(1.0 - keep**2)
    return lfilter([1.0], [1.0, -keep], drive)


def whitened(noise: ChannelNoise, values: np.ndarray) -> np.ndarray:
    return build_whitener(noise, TIME, np.full(TIME.size, STEP)).whiten(values)


def drawn(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.normal(size=4000) * 0.5 + relaxing(random, 1.0, 0.2)


def level(noise: ChannelNoise, seed: int) -> float:
    """Mean square of other noise of the same kind, whitened; 1 if the noise is right."""
    white = whitened(noise, drawn(seed))
    return float(white @ white / white.size)


def test_declared_white_noise_is_taken_at_its_word() -> None:
    noise = Noise.white(2.0).resolve([ChannelRecord('a', TIME, drawn(1))])['a']
    assert np.allclose(whitened(noise, np.full(4000, 2.0)), 1.0)


def test_noise_from_rest_whitens_the_rest_of_the_record() -> None:
    record = ChannelRecord('a', TIME, drawn(2))
    noise = Noise.from_rest([(0.0, 20.0)]).resolve([record])['a']
    assert level(noise, 3) == pytest.approx(1.0, abs=0.1)


def test_a_rest_of_one_run_is_read_in_that_run_alone() -> None:
    records = [ChannelRecord('a', TIME, drawn(2)), ChannelRecord('b', TIME, 10.0 * drawn(4))]
    noise = Noise.from_rest([('a', 0.0, 20.0)]).resolve(records)['b']
    assert level(noise, 3) == pytest.approx(1.0, abs=0.1)


def test_slow_noise_of_a_short_rest_goes_on_at_longer_times_and_white_noise_does_not() -> None:
    slow = ChannelNoise(0.01, np.array([4.0]), 0.0, 100, np.array([1.0]))
    longer = continued(slow, 1.0, 100.0)
    assert longer.slow[longer.time_constants > 1.0].min() == 4.0
    assert longer.time_constants.max() == pytest.approx(100.0)
    assert continued(slow, 1.0, 1.2) is slow
    white = replace(slow, slow=np.zeros(1))
    assert continued(white, 1.0, 100.0) is white


def test_noise_from_repeats_is_free_of_what_the_repeats_share() -> None:
    shared = 100.0 * np.sin(TIME)
    records = [ChannelRecord(name, TIME, shared + drawn(seed)) for seed, name in enumerate('abc')]
    noise = Noise.from_repeats(['a', 'b', 'c']).resolve(records)['b']
    assert level(noise, 9) == pytest.approx(1.0, abs=0.1)


def test_noise_from_a_spectrum_is_the_noise_of_that_spectrum() -> None:
    frequency = np.geomspace(0.02, 50.0, 60)
    density = 2.0 * 0.25 * STEP + 4.0 * 0.2 / (1.0 + (2.0 * np.pi * frequency * 0.2) ** 2)
    noise = Noise.spectrum(frequency, density).resolve([ChannelRecord('a', TIME, drawn(4))])['a']
    assert level(noise, 5) == pytest.approx(1.0, abs=0.1)


def test_unknown_noise_is_learnt_from_a_record_that_never_rests() -> None:
    record = ChannelRecord('a', TIME, 50.0 * np.sin(0.5 * TIME) + drawn(6))
    noise = Noise.unknown().resolve([record])['a']
    assert level(noise, 7) == pytest.approx(1.0, abs=0.15)
    assert 30 < noise.pairs < 2000


def test_unknown_noise_does_not_swallow_a_slow_cause() -> None:
    cause = 5.0 * np.sign(np.sin(0.3 * TIME)) * np.abs(np.sin(0.3 * TIME))
    noise = Noise.unknown().resolve([ChannelRecord('a', TIME, cause + drawn(8))])['a']
    white = whitened(noise, cause)
    assert white @ white > 300.0


def test_a_verdict_does_not_depend_on_the_units_of_channel_and_time() -> None:
    values = drawn(10)
    plain = Noise.unknown().resolve([ChannelRecord('a', TIME, values)])['a']
    other = Noise.unknown().resolve([ChannelRecord('a', TIME * 1e3, values * 1e-6)])['a']
    time = TIME * 1e3
    one = whitened(plain, values)
    two = build_whitener(other, time, np.full(time.size, STEP * 1e3)).whiten(values * 1e-6)
    assert np.allclose(one, two, rtol=1e-6, atol=1e-6)


def test_missing_samples_leave_the_noise_as_it_is() -> None:
    values = drawn(11)
    values[np.random.default_rng(12).random(4000) < 0.01] = np.nan
    noise = Noise.unknown().resolve([ChannelRecord('a', TIME, values)])['a']
    assert level(noise, 13) == pytest.approx(1.0, abs=0.15)


def test_model_error_in_transients_widens_noise_measured_at_rest() -> None:
    random = np.random.default_rng(14)
    rest = ChannelNoise(1e-4 * STEP, np.zeros(1), 0.0, 100, np.array([1.0]))
    record = ChannelRecord('a', TIME, random.normal(size=4000) * 0.01 + relaxing(random, 1.0, 0.1))
    wide = widened(rest, record)
    white = whitened(wide, record.values)
    assert white @ white / white.size == pytest.approx(1.0, abs=0.15)


def test_noise_that_explains_the_residual_is_not_widened() -> None:
    record = ChannelRecord('a', TIME, np.random.default_rng(15).normal(size=4000))
    rest = ChannelNoise(STEP, np.zeros(1), 0.0, 100, np.array([1.0]))
    assert widened(rest, record) is rest


def test_a_declared_model_error_keeps_whitening_from_high_frequencies() -> None:
    # Slow noise alone: whitening is differencing, and a fast small error outweighs a slow large.
    slow = ChannelNoise(1e-9, np.array([1.0]), 0.0, 100, np.array([10.0]))
    fast, large = 0.03 * np.sin(300.0 * TIME), np.sin(0.5 * TIME)
    wide = record_noise.with_model_error(slow, 0.1, 10.0, STEP, 40.0)

    def weight(noise: ChannelNoise) -> float:
        a, b = whitened(noise, fast), whitened(noise, large)
        return float((a @ a) / (b @ b))

    assert weight(slow) > 10.0
    assert weight(wide) < 1.0


def test_misfit_far_under_the_noise_is_noticed_and_usual_misfit_is_not() -> None:
    assert wrong_level(7.0, 624, 100) == wrong_level(308.0, 4000, 12) == 'over'
    assert wrong_level(600.0, 624, 100) is wrong_level(5.0, 12, 12) is None


@pytest.mark.parametrize(
    ('make', 'words'),
    [
        (lambda: Noise.white(0.0), 'above zero'),
        (lambda: Noise.from_rest([]), 'at least one interval'),
        (lambda: Noise.from_rest([(2.0, 1.0)]), 'start first'),
        (lambda: Noise.white('1'), 'std is 1: give a number above zero'),
        (lambda: Noise.from_rest((0.0, 2.0)), 'has 0.0: give a list of intervals'),
        (lambda: Noise.from_rest([('a', 'b')]), 'give a list of intervals'),
        (lambda: Noise.from_rest([(0, 1, 2)]), 'give a list of intervals'),
        (lambda: Noise.from_repeats(['a']), 'two repeats'),
        (lambda: Noise.from_repeats([['a', 'b'], ['c', 'd']]), 'the names of their runs'),
        (lambda: Noise.from_repeats([1, 2]), 'the names of their runs'),
        (lambda: Noise.spectrum(np.array([1.0]), np.array([1.0])), 'two frequencies')])
def test_noise_that_cannot_be_is_refused_in_one_line(make, words: str) -> None:
    with pytest.raises(DiscrepancyError, match=words):
        make()


def seen_every(step: int, noise: Noise) -> float:
    """The learnt deviation of a channel of noise of 1 that has samples at every `step`th time."""
    values = np.random.default_rng(1).normal(size=TIME.size)
    run = Run('a', TIME, outputs={'seen': np.where(np.arange(TIME.size) % step, np.nan, values)})
    model = Model(lambda *_: {}, {'gain': Parameter(0, 1)}, {}, {'seen': Channel(noise=noise)})
    system = ModelSystem(model, [run])
    blocks = system.blocks(run, held_out=False)
    learnt = system.learn_noise([blocks], [blocks.channels])['a', 0]
    return float(system.scales[0] * learnt.variances(blocks.width).mean() ** 0.5)


@pytest.mark.parametrize('noise', [
    Noise.unknown(), Noise.from_rest([(0.0, 20.0)]), Noise.white(1.0)])
def test_a_channel_with_samples_at_every_eighth_time_has_the_noise_of_its_samples(noise) -> None:
    assert seen_every(8, noise) == pytest.approx(1.0, abs=0.15)


def test_a_channel_with_too_few_samples_to_learn_its_noise_is_named() -> None:
    with pytest.raises(DiscrepancyError, match='channel seen: noise: run a holds 10 samples'):
        seen_every(400, Noise.unknown())


def test_an_interval_without_samples_is_refused_in_one_line() -> None:
    with pytest.raises(EstimationError, match='the declared rest has only 0 samples'):
        Noise.from_rest([(100.0, 200.0)]).resolve([ChannelRecord('a', TIME, drawn(1))])


@pytest.mark.parametrize('samples', range(16, 41))
def test_noise_is_learnt_from_runs_of_few_samples(samples: int) -> None:
    """The edges of the bands of a run of 16 to 40 samples ended beyond its spectrum."""
    values = np.random.default_rng(samples).normal(size=samples)
    noise = Noise.unknown().resolve([ChannelRecord('a', TIME[:samples], values)])['a']
    assert 0.3 < float(np.sqrt(noise.variances(np.full(samples, STEP)).mean())) < 3.0
