"""Metadata of a test (kind, elevation, rig, run): their places in a bag and their precedence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math

from saddlering_ros.bags.errors import BagError

RECORD = 'saddlering.test'
"""Name of the MCAP metadata record that holds the facts."""

KEYS = ('test', 'elevation_deg', 'rig', 'run')
DETAILS = ('date', 'service_hours', 'operator', 'rig_hash', 'import_map', 'import_sources')
"""Further texts of a bag: on the test, on the description of the rig (Rig.digest), and on the
files of an import."""

KINDS = ('static', 'dynamic')
LOWEST_ELEVATION, HIGHEST_ELEVATION = -10.0, 90.0


@dataclass(frozen=True)
class TestFacts:
    """Test metadata of a bag: kind, elevation [degrees], rig and run as free text.

    details: further texts by their key in DETAILS.
    """

    __test__ = False

    test: str
    elevation_deg: float
    rig: str = ''
    run: str = ''
    details: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_kind(self.test, 'facts')
        check_elevation(self.elevation_deg, 'facts')

    def as_text(self) -> dict[str, str]:
        """The facts in the form of a bag, text to text."""
        elevation = repr(float(self.elevation_deg)).removesuffix('.0')
        return {
            'test': self.test, 'elevation_deg': elevation,
            'rig': self.rig, 'run': self.run, **self.details,
        }


@dataclass(frozen=True)
class FoundFacts:
    """Metadata as found in a bag; None if not stated, or stated in two ways (`conflicts`)."""

    test: str | None = None
    elevation_deg: float | None = None
    rig: str = ''
    run: str = ''
    details: Mapping[str, str] = field(default_factory=dict)
    conflicts: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons that prevent the use of the metadata, one line each, without the bag's name."""
        missing = []
        said = ' '.join(self.conflicts + self.faults)
        if self.test is None and 'test is' not in said:
            missing.append(
                'does not state the kind of test: give --test static or --test dynamic, or '
                f'add "test" to custom_data of metadata.yaml or to the record {RECORD}')
        if self.elevation_deg is None and 'elevation_deg is' not in said:
            missing.append(
                'does not state the elevation: give --elevation DEG, or add "elevation_deg" to '
                f'custom_data of metadata.yaml or to the record {RECORD}')
        return (*self.conflicts, *self.faults, *missing)

    def overruled(self, test: str | None, elevation_deg: float | None) -> FoundFacts:
        """The same with values of options in place of those of the bag."""
        facts = self
        if test is not None:
            facts = facts._settled('test', test=check_kind(test, 'option'))
        if elevation_deg is not None:
            value = check_elevation(elevation_deg, 'option')
            facts = facts._settled('elevation_deg', elevation_deg=value)
        return facts

    def _settled(self, key: str, **values: object) -> FoundFacts:
        return replace(
            self,
            conflicts=tuple(line for line in self.conflicts if not line.startswith(f'{key} is')),
            faults=tuple(line for line in self.faults if not line.startswith(f'{key} is')),
            **values)  # type: ignore[arg-type]


def find_facts(
    custom_data: Mapping[str, str], record: Mapping[str, str], recorder: Mapping[str, str],
) -> FoundFacts:
    """The facts on which the places of a bag agree.

    `custom_data` of metadata.yaml and the MCAP record `saddlering.test` have the same weight:
    either is enough, and both must agree. `recorder` (custom_data in the MCAP record that
    rosbag2 writes itself) gives only facts that neither states, for instance after a
    reindexing, which loses custom_data from metadata.yaml.
    """
    values: dict[str, str] = {}
    conflicts = []
    for key in (*KEYS, *DETAILS):
        first, second = _clean(custom_data.get(key)), _clean(record.get(key))
        if first is not None and second is not None and not same_fact(key, first, second):
            conflicts.append(
                f'{key} is {first!r} in metadata.yaml and {second!r} in the MCAP record {RECORD}: '
                f'correct one{_overrule(key)}')
            continue
        value = first if first is not None else second
        if value is None:
            value = _clean(recorder.get(key))
        if value is not None:
            values[key] = value
    faults: list[str] = []
    test = _kind(values.get('test'), faults)
    elevation = _elevation(values.get('elevation_deg'), faults)
    details = {key: values[key] for key in DETAILS if key in values}
    return FoundFacts(test, elevation, values.get('rig', ''), values.get('run', ''), details,
                      tuple(conflicts), tuple(faults))


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


def _overrule(key: str) -> str:
    options = {'test': '--test', 'elevation_deg': '--elevation'}
    return f', or give {options[key]}' if key in options else ''


def _clean(value: object) -> str | None:
    return None if value is None or not str(value).strip() else str(value).strip()


def same_fact(key: str, first: str, second: str) -> bool:
    """Whether two texts state the same fact of a test."""
    if key == 'elevation_deg':
        one, other = _number(first), _number(second)
        if one is not None and other is not None:
            return math.isclose(one, other, abs_tol=1e-9)
    if key == 'test':
        return first.lower() == second.lower()
    return first == second


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _kind(text: str | None, faults: list[str]) -> str | None:
    if text is None:
        return None
    if text.lower() in KINDS:
        return text.lower()
    faults.append(f'test is {text!r}, which is not a kind of test: give --test static or dynamic')
    return None


def _elevation(text: str | None, faults: list[str]) -> float | None:
    if text is None:
        return None
    value = _number(text)
    if value is not None and LOWEST_ELEVATION <= value <= HIGHEST_ELEVATION:
        return value
    faults.append(
        f'elevation_deg is {text!r}, which is not an elevation from {LOWEST_ELEVATION:g} to '
        f'{HIGHEST_ELEVATION:g} degrees: give --elevation DEG')
    return None
