"""Assumptions of the engine on noise, offsets and model error, made before a residual is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from saddlering_ros.discrepancy.noise import learn_noise
from saddlering_ros.discrepancy.priors import FREE_OFFSET, ModelErrorPrior
from saddlering_ros.discrepancy.system import Array, RunBlocks
from saddlering_ros.estimation.process import ChannelNoise

NoiseByRun = Mapping[tuple[str, int], ChannelNoise]
LearnNoise = Callable[[Sequence[RunBlocks], Sequence[Array] | None], NoiseByRun]
"""Noise by run name and channel, from runs and, if there are some, residuals (C, N) per run."""


@dataclass(frozen=True)
class Assumptions:
    """Noise, offsets and model error of a system.

    learn_noise: source of the noise; relearns: whether the noise is learnt again from the
    residual of a model with the causes; offsets: spread of the constant of each channel, None
    if it is free; model_error: smooth error over the drive, None for none; form_error: share
    of the misfit explained by an effect by which its shapes may exceed their bounds while a name
    remains valid; 0: laws are exact, so that every residual beyond noise is a doubt;
    coordinate_waves: half waves that are tested along the first coordinate and along each
    other one; proposes_law: whether a law is proposed if no cause explains the misfit;
    many_valleys: whether the base may have several minima, so that the best one without an
    effect may be far from the best one with it.
    """

    learn_noise: LearnNoise = learn_noise
    relearns: bool = False
    offsets: tuple[float, ...] | None = None
    model_error: ModelErrorPrior | None = field(default_factory=ModelErrorPrior)
    form_error: float = 0.1
    coordinate_waves: tuple[int, int] = (6, 3)
    proposes_law: bool = True
    many_valleys: bool = False

    def frees_constant(self, channel: int) -> bool:
        """Whether a constant in a channel has no meaning."""
        return self.offsets is None or self.offsets[channel] >= FREE_OFFSET
