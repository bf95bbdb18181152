"""Slow probe electronics: a first-order low-pass on one or all probes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Effect, EffectParameter, Variant
from saddlering_ros.effects.extension import RingExtension, with_probe
from saddlering_ros.effects.probe_choice import ANY_PROBE, probe_of, probe_variants


class ProbeLag(Effect):
    """Probe lag."""

    id = 'probe_lag'
    title = 'Probe lag'
    words = (
        'A filter in the electronics makes one probe, or all of them, follow late. In a dynamic '
        'run the error is exponential after each corner of the load; a static run shows nothing. '
        'On all probes it looks much like damping.'
    )
    settled_by = 'A second loading rate (x4), with swapped probes if only one is slow.'
    stage = 'measurement'
    channels = ('delta_x', 'delta_y', 'gamma', 'parity')
    parameters = (
        EffectParameter(
            'time', 's', 0.0, 1.0, 0.03, 0.03,
            'time constant of the low-pass', amplitude=True, one_sided=True),
    )
    variants = (
        Variant('all probes', {'probe': 0.0}, ('delta_x', 'delta_y', 'gamma')), *probe_variants())
    choices = (ANY_PROBE,)
    dynamic_only = True

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """Add to the probe chosen."""
        changed = with_probe(extension.probe_lag, probe_of(values), values['time'])
        return replace(extension, probe_lag=changed)
