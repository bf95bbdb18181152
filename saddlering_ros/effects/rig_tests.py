"""Tests on the rig that separate causes, the most informative first.

The `outcomes` of an effect hold the result of each of these tests if that effect is the cause.
"""

from __future__ import annotations

from dataclasses import dataclass

UNCLEAR = ''
"""The outcome of a test that does not separate an effect from the others."""


@dataclass(frozen=True)
class Outcomes:
    """Outcomes of the tests of RIG_TESTS, by their id, as a noun with its clause.

    None: outcome for every effect without an entry.
    """

    second_rate: str | None = None
    repeat_cycle: str | None = None
    zero_load: str | None = None
    swapped_probes: str | None = None
    slewed_ring: str | None = None
    other_elevation: str | None = None
    reference_load: str | None = None
    inclinometer: str | None = None
    pull_push: str | None = None
    heights: str | None = None
    other_gap: str | None = None


@dataclass(frozen=True)
class RigTest:
    """One test: its id, its instruction, and the outcome of effects without an entry."""

    id: str
    instruction: str
    otherwise: str = UNCLEAR


RIG_TESTS = (
    RigTest('second_rate', 'Record a dynamic test at a second loading rate, four times slower.',
            'a misfit that does not depend on the rate'),
    RigTest('repeat_cycle', 'Record two cycles with holds of 30 s at preload and at full load.',
            'the same misfit in both cycles'),
    RigTest('zero_load', 'Record ten minutes at constant preload, at the highest sampling rate.',
            'no misfit at constant preload'),
    RigTest('swapped_probes', 'Swap probes 1 and 3, and probes 2 and 4, and repeat the static '
            'test.', 'a misfit that does not move'),
    RigTest('slewed_ring', 'Slew the ring by 90 deg and repeat the static test.',
            'a misfit that does not change'),
    RigTest('other_elevation', 'Repeat the static test at another elevation.'),
    RigTest('reference_load', 'Put a calibrated load cell in line with the cylinder and repeat '
            'the static test.', 'a load that agrees with the reference'),
    RigTest('inclinometer', 'Put an inclinometer on the loading axis and repeat the static test.',
            'an angle as recorded'),
    RigTest('pull_push', 'Pull and push the ring slowly through zero load.',
            'no unexpected jump at zero load'),
    RigTest('heights', 'Measure the heights of the loading axis and of probes 1 and 3 over the '
            'mid-plane of the ring.', 'heights as in the rig file'),
    RigTest('other_gap', 'Set the gap of the probe wider at zero load and repeat the static test.',
            'the same misfit'),
)
"""Order of preference among tests that separate as much."""
