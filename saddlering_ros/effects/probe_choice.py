"""Which of the four probes an effect sits on: the variants that all probe effects share."""

from __future__ import annotations

from collections.abc import Mapping

from saddlering_ros.effects.base import Choice, Variant

RADIAL_CHANNELS = ('delta_x', 'parity')
AXIAL_CHANNELS = ('delta_y', 'gamma')

ONE_PROBE = Choice(
    'probe', (1.0, 2.0, 3.0, 4.0), 'radial: 1 rear, 3 front; axial: 2 front, 4 rear')
ANY_PROBE = Choice('probe', (0.0, 1.0, 2.0, 3.0, 4.0), '0 for all probes, else one of them')


def probe_channels(probe: int) -> tuple[str, ...]:
    """Channels that one probe feeds: 1 and 3 are the radial probes, 2 and 4 the axial ones."""
    return RADIAL_CHANNELS if probe in (1, 3) else AXIAL_CHANNELS


def probe_variants(more: Mapping[str, float] | None = None,
                   words: str = '') -> tuple[Variant, ...]:
    """One variant per probe 1 to 4, each with `more` values and `words` if given."""
    return tuple(
        Variant(f'probe {probe}{words}', {'probe': float(probe), **(more or {})},
                probe_channels(probe))
        for probe in (1, 2, 3, 4)
    )


def probe_of(values: Mapping[str, float]) -> int:
    """Number of the probe chosen, 0 for all."""
    return round(values['probe'])
