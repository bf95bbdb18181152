"""Claims about the noise read from stretches at rest."""

import numpy as np
import pytest
from scipy.signal import lfilter

from saddlering_ros.estimation.noise import (
    ChannelNoise,
    fit_channel,
    fit_noise,
    NoiseModel,
    parity_ratios,
    ParityNoise,
)

STEP = 0.02


def segments(memory, count=50, length=200, seed=0, scale=3e-7):
    """`count` stretches of AR(1) noise with standard deviation `scale`."""
    random = np.random.default_rng(seed)
    drive = random.normal(0.0, scale * np.sqrt(1.0 - memory**2), (count, length + 200))
    return list(lfilter([1.0], [1.0, -memory], drive, axis=1)[:, 200:])


@pytest.mark.parametrize('memory', [0.0, 0.5, 0.9])
def test_standard_deviation_is_read_whatever_the_memory(memory):
    assert fit_channel(segments(memory), STEP).standard_deviation == pytest.approx(3e-7, rel=0.06)


@pytest.mark.parametrize('memory', [0.0, 0.6, 0.9])
def test_the_error_of_a_mean_is_the_scatter_of_means(memory):
    parts = segments(memory, count=400, length=100)
    scatter = np.std([part.mean() for part in parts])
    stated = np.sqrt(fit_channel(parts, STEP).variance_of_mean(100))
    assert stated == pytest.approx(scatter, rel=0.15)


def test_white_noise_is_white_mostly():
    noise = fit_channel(segments(0.0), STEP)
    assert noise.white > 0.95 * noise.standard_deviation**2


def test_a_slow_wander_counts_in_the_error_of_a_mean_though_stretches_are_short():
    slow = np.exp(-STEP / 4.0)
    fast = segments(0.0, count=60, length=200, scale=3e-7)
    wander = segments(slow, count=60, length=200, seed=1, scale=1e-7)
    noise = fit_channel([a + b for a, b in zip(fast, wander, strict=True)], STEP)
    assert np.sqrt(noise.variance_of_mean(200)) == pytest.approx(0.8e-7, rel=0.35)


def test_what_longer_stretches_know_of_the_slow_part_is_taken_over():
    slow = NoiseModel((ChannelNoise(STEP, 1e-14, np.array([4.0]), np.array([4e-14])),), np.eye(1))
    short = [segment[None] for segment in segments(0.0, count=1, length=30)]
    noise = fit_noise(short, STEP, slow).channels[0]
    assert noise.at(np.array([0.0]))[0] == pytest.approx(4e-14, rel=0.2)


def test_the_means_of_the_stretches_do_not_count():
    parts = segments(0.3)
    moved = [part + 1e-4 * number for number, part in enumerate(parts)]
    assert fit_channel(moved, STEP).standard_deviation == pytest.approx(
        fit_channel(parts, STEP).standard_deviation, rel=1e-6
    )


def test_a_record_without_noise_is_given_the_smallest():
    assert fit_channel([np.zeros(50)] * 3, STEP).standard_deviation == pytest.approx(1e-9)


def test_the_autocovariance_is_that_of_the_process():
    noise = ChannelNoise(STEP, 2.0, np.array([0.1]), np.array([1.0]))
    assert noise.autocovariance(4) == pytest.approx(
        [3.0, *np.exp(-STEP * np.arange(1, 4) / 0.1)]
    )


def test_a_common_cause_shows_as_correlation_between_channels():
    random = np.random.default_rng(1)
    common = random.normal(0.0, 3e-7, (40, 1, 100))
    own = random.normal(0.0, 3e-7, (40, 3, 100))
    model = fit_noise(list(own + common), STEP)
    assert model.correlation[0, 2] == pytest.approx(0.5, abs=0.06)
    independent = fit_noise(list(own), STEP)
    assert np.abs(independent.correlation - np.eye(3)).max() < 0.06


def wandering(count, length, seed=0):
    """`count` rows of white noise of 3e-7 with a wander of 1e-7 within 4 s."""
    return np.stack([
        fast + slow for fast, slow in zip(
            segments(0.0, count, length, seed),
            segments(np.exp(-STEP / 4.0), count, length, seed + 1, scale=1e-7), strict=True)
    ])


def cut(rows, stretch=137, every=300):
    """Stretches of rows (C, N), as plateaus of a record."""
    return [rows[:, start:start + stretch] for start in range(0, rows.shape[1] - stretch, every)]


def test_the_parity_of_a_whole_record_shows_the_slow_part_between_the_stretches():
    stated = []
    for seed in range(0, 40, 4):
        rows = wandering(3, 15000, seed)
        parity = 1.5 * wandering(1, 15000, seed + 2)
        ratios = parity_ratios([parity], cut(parity), cut(rows))
        assert ratios == pytest.approx(1.0 / 1.5**2, rel=0.15)
        noise = fit_noise(cut(rows), STEP, parity=ParityNoise([parity], ratios)).channels[0]
        stated.append(np.sqrt(noise.variance_of_mean(137)))
    true = ChannelNoise(STEP, 9e-14, np.array([4.0]), np.array([1e-14])).variance_of_mean(137)
    assert np.median(stated) == pytest.approx(np.sqrt(true), rel=0.1)
    assert np.std(stated) < 0.2 * np.sqrt(true)


def test_a_parity_that_something_moves_says_nothing_about_noise():
    rows, parity = wandering(3, 15000), wandering(1, 15000, 2)
    jumps = np.where(np.arange(15000) // 150 % 4 == 3, 2e-6, 0.0)
    assert parity_ratios([parity], cut(parity), cut(rows)) is not None
    assert parity_ratios([parity + jumps], cut(parity), cut(rows)) is None
    drift = np.cumsum(np.full(15000, 1e-9))
    assert parity_ratios([parity + drift], cut(parity + drift), cut(rows)) is None


def test_probes_of_another_kind_say_nothing_about_a_channel():
    rows, parity = wandering(3, 15000), 0.2 * wandering(1, 15000, 2)
    assert parity_ratios([parity], cut(parity), cut(rows)) is None


def test_the_covariance_of_means_is_that_of_the_values_they_are_means_of():
    noise = ChannelNoise(STEP, 0.0, np.array([1.0, 4.0]), np.array([2e-14, 1e-14]))
    spans = [(0, 25), (0, 300), (340, 600), (650, 900)]
    values = noise.at(STEP * np.abs(np.subtract.outer(np.arange(900), np.arange(900))))
    weights = np.zeros((len(spans), 900))
    for row, (start, stop) in zip(weights, spans, strict=True):
        row[start:stop] = 1.0 / (stop - start)
    centres = STEP * np.array([0.5 * (start + stop - 1) for start, stop in spans])
    stated = noise.covariance_of_means(centres, [stop - start for start, stop in spans])
    assert stated == pytest.approx(weights @ values @ weights.T, rel=0.01)


def test_stamps_between_those_of_the_load_make_no_correlation():
    random = np.random.default_rng(4)
    quiet, loud = random.normal(size=(2, 60, 201))
    between = 0.5 * (quiet[:, 1:] + quiet[:, :-1])  # read halfway, interpolated
    front, rear = between, loud[:, 1:]
    parts = [np.stack([0.5 * (a + b), a - b]) for a, b in zip(front, rear, strict=True)]
    assert fit_noise(parts, STEP).correlation == pytest.approx(np.eye(2), abs=1e-12)
