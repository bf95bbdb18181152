"""Units of the load and of the gaps, by readings that cannot be newtons or metres of this rig."""

import math

import numpy as np

from saddlering_ros.errors import BagError
from saddlering_ros.record.batches import Floats
from saddlering_ros.record.scratch import extremes, spread
from saddlering_ros.rig import TONNE
from saddlering_ros.rig.units import LoadLimits

LENGTH_UNITS = {
    'inches': 0.0254, 'feet': 0.3048, 'millimetres': 1e-3, 'mils': 25.4e-6, 'micrometres': 1e-6,
    'centimetres': 1e-2, 'nanometres': 1e-9}
"""Lengths [m] in which a probe may publish by mistake."""

MAX_SPAN = 0.1
"""Smallest gap [m] beyond any eddy-current probe, which shows another unit."""

AT_END = 0.002
"""Share of a probe's span within which a reading is at its end, on either side."""

FAR_OUTSIDE = 20.0
"""Distance of a typical gap from the probe's span, in spans, that shows another unit."""


def check_load_unit(where: str, load: Floats, limits: LoadLimits) -> None:
    """Raise BagError if the load (N,) cannot be newtons of a pushing cylinder of this rig."""
    low, high = map(float, extremes(load))
    shown = f'the load runs from {low:.4g} to {high:.4g} N'
    if -low > max(high, limits.negative_max):
        raise BagError(f'{where}: {shown}, mostly negative: publish a pushing load as positive '
                       '(in a map of an import: polarity: -1)')
    if high < limits.unit_min:
        if low == high:
            raise BagError(f'{where}: the load is {high:.4g} N throughout: check the load cell')
        guess = 'tonnes' if high <= 1.5 * limits.full_scale / TONNE else 'kilonewtons'
        raise BagError(f'{where}: {shown}, which looks like {guess}: publish newtons, load the '
                       f"ring, or correct the rig file's full_scale_load ({limits.full_scale:g} "
                       'N)')
    if high > limits.unit_max:
        raise BagError(f'{where}: {shown}, far beyond the cylinder: publish newtons, or '
                       f"correct the rig file's full_scale_load ({limits.full_scale:g} N)")


def check_probe_unit(where: str, gaps: Floats, min_range: float, max_range: float) -> None:
    """Raise BagError if the gaps (N,) of a probe cannot be metres."""
    typical = float(np.median(np.abs(spread(gaps))))
    if is_span(min_range, max_range) and max_range < MAX_SPAN:
        distance = max(min_range - typical, typical - max_range, 0.0)
        if distance > FAR_OUTSIDE * (max_range - min_range):
            raise BagError(
                f"{where}: readings around {typical:.4g} m are far outside the probe's span of "
                f'{min_range:g} to {max_range:g} m and look like '
                f'{_guess_unit(typical, min_range, max_range)}: publish metres')
    elif typical > MAX_SPAN:
        raise BagError(
            f'{where}: readings around {typical:.4g} m are beyond any eddy-current probe and '
            f'look like {_guess_unit(typical, 0.0, 0.01)}: publish range, min_range and '
            'max_range in metres')


def is_span(low: float, high: float) -> bool:
    """Whether a probe states a span."""
    return math.isfinite(low) and math.isfinite(high) and low < high


def unit_outside(values: Floats, low: float, high: float) -> str:
    """Words on the unit of a probe's readings, of which most lie outside of its span."""
    typical = float(np.median(np.abs(spread(values))))
    at_end = AT_END * (high - low)
    is_inside = not is_span(low, high) or low - at_end <= typical <= high + at_end
    return '' if is_inside else f' and look like {_guess_unit(typical, low, high)}'


def _guess_unit(typical: float, low: float, high: float) -> str:
    """The unit in which a typical reading lies nearest to the middle of a span in metres.

    Of a span about zero its positive part counts, because `typical` is a size.
    """
    inside = [(abs(math.log(2.0 * typical * factor / (max(low, 0.0) + high))), name)
              for name, factor in LENGTH_UNITS.items() if low < typical * factor < high]
    return min(inside, default=(0.0, 'another unit'))[1]
