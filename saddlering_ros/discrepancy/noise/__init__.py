"""Noise of a channel: what is declared or learnt about it, and how residuals are whitened."""

from saddlering_ros.discrepancy.noise.process import ChannelNoise, TIME_CONSTANTS
from saddlering_ros.discrepancy.noise.rest import HeldSeries, measure_noise
from saddlering_ros.discrepancy.noise.whitening import build_whitener, Whitener

__all__ = [
    'TIME_CONSTANTS', 'ChannelNoise', 'HeldSeries', 'Whitener', 'build_whitener', 'measure_noise',
]
