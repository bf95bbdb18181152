"""Criteria of a validation, each with its worst run and channel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from saddlering_ros.identification.validation import ChannelFigures, RunValidation
from saddlering_ros.quantities import (
    allowed_misfit,
    compact,
    GOOD,
    MATERIAL,
    MAX_COMPARISON_ERROR,
    MIN_RATING,
    percent,
    quantity,
)
from saddlering_ros.rig import CHANNELS

SIMULATED = tuple(name for name in CHANNELS if name != 'parity')


@dataclass(frozen=True)
class Criterion:
    """A judged criterion: its demand, whether it is met, and its worst run and channel.

    value and limit in `unit`; bag and channel: where value over limit (or limit over value, if
    more is better) is largest.
    """

    id: str
    words: str
    is_met: bool
    value: float
    limit: float
    unit: str
    bag: str
    channel: str

    @property
    def value_words(self) -> str:
        """The value with its unit."""
        return _figure(self.value, self.unit)

    @property
    def limit_words(self) -> str:
        """The limit with its unit."""
        return _figure(self.limit, self.unit)

    @property
    def line(self) -> str:
        """'passed  rms misfit ...: worst delta_x of static_50, 0.31 % against 0.42 %'."""
        return (f'{"passed" if self.is_met else "FAILED"}  {self.words}: worst {self.channel} of '
                f'{self.bag}, {self.value_words} against {self.limit_words}')


def _figure(value: float, unit: str) -> str:
    if unit == '%':
        return percent(value, 3)
    return quantity(1e-6 * value, 'm') if unit == 'um' else compact(value)


def judge(runs: Sequence[RunValidation]) -> tuple[Criterion, ...]:
    """Every criterion for which these runs have figures."""
    found = [
        _worst(runs, SIMULATED, 'misfit', f'rms misfit at most {GOOD:g} x noise, or '
               f'{100.0 * MATERIAL:g} % of range', '%',
               lambda item: (item.nrmse, allowed_misfit(item.noise_floor))),
        _worst(runs, SIMULATED, 'comparison_error', 'comparison error E at most '
               f'{MAX_COMPARISON_ERROR:g} x its uncertainty u_val (ASME V&V 20)', '',
               lambda item: (item.e_over_uval, MAX_COMPARISON_ERROR)),
        _worst(runs, SIMULATED, 'iso18571', f'ISO 18571 rating at least {MIN_RATING:g} (good)', '',
               lambda item: (item.iso18571, MIN_RATING), more_is_better=True),
        _worst(runs, ('parity',), 'parity', f'parity at most {GOOD:g} x noise (rigid ring, sound '
               'probes)', 'um', _parity_figures),
    ]
    return tuple(item for item in found if item is not None)


Pair = tuple[float | None, float]


def _parity_figures(item: ChannelFigures) -> Pair:
    """Parity and its limit in micrometres; a share of its range, which is noise, is void."""
    return 1e6 * item.rmse, 1e6 * GOOD * (item.noise_floor or 0.0) * item.range


def _worst(
    runs: Sequence[RunValidation], channels: Sequence[str], name: str, words: str, unit: str,
    figures_of: Callable[[ChannelFigures], Pair], *, more_is_better: bool = False,
) -> Criterion | None:
    """The criterion at its worst place; None if no channel has the figure."""
    cases = []
    for run in runs:
        for channel in channels:
            if channel not in run.channels:
                continue  # A probe is absent.
            value, limit = figures_of(run.channels[channel])
            if value is not None:
                over = limit / max(value, 1e-300) if more_is_better else (
                    value / max(limit, 1e-300))
                cases.append((over, value, limit, run.name, channel))
    if not cases:
        return None
    over, value, limit, run_name, channel = max(cases)
    bag = run_name.rstrip('/').rsplit('/', 1)[-1]
    return Criterion(
        id=name, words=words, is_met=over <= 1.0, value=value, limit=limit, unit=unit, bag=bag,
        channel=channel)
