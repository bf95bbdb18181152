"""The knobs of the model live with the effects that turn them; see saddlering_ros/effects/extension.py."""

from saddlering_ros.effects.extension import *  # noqa: F403
