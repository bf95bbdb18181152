"""Metadata of a test: kind, elevation, rig, run, and further texts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math
from typing import Any

from saddlering_ros.errors import BagError, plain_number, printable

METADATA_RECORD = 'saddlering.test'
"""Name under which a file of messages holds the metadata."""

KEYS = ('test', 'elevation_deg', 'rig', 'run')
DETAILS = ('date', 'service_hours', 'operator', 'slew_deg', 'base', 'rig_hash', 'import_map',
           'import_sources', 'instruments')
"""Further texts: on the test, on the place of the ring, whether the session is a base measurement,
on the description of the rig (Rig.digest), on the files of an import, and on its instruments."""

KINDS = ('static', 'dynamic')
LOWEST_ELEVATION, HIGHEST_ELEVATION = -10.0, 90.0


@dataclass(frozen=True)
class TestMetadata:
    """Kind of a test, elevation [degrees], rig and run as free text.

    test and elevation_deg are None where a bag does not state them, or states them in two ways
    (`conflicts`) or in a form that cannot be read (`faults`); details: further texts by their
    key in DETAILS.
    """

    __test__ = False

    test: str | None = None
    elevation_deg: float | None = None
    rig: str = ''
    run: str = ''
    details: Mapping[str, str] = field(default_factory=dict)
    conflicts: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ('rig', 'run'):
            object.__setattr__(self, name, printable(getattr(self, name)))
        details = {key: printable(text) for key, text in self.details.items()}
        object.__setattr__(self, 'details', details)
        if self.test is not None:
            check_kind(self.test, 'facts')
        if self.elevation_deg is not None:
            check_elevation(self.elevation_deg, 'facts')

    def as_text(self) -> dict[str, str]:
        """What is stated, in the form of a bag: text to text."""
        texts = {} if self.test is None else {'test': self.test}
        if self.elevation_deg is not None:
            texts['elevation_deg'] = repr(float(self.elevation_deg)).removesuffix('.0')
        return {**texts, 'rig': self.rig, 'run': self.run, **self.details}

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons that prevent the use of the metadata, one line each, without the bag's name."""
        said = ' '.join(self.conflicts + self.faults)
        missing = [
            f'does not state the {what}: give {option}, or add "{key}" to custom_data of '
            f'metadata.yaml or to the record {METADATA_RECORD}'
            for key, value, what, option in (
                ('test', self.test, 'kind of test', "test='static' or test='dynamic'"),
                ('elevation_deg', self.elevation_deg, 'elevation', 'elevation_deg=DEG'))
            if value is None and f'{key} is' not in said]
        return (*self.conflicts, *self.faults, *missing)

    def overruled(self, test: str | None, elevation_deg: float | None) -> TestMetadata:
        """The same with values of options in place of those of the bag."""
        given: dict[str, Any] = {}
        if test is not None:
            given['test'] = check_kind(test, 'option')
        if elevation_deg is not None:
            given['elevation_deg'] = check_elevation(elevation_deg, 'option')
        conflicts, faults = (
            tuple(line for line in lines if line.partition(' is ')[0] not in given)
            for lines in (self.conflicts, self.faults))
        return replace(self, conflicts=conflicts, faults=faults, **given)


def check_kind(test: str, where: str) -> str:
    """The kind of test if it is a known kind."""
    if test not in KINDS:
        raise BagError(f'{where}: test is {test!r}: give static or dynamic')
    return test


def check_elevation(elevation_deg: float, where: str) -> float:
    """The elevation [degrees] if a barrel can have it."""
    if not LOWEST_ELEVATION <= elevation_deg <= HIGHEST_ELEVATION:
        raise BagError(
            f'{where}: elevation_deg is {elevation_deg:g}: give degrees from '
            f'{LOWEST_ELEVATION:g} to {HIGHEST_ELEVATION:g}')
    return float(elevation_deg)


def same_text(key: str, first: str, second: str) -> bool:
    """Whether two texts of a key state the same of a test."""
    if key == 'elevation_deg':
        one, other = finite_number(first), finite_number(second)
        if one is not None and other is not None:
            return math.isclose(one, other, abs_tol=1e-9)
    if key == 'test':
        return first.lower() == second.lower()
    return first == second


def finite_number(text: str) -> float | None:
    """The number that a text states; None if it states none."""
    try:
        value = plain_number(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
