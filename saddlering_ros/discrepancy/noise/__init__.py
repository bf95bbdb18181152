"""Noise of a channel, declared or learnt, and the whitening of residuals."""

from saddlering_ros.discrepancy.noise.adequacy import (
    overestimated,
    overestimated_sentence,
    underestimated,
    underestimated_sentence,
)
from saddlering_ros.discrepancy.noise.declared import Noise
from saddlering_ros.discrepancy.noise.residuals import widened, with_model_error
from saddlering_ros.estimation.process import ChannelNoise, TIME_CONSTANTS
from saddlering_ros.estimation.rest_noise import HeldSeries, measure_noise
from saddlering_ros.estimation.stretch_noise import ChannelRecord
from saddlering_ros.estimation.whitener import build_whitener, Whitener

__all__ = [
    'TIME_CONSTANTS', 'ChannelNoise', 'ChannelRecord', 'HeldSeries', 'Noise', 'Whitener',
    'build_whitener', 'measure_noise', 'overestimated', 'overestimated_sentence', 'underestimated',
    'underestimated_sentence', 'widened', 'with_model_error',
]
