"""Claims about the noise read from stretches at rest."""

import numpy as np
import pytest
from scipy.signal import lfilter

from saddlering_ros.estimation import noise as noises
from saddlering_ros.estimation.noise import channel_correlation, measure_noise, RestSource
from saddlering_ros.estimation.process import ChannelNoise, EstimationError, RowTotals
from saddlering_ros.estimation.rest import RestSegment

STEP = 0.02


def segments(memory, count=50, length=200, seed=0, scale=3e-7):
    """`count` stretches of AR(1) noise with standard deviation `scale`."""
    random = np.random.default_rng(seed)
    drive = random.normal(0.0, scale * np.sqrt(1.0 - memory**2), (count, length + 200))
    return list(lfilter([1.0], [1.0, -memory], drive, axis=1)[:, 200:])


def rests(parts):
    """Stretches at rest of rows (C, n) or (n,)."""
    return [RestSegment(np.atleast_2d(part), STEP) for part in parts]


def of_channel(parts):
    """Noise of the one channel of these stretches (n,)."""
    return noises.noise_alone(parts, STEP)


@pytest.mark.parametrize('memory', [0.0, 0.5, 0.9])
def test_standard_deviation_is_read_whatever_the_memory(memory):
    assert of_channel(segments(memory)).deviation(STEP) == pytest.approx(3e-7, rel=0.06)


@pytest.mark.parametrize('memory', [0.0, 0.6, 0.9])
def test_the_error_of_a_mean_is_the_scatter_of_means(memory):
    parts = segments(memory, count=400, length=100)
    scatter = np.std([part.mean() for part in parts])
    stated = of_channel(parts).deviation(100 * STEP)
    assert stated == pytest.approx(scatter, rel=0.15)


def test_white_noise_is_white_mostly():
    noise = of_channel(segments(0.0))
    assert noise.white > 0.95 * STEP * noise.deviation(STEP) ** 2


def test_a_slow_wander_counts_in_the_error_of_a_mean_though_stretches_are_short():
    slow = np.exp(-STEP / 4.0)
    fast = segments(0.0, count=60, length=200, scale=3e-7)
    wander = segments(slow, count=60, length=200, seed=1, scale=1e-7)
    noise = of_channel([a + b for a, b in zip(fast, wander, strict=True)])
    assert noise.deviation(200 * STEP) == pytest.approx(0.8e-7, rel=0.35)


def test_what_long_stretches_know_of_the_slow_part_counts_for_short_ones_too():
    slow = segments(np.exp(-STEP / 4.0), count=60, length=500, seed=3, scale=2e-7)
    long = [a + b for a, b in zip(segments(0.0, 60, 500), slow, strict=True)]
    short = segments(0.0, count=1, length=30, seed=5)
    found = noises.noise_by_class(
        {0: RestSource(rests(long)), 1: RestSource(rests(short))}, 1, 1.5)
    assert found[1][0].deviation(4.0) == pytest.approx(found[0][0].deviation(4.0), rel=0.2)
    assert found[1][0].deviation(4.0) > 3.0 * of_channel(short).deviation(4.0)


def test_the_means_of_the_stretches_do_not_count():
    parts = segments(0.3)
    moved = [part + 1e-4 * number for number, part in enumerate(parts)]
    assert of_channel(moved).deviation(STEP) == pytest.approx(
        of_channel(parts).deviation(STEP), rel=1e-6)


def test_a_record_without_noise_is_given_the_smallest():
    assert of_channel([np.zeros(50)] * 3).deviation(STEP) == pytest.approx(1e-9)


def test_a_common_cause_shows_as_correlation_between_channels():
    random = np.random.default_rng(1)
    common = random.normal(0.0, 3e-7, (40, 1, 100))
    own = random.normal(0.0, 3e-7, (40, 3, 100))
    assert channel_correlation(rests(own + common))[0, 2] == pytest.approx(0.5, abs=0.06)
    assert np.abs(channel_correlation(rests(own)) - np.eye(3)).max() < 0.06


def wandering(count, length, seed=0):
    """`count` rows of white noise of 3e-7 with a wander of 1e-7 within 4 s."""
    return np.stack([
        fast + slow for fast, slow in zip(
            segments(0.0, count, length, seed),
            segments(np.exp(-STEP / 4.0), count, length, seed + 1, scale=1e-7), strict=True)])


def cut(rows, stretch=137, every=300):
    """Stretches of rows (C, N), as plateaus of a record."""
    return [rows[:, start:start + stretch] for start in range(0, rows.shape[1] - stretch, every)]


def ratios_of(parity, rows, still=None):
    """Noise of channels (C, N) over that of a parity (1, N), at rest as in `still`."""
    at_rest = [part[0] for part in cut(parity if still is None else still)]
    return RestSource.beside(rests(cut(rows)), rests([parity]), at_rest).ratios


