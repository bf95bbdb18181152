"""The contact law of the fitted runs: the numbers and words of `identify`, in a verdict too.

The engine's own fit of the base parameters serves its metric; it counts model error and other
nuisance parameters. What a verdict prints of the contact law alone is the identification of the
same runs, so that the same bags give the same K, n, D everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.bags import TestRun
from saddlering_ros.discrepancy import Diagnosis
from saddlering_ros.discrepancy.engine import Estimate
from saddlering_ros.estimation.identifiability import still_open
from saddlering_ros.identification import Identification, identify, IdentificationError
from saddlering_ros.rig import PARAMETER_NAMES, PARAMETER_UNITS, Rig


@dataclass(frozen=True)
class ContactLaw:
    """Identification of the fitted runs, or None and why; reasons by name before and after.

    A parameter without a reason is determined by the fitted runs.
    """

    found: Identification | None
    refusal: str
    reasons_before: Mapping[str, str]
    reasons_after: Mapping[str, str]

    @property
    def notes(self) -> list[str]:
        """Why the engine's own values had to be given, if so."""
        return [f'contact parameters are those of the diagnosis alone: {self.refusal}'
                ] if self.refusal else []


def identified(
    runs: Sequence[TestRun], rig: Rig, is_cancelled: Callable[[], bool] | None
) -> tuple[Identification | None, str]:
    """The identification of runs, or None and one line on why there is none."""
    try:
        return identify(runs, rig, is_cancelled=is_cancelled), ''
    except IdentificationError as refusal:
        return None, str(refusal)


def with_contact_law(
    diagnosis: Diagnosis, identification: Identification | None, refusal: str,
    runs: Sequence[TestRun],
) -> tuple[Diagnosis, ContactLaw]:
    """A diagnosis that gives the contact law as identified, before and, without causes, after."""
    elevations = len({round(float(np.degrees(run.elevation))) for run in runs})
    if identification is None:
        before = still_open(_values(diagnosis.base_before), {}, elevations)
        after = still_open(_values(diagnosis.base_after), before, elevations)
        return diagnosis, ContactLaw(None, refusal, before, after)
    reasons = dict(identification.reasons)
    estimates = _estimates(identification)
    diagnosis = replace(diagnosis, base_before=estimates)
    if not diagnosis.causes:
        law = ContactLaw(identification, '', reasons, reasons)
        return replace(diagnosis, base_after=estimates,
                       base_covariance=identification.covariance), law
    after = still_open(_values(diagnosis.base_after), reasons, elevations)
    return diagnosis, ContactLaw(identification, '', reasons, after)


def _estimates(found: Identification) -> dict[str, Estimate]:
    spread = np.sqrt(np.diag(found.covariance))
    return {
        name: Estimate(float(getattr(found.parameters.contact, name)), float(spread[index]),
                       PARAMETER_UNITS[name])
        for index, name in enumerate(PARAMETER_NAMES)
    }


def _values(estimates: Mapping[str, Estimate]) -> dict[str, tuple[float, float]]:
    return {name: (item.value, item.std) for name, item in estimates.items()}
