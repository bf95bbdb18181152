"""How strict a diagnosis is, and how its caller follows and stops it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from saddlering_ros.errors import Cancelled

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the share that is done."""


@dataclass(frozen=True)
class Settings:
    """How strict to be. The figures were chosen beforehand; blind trials check them.

    error_rate: chance of any false cause on clean data; materiality: share of a view's range under
    which a finding is listed only; max_causes: causes at most; refits: candidates refitted at each
    step;
    min_partial: share of the remaining misfit that a member of a model must explain, in all or
    in one view;
    min_total: share of the misfit that the whole model must explain to be named;
    alternative_rate: chance that noise alone makes an alternative fit as much worse as those left
    out of a group do; alternative_share: an alternative stays in the group while its misfit is
    within this share of the residual's; form_error: share of the misfit an effect explains by
    which its idealised form may err: alternatives as close as that stay in its group, and a
    further cause smaller than that in the same view is no cause; rounds: least-squares rounds of
    each candidate; max_rounds: of the fits on which the verdict rests.
    """

    error_rate: float = 0.01
    materiality: float = 1e-3
    max_causes: int = 3
    refits: int = 6
    min_partial: float = 0.5
    min_total: float = 0.85
    alternative_rate: float = 1e-4
    alternative_share: float = 0.33
    form_error: float = 0.1
    rounds: int = 8
    max_rounds: int = 60
    seed: int = 0


@dataclass(frozen=True)
class Watch:
    """The caller's progress display and wish to stop."""

    on_progress: Progress | None = None
    is_cancelled: Callable[[], bool] | None = None

    def progress(self, stage: str, share: float) -> None:
        """Report that `share` of the work is done."""
        if self.on_progress is not None:
            self.on_progress(stage, share)

    def check(self) -> None:
        """Raise `Cancelled` if the caller wishes to stop."""
        if self.is_cancelled is not None and self.is_cancelled():
            raise Cancelled('diagnose: cancelled')