def test_the_parity_of_a_whole_record_shows_the_slow_part_between_the_stretches():
    stated = []
    for seed in range(0, 40, 4):
        rows = wandering(3, 15000, seed)
        parity = 1.5 * wandering(1, 15000, seed + 2)
        ratios = ratios_of(parity, rows)
        assert ratios == pytest.approx(1.0 / 1.5**2, rel=0.15)
        noise = RestSource(rests(cut(rows)), (), rests([parity]), ratios).noise(3, np.inf)[0]
        stated.append(noise.deviation(137 * STEP))
    true = ChannelNoise(9e-14 * STEP, np.array([1e-14]), 0.0, 1, np.array([4.0]))
    expected = true.deviation(137 * STEP)
    assert np.median(stated) == pytest.approx(expected, rel=0.1)
    assert np.std(stated) < 0.2 * expected


def test_a_parity_that_something_moves_says_nothing_about_noise():
    rows, parity = wandering(3, 15000), wandering(1, 15000, 2)
    jumps = np.where(np.arange(15000) // 150 % 4 == 3, 2e-6, 0.0)
    assert ratios_of(parity, rows) is not None
    assert ratios_of(parity + jumps, rows, parity) is None
    drift = np.cumsum(np.full(15000, 1e-9))
    assert ratios_of(parity + drift, rows) is None


def test_probes_of_another_kind_say_nothing_about_a_channel():
    rows, parity = wandering(3, 15000), 0.2 * wandering(1, 15000, 2)
    assert ratios_of(parity, rows) is None


def test_the_covariance_of_means_is_that_of_the_values_they_are_means_of():
    noise = ChannelNoise(0.0, np.array([2e-14, 1e-14]), 0.0, 1, np.array([1.0, 4.0]))
    spans = [(0, 25), (0, 300), (340, 600), (650, 900)]
    apart = STEP * np.abs(np.subtract.outer(np.arange(900), np.arange(900)))
    values = 2e-14 * np.exp(-apart) + 1e-14 * np.exp(-apart / 4.0)
    weights = np.zeros((len(spans), 900))
    for row, (start, stop) in zip(weights, spans, strict=True):
        row[start:stop] = 1.0 / (stop - start)
    centres = STEP * np.array([0.5 * (start + stop - 1) for start, stop in spans])
    widths = STEP * np.array([stop - start for start, stop in spans], dtype=float)
    stated = noise.covariance(centres, widths)
    assert stated == pytest.approx(weights @ values @ weights.T, rel=0.01)


def test_stamps_between_those_of_the_load_make_no_correlation():
    random = np.random.default_rng(4)
    quiet, loud = random.normal(size=(2, 60, 201))
    between = 0.5 * (quiet[:, 1:] + quiet[:, :-1])  # read halfway, interpolated
    front, rear = between, loud[:, 1:]
    parts = [np.stack([0.5 * (a + b), a - b]) for a, b in zip(front, rear, strict=True)]
    assert channel_correlation(rests(parts)) == pytest.approx(np.eye(2), abs=1e-12)


FINE = 0.01


def relaxing(random: np.random.Generator, count: int, white: float, slow: float,
             tau: float) -> list[RestSegment]:
    keep = np.exp(-FINE / tau)
    drive = random.normal(size=count * 400) * slow * np.sqrt(1.0 - keep**2)
    noise = lfilter([1.0], [1.0, -keep], drive) + random.normal(size=count * 400) * white
    return [RestSegment(part[None, :], FINE) for part in np.array_split(noise, count)]


def test_white_noise_averages_as_white_noise():
    random = np.random.default_rng(1)
    noise = measure_noise(relaxing(random, 30, 2.0, 0.0, 1.0), 1)[0]
    assert noise.deviation(1.0) == pytest.approx(2.0 * np.sqrt(FINE), rel=0.1)


def test_slow_noise_is_not_taken_for_white():
    random = np.random.default_rng(2)
    noise = measure_noise(relaxing(random, 60, 1.0, 1.0, 1.0), 1)[0]
    assert noise.deviation(2.0) > 0.5


def test_the_covariance_is_one_of_noise():
    random = np.random.default_rng(3)
    noise = measure_noise(relaxing(random, 30, 1.0, 1.0, 0.5), 1)[0]
    time = np.arange(50) * 0.5
    covariance = noise.covariance(time, np.full(50, 0.5))
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_no_rest_is_said_in_one_line():
    with pytest.raises(EstimationError, match='no stretch at rest'):
        measure_noise([], 1)


@pytest.mark.parametrize('count', [1, 3, 8])
def test_rows_together_have_the_allan_variances_of_each_row_by_itself(count):
    random = np.random.default_rng(0)
    rows = [5.0 + random.standard_normal(size) for size in (40, 2, 17, 16, 300)]
    numbers = [row.size // count - 1 for row in rows]
    means = [np.convolve(row, np.full(count, 1.0 / count), 'valid')
             for row, number in zip(rows, numbers, strict=True) if number > 0]
    alone = [0.5 * np.mean((mean[count:] - mean[:-count]) ** 2) for mean in means]
    kept = [number for number in numbers if number > 0]
    weighted, differences = RowTotals(rows).weighted_variance(count)
    assert differences == sum(kept)
    assert weighted == pytest.approx(np.dot(kept, alone))


def test_rows_that_are_too_short_have_no_differences():
    assert RowTotals([np.ones(3), np.ones(2)]).weighted_variance(2) == (0.0, 0)
