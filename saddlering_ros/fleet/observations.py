"""Results of sessions as arrays: the parameters of each session, with their covariance.

A ring is described by six coordinates: log stiffness of both contacts at a reference penetration,
exponents, and log damping. K and n of one contact are all but exchangeable (their correlation is
about -0.98); the stiffness at the penetration where the ring works is what a session measures.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import SaddleringError

Array = NDArray[np.float64]

COORDINATES = ('stiffness_1', 'exponent_1', 'damping_1', 'stiffness_2', 'exponent_2', 'damping_2')
"""log(K p^(n-1)) [log N/m], n, log D [log N s/m], of the axial rows (1) and the radial row (2)."""

PARAMETERS = ('K1', 'n1', 'D1', 'K2', 'n2', 'D2')
REFERENCE_PENETRATION = 2e-5
"""Penetration [m] of the reference stiffness: half of that at full load."""

MAX_DEVIATION = 1.0
"""A logarithm known no better than this is not a measurement."""


class FleetError(SaddleringError):
    """Sessions or limits that fleet statistics cannot use."""


@dataclass(frozen=True)
class SessionFigures:
    """One session: value (6,) and covariance (6, 6) of COORDINATES, NaN where not measured.

    time [s since 1970] and service_hours of the test, NaN if unknown; causes: size and standard
    deviation of every effect named, by its id; change: what changed since the base measurement of
    the ring in one sentence, '' if nothing did.
    """

    key: str
    name: str
    ring: str
    bench: str
    time: float
    service_hours: float
    maintenance: bool
    verdict: str
    p_value: float
    value: Array
    covariance: Array
    causes: Mapping[str, tuple[float, float]]
    next_test: str = ''
    report: str = ''
    change: str = ''


def figures_of(task: Mapping[str, Any], result: Mapping[str, Any], p_value: float
               ) -> SessionFigures:
    """Figures of one result; a failed session has no values."""
    document, change = result.get('verdict') or {}, result.get('change') or {}
    value, covariance = np.full(6, np.nan), np.full((6, 6), np.nan)
    after = (document.get('parameters') or {}).get('after') or {}
    if result.get('covariance') and all(after.get(name) is not None for name in PARAMETERS):
        value, covariance = to_coordinates(
            np.array([float(after[name]) for name in PARAMETERS]),
            np.asarray(result['covariance'], dtype=float))
    causes = {
        item['effect']: (float(size['value']), float(size['std'] or math.nan))
        for item in document.get('causes') or []
        if 'effect' in item and not item.get('partial')
        for size in list((item.get('parameters') or {}).values())[:1]
    }
    return SessionFigures(
        key=result['key'], name=task['name'], ring=task['ring'], bench=task['bench'],
        time=float(math.nan if task['time'] is None else task['time']),
        service_hours=float(math.nan if task['service_hours'] is None else task['service_hours']),
        maintenance=bool(task['maintenance']), verdict=document.get('verdict') or 'failed',
        p_value=p_value, value=value, covariance=covariance, causes=causes,
        next_test=document.get('next_test') or '', report=result.get('report') or '',
        change='' if change.get('verdict') in (None, 'none') else change['headline'].rstrip('.'))


def to_coordinates(parameters: Array, covariance: Array) -> tuple[Array, Array]:
    """Values (6,) and covariance (6, 6) of COORDINATES from K, n, D of both contacts (SI).

    A damping that the tests do not determine (static ones alone) becomes NaN.
    """
    depth = math.log(REFERENCE_PENETRATION)
    value, slopes = parameters.copy(), np.eye(6)
    for stiffness, exponent, damping in ((0, 1, 2), (3, 4, 5)):
        value[stiffness] = math.log(parameters[stiffness]) + (parameters[exponent] - 1.0) * depth
        slopes[stiffness, stiffness] = 1.0 / parameters[stiffness]
        slopes[stiffness, exponent] = depth
        value[damping] = math.log(parameters[damping])
        slopes[damping, damping] = 1.0 / parameters[damping]
    spread = slopes @ covariance @ slopes.T
    unknown = ~(np.sqrt(np.abs(np.diag(spread))) < MAX_DEVIATION)
    value[unknown] = np.nan
    spread[unknown, :] = spread[:, unknown] = np.nan
    return value, spread
