"""The places in a bag that state the metadata of its test, and their precedence."""

from __future__ import annotations

from collections.abc import Mapping

from saddlering_ros.record.metadata import (
    DETAILS,
    finite_number,
    HIGHEST_ELEVATION,
    KEYS,
    KINDS,
    LOWEST_ELEVATION,
    METADATA_RECORD,
    same_text,
    TestMetadata,
)


def find_metadata(
    custom_data: Mapping[str, str], record: Mapping[str, str], recorder: Mapping[str, str],
) -> TestMetadata:
    """The test metadata on which the places of a bag agree.

    `custom_data` of metadata.yaml and the MCAP record `saddlering.test` have the same weight:
    either is enough, and both must agree. `recorder` (custom_data in the MCAP record that
    rosbag2 writes itself) gives only texts that neither states, for instance after a
    reindexing, which loses custom_data from metadata.yaml.
    """
    values: dict[str, str] = {}
    conflicts = []
    for key in (*KEYS, *DETAILS):
        first, second = _clean(custom_data.get(key)), _clean(record.get(key))
        if first is not None and second is not None and not same_text(key, first, second):
            conflicts.append(
                f'{key} is {first!r} in metadata.yaml and {second!r} in the MCAP record '
                f'{METADATA_RECORD}: correct one{_overrule(key)}')
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
    return TestMetadata(test, elevation, values.get('rig', ''), values.get('run', ''), details,
                      tuple(conflicts), tuple(faults))


def _overrule(key: str) -> str:
    options = {'test': 'test=KIND', 'elevation_deg': 'elevation_deg=DEG'}
    return f', or give {options[key]}' if key in options else ''


def _clean(value: object) -> str | None:
    return None if value is None or not str(value).strip() else str(value).strip()


def _kind(text: str | None, faults: list[str]) -> str | None:
    if text is None:
        return None
    if text.lower() in KINDS:
        return text.lower()
    faults.append(
        f"test is {text!r}, which is not a kind of test: give test='static' or test='dynamic'")
    return None


def _elevation(text: str | None, faults: list[str]) -> float | None:
    if text is None:
        return None
    value = finite_number(text)
    if value is not None and LOWEST_ELEVATION <= value <= HIGHEST_ELEVATION:
        return value
    faults.append(
        f'elevation_deg is {text!r}, which is not an elevation from {LOWEST_ELEVATION:g} to '
        f'{HIGHEST_ELEVATION:g} degrees: give elevation_deg=DEG')
    return None
