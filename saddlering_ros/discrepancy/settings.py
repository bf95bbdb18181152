"""Strictness of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Strictness of a diagnosis. The values were chosen before the blind trials that check them.

    error_rate: chance of a false cause on clean data; materiality: share of a channel's range
    below which a finding is only listed; max_causes: largest number of causes; refits:
    candidates refitted at each step; min_partial: share of the remaining misfit that a member
    of a model must explain, in all or in one channel; min_total: share of the misfit that all
    causes together must explain to be named; alternative_rate: chance that noise alone puts
    the true cause so far behind an alternative that it leaves the group; alternative_share: an
    alternative stays in the group while its additional misfit is within this share of the
    residual; form_error: share of the misfit explained by an effect that its simplified law
    may leave: prior of the forms of a law, and misfit within which alternatives stay in the
    group; rounds: least-squares rounds of each candidate;
    max_rounds: least-squares rounds of the fits behind the verdict; seed: of random starts.
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
