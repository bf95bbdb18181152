"""Errors of instruments with a certificate as effects, and causes that lie beyond them."""

from __future__ import annotations

from collections.abc import Iterable

from saddlering_ros.discrepancy import Cause
from saddlering_ros.rig import Rig

CERTIFIED = {
    'load_gain': ('load_gain', 'gain'), 'load_offset': ('load_offset', 'offset'),
    'load_nonlinearity': ('load_nonlinearity', 'curvature'),
    'elevation': ('elevation_error', 'angle'), 'probe_lag': ('probe_lag', 'time'),
    'clock': ('clock_offset', 'offset'), 'trunnion': ('moment_arm', 'offset'),
    'radial_height': ('probe_height', 'height')}
"""Effect and parameter of an instrument's error, by the name in the rig file."""


def certified_errors(rig: Rig) -> list[dict[str, dict[str, float]]]:
    """One standard uncertainty of each stated instrument, as effects of the catalogue."""
    stated = rig.instruments
    errors = [{effect: {parameter: float(getattr(stated, name))}}
              for name, (effect, parameter) in CERTIFIED.items()
              if getattr(stated, name) is not None]
    for probe in rig.probes.present:
        if stated.probe_gain is not None:
            errors.append({'probe_gain': {
                'probe': float(probe), 'gain': stated.probe_gain[probe - 1]}})
        if stated.probe_nonlinearity is not None:
            errors.append({'probe_nonlinearity': {
                'probe': float(probe), 'curvature': stated.probe_nonlinearity}})
    return errors


def certificate_notes(rig: Rig, causes: Iterable[Cause]) -> list[str]:
    """For each cause on an instrument with a certificate, how far it lies beyond it."""
    uncertainties = {effect: (parameter, getattr(rig.instruments, name))
                     for name, (effect, parameter) in CERTIFIED.items()}
    gains = rig.instruments.probe_gain
    uncertainties['probe_gain'] = ('gain', None if gains is None else max(gains))
    uncertainties['probe_nonlinearity'] = ('curvature', rig.instruments.probe_nonlinearity)
    notes = []
    for cause in causes:
        parameter, uncertainty = uncertainties.get(cause.effect, ('', None))
        if uncertainty is not None and parameter in cause.parameters:
            times = abs(cause.parameters[parameter].value) / uncertainty
            notes.append(f'{cause.effect} is {times:.1f} times the standard uncertainty of its '
                         f'certificate ({uncertainty:g})')
    return notes


def assumed_notes(rig: Rig) -> list[str]:
    """What is assumed of instruments without a certificate, and how to state it."""
    missing = rig.instruments.not_stated
    return [] if not missing else [
        f'no certificate states {", ".join(missing)}: they count as exact in an identification, '
        'and a diagnosis may accuse them; give their standard uncertainties as rig.instruments']
