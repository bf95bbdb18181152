"""The contact law of the fitted runs: a verdict has the numbers and words of `identify`.

The engine's own fit of the base parameters serves its metric and counts model error and other
nuisance parameters. The contact law alone in a verdict is the identification of the same runs, so
that the same bags give the same K, n, D everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.discrepancy import Diagnosis, Estimate
from saddlering_ros.estimation.identifiability import still_open
from saddlering_ros.identification import Identification, IdentificationError, identify
from saddlering_ros.progress import Cancelled, IsCancelled
from saddlering_ros.record import Record
from saddlering_ros.rig import PARAMETER_NAMES, PARAMETER_UNITS, Rig

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ContactLaw:
    """Contact parameters by name, alone (before) and beside the causes found (after).

    covariance (6, 6): of the values after; reasons by name: why the fitted runs do not
    determine a parameter; refusal: why the runs could not be identified, '' if they could.
    """

    before: Mapping[str, Estimate]
    after: Mapping[str, Estimate]
    covariance: Array
    reasons_before: Mapping[str, str]
    reasons_after: Mapping[str, str]
    refusal: str = ''

    @property
    def notes(self) -> list[str]:
        """Reason for values of the engine itself, if they had to be used."""
        return ['the contact parameters are those of the diagnosis, not of an identification: '
                f'{self.refusal}'
                ] if self.refusal else []


def identified(
    runs: Sequence[Record], rig: Rig, is_cancelled: IsCancelled | None = None
) -> Identification | str:
    """The contact law of the fitted runs without causes, or the reason why there is none."""
    try:
        found = identify(runs, rig, is_cancelled=is_cancelled)
    except IdentificationError as refusal:
        return str(refusal)
    if found.cancelled:
        raise Cancelled('diagnose: cancelled')
    return found


def contact_law(
    diagnosis: Diagnosis, runs: Sequence[Record], found: Identification | str
) -> ContactLaw:
    """The contact law of the fitted runs: as identified alone, and after a diagnosis."""
    if isinstance(found, str):
        return refused(diagnosis, found, elevations_of(runs))
    return beside_causes(diagnosis, found, elevations_of(runs))


def refused(diagnosis: Diagnosis, refusal: str, elevations: int) -> ContactLaw:
    """Estimates of the engine itself, if the runs cannot be identified."""
    before = still_open(_values(diagnosis.base_alone), {}, elevations)
    after = still_open(_values(diagnosis.base), before, elevations)
    return ContactLaw(diagnosis.base_alone, diagnosis.base, diagnosis.fits.base_covariance,
                      before, after, refusal)


def beside_causes(diagnosis: Diagnosis, found: Identification, elevations: int) -> ContactLaw:
    """The identified contact law; with causes in the model, estimates of the engine after."""
    before = _estimates(found)
    if not diagnosis.causes:
        of_noise = found.parameters.source.covariance
        assert of_noise is not None
        return ContactLaw(before, before, of_noise, found.reasons, found.reasons)
    after = still_open(_values(diagnosis.base), found.reasons, elevations)
    return ContactLaw(
        before, diagnosis.base, diagnosis.fits.base_covariance, found.reasons, after)


def elevations_of(runs: Sequence[Record]) -> int:
    """Number of elevations that differ by more than a degree."""
    return len({round(float(np.degrees(run.elevation))) for run in runs})


def _estimates(found: Identification) -> dict[str, Estimate]:
    spread = np.sqrt(np.diag(found.covariance))
    return {
        name: Estimate(float(getattr(found.parameters.contact, name)), float(spread[index]),
                       PARAMETER_UNITS[name])
        for index, name in enumerate(PARAMETER_NAMES)
    }


def _values(estimates: Mapping[str, Estimate]) -> dict[str, tuple[float, float]]:
    return {name: (item.value, item.std) for name, item in estimates.items()}
