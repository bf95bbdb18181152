"""Whether told probabilities are frequencies: reliability diagram, scores, calibration error."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from frame import wilson
import numpy as np
from numpy.typing import NDArray

BINS = 10
REPEATS = 1000
"""Draws for the uncertainty of the calibration error."""

Array = NDArray[np.float64]
Row = dict[str, Any]


def told_and_true(row: Row) -> list[tuple[float, float]]:
    """Each told probability of a trial with 1 where it was right.

    'unknown' is right if something is wrong and no listed cause is it. On a sound machine whose
    rest is not perfect both 'none' and 'unknown' are right, so that their sum is scored.
    """
    told, truth = dict(row['probabilities']), set(row['truth'])
    is_hidden = row['kind'] == 'hidden'
    listed = is_hidden and any(truth & set(name.split(' or ')) for name in told)
    if row['kind'] == 'sound' and not row['exact']:
        told['none'] = min(1.0, told['none'] + told.pop('unknown'))
    right = {'none': row['kind'] == 'sound', 'unknown': row['kind'] != 'sound' and not listed}
    return [(chance, float(right.get(name, is_hidden and bool(truth & set(name.split(' or '))))))
            for name, chance in told.items()]


def calibration_error(chances: Array, hits: Array) -> float:
    """Expected calibration error: mean distance of told and true over bins, by their counts."""
    places = np.minimum((chances * BINS).astype(int), BINS - 1)
    apart = np.bincount(places, chances - hits, BINS)
    return float(np.abs(apart).sum() / chances.size)


def report(rows: Sequence[Row], picture: Path | None = None) -> None:
    """Print the scores with their uncertainty, and the reliability diagram as a table."""
    pairs = [np.array(told_and_true(row)) for row in rows]
    chances, hits = np.concatenate(pairs).T
    right = np.clip(np.where(hits > 0.0, chances, 1.0 - chances), 1e-3, 1.0)
    print(f'{len(rows)} trials, {hits.size} told probabilities: Brier '
          f'{np.mean((chances - hits) ** 2):.4f}, log {-np.mean(np.log(right)):.4f}')
    uncertain('all', pairs)
    uncertain('the surest of each trial', [one[[np.argmax(one[:, 0])]] for one in pairs])
    uncertain('causes', [one[: len(row['groups'])] for one, row in zip(pairs, rows, strict=True)])
    bins = diagram(chances, hits)
    for told, true, low, high, count in bins:
        print(f'told {told:.3f}, true {true:.3f} ({low:.3f} to {high:.3f}), {count:.0f}')
    if picture:
        draw(bins, picture)


def uncertain(kind: str, pairs: Sequence[Array]) -> None:
    """Print the calibration error with what resampled trials and exact probabilities give."""
    random = np.random.default_rng(0)
    chances, hits = np.concatenate(pairs).T
    places = random.integers(len(pairs), size=(REPEATS, len(pairs)))
    again = [np.concatenate([pairs[place] for place in drawn]) for drawn in places]
    low, high = np.quantile([calibration_error(*one.T) for one in again], [0.025, 0.975])
    ideal = np.quantile([calibration_error(chances, random.random(hits.size) < chances)
                         for _ in range(REPEATS)], [0.5, 0.975])
    print(f'{kind}: calibration error {calibration_error(chances, hits):.4f} of {hits.size} '
          f'(resampled {low:.4f} to {high:.4f}; were every probability exact: median '
          f'{ideal[0]:.4f}, 97.5 % {ideal[1]:.4f})')


def diagram(chances: Array, hits: Array) -> Array:
    """By bin: mean told, share true with its 95 % interval (Wilson), number."""
    places = np.minimum((chances * BINS).astype(int), BINS - 1)
    bins = []
    for place in np.unique(places):
        own = places == place
        low, high = wilson(int(hits[own].sum()), int(own.sum()))
        bins.append((chances[own].mean(), hits[own].mean(), low, high, own.sum()))
    return np.array(bins)


def draw(bins: Array, path: Path) -> None:
    """The reliability diagram as a small picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.6, 3.4), layout='constrained')
    axes = figure.subplots()
    told, true, low, high, count = bins.T
    axes.plot([0, 1], [0, 1], color='0.7', linewidth=1.0)
    axes.errorbar(told, true, np.maximum([true - low, high - true], 0.0), fmt='o',
                  color='#1f5fa8', capsize=2)
    for place in range(told.size):
        axes.annotate(f'{count[place]:.0f}', (told[place], true[place]), (6, -9),
                      textcoords='offset points', fontsize=7)
    axes.set(xlabel='told probability', ylabel='share that was right', xlim=(-0.03, 1.03),
             ylim=(-0.03, 1.03))
    figure.savefig(path)
