"""Noise of a channel: what is declared or learnt about it, and how residuals are whitened."""

from saddlering_ros.discrepancy.noise.rest import (
    ChannelNoise,
    HeldSeries,
    measure_noise,
    TIME_CONSTANTS,
)

__all__ = ['TIME_CONSTANTS', 'ChannelNoise', 'HeldSeries', 'measure_noise']
