"""A proposed law in terms of the rig: its JSON, and an effect file for the user's folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
import yaml

from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import describe, LawProposal, Term, wording
from saddlering_ros.files import write_text
from saddlering_ros.quantities import quantity, WIDTH_95

TABLE_POINTS = 1025
"""Points of the table of a simple law, which resolve a hundredth of the range."""

TURN = 0.01
"""Smallest return of the load that changes its direction, as a share of full scale."""

REACH = 3.0
"""Range of sizes in a fit of the effect file, in sizes of the proposed law."""

CHANNELS = {f'd{probe}': f'eddy_current_{probe}' for probe in (1, 2, 3, 4)}
UNITS = {'gamma': 'rad', 'hydraulic_load': 'N'}
ALONG = {'load': 'N', 'direction': 'N', 'rate': 'N/s', 'time': 's'}
REMEMBERED = {discrepancy.PLAY: ('reach', 'N', discrepancy.HYSTERESIS),
              discrepancy.MEMORY: ('lag', 's', discrepancy.MEMORY)}
"""What weights of a law stand at that remembers the load, its unit, and their coordinate in a
file."""


def proposal_document(law: LawProposal | None, files: tuple[str, ...]) -> dict[str, Any] | None:
    """The JSON of docs/diagnosis.md; `files` hold the effects."""
    if law is None:
        return None
    terms = []
    for term in law.terms:
        channel = CHANNELS.get(term.target, term.target)
        over, at_unit, _ = REMEMBERED.get(term.memory) or (
            term.coordinate, ALONG.get(term.coordinate, '1'), '')
        unit, along = UNITS.get(channel, 'm'), 'N' if term.memory else at_unit
        units = {'target': unit, 'coordinate': along, 'target per coordinate': f'{unit}/{along}'}
        terms.append({
            'channel': channel, 'coordinate': term.coordinate, 'law': term.law,
            'formula': term.words,
            'parameters': {
                name: {
                    'value': size.value, 'std': size.std, 'unit': units.get(size.unit, size.unit),
                    'interval_95': [size.value + side * WIDTH_95 * size.std for side in (-1, 1)]}
                for name, size in term.parameters.items()},
            'curve': {
                'over': over, 'at': term.at.tolist(), 'at_unit': at_unit,
                'values': term.values.tolist(), 'std': term.band.tolist(),
                'unit': units['target per coordinate'] if over == 'lag' else unit}})
    return {
        **terms[0], 'gain': {'fit': law.fit, 'held_out': law.held_out}, 'share': law.share,
        'p_value': law.p_value, 'doubts': list(law.doubts),
        'effect_file': files[0] if files else None, 'effect_files': list(files), 'terms': terms}


def effect_paths(law: LawProposal, folder: Path) -> dict[Path, Term]:
    """Each term, by the path of its file."""
    return {folder / f'{_effect_id(term)}.yaml': term for term in law.terms}


def _effect_id(term: Term) -> str:
    return f'proposed_{CHANNELS.get(term.target, term.target)}_{term.coordinate}'


def write_effect_files(law: LawProposal, folder: Path, full_scale_load: float) -> list[Path]:
    """One effect file per term."""
    paths = effect_paths(law, folder)
    for path, term in paths.items():
        coordinate, at, values = _table(term)
        size = float(np.abs(values).max()) or 1.0
        channel = CHANNELS.get(term.target, term.target)
        document = {
            'id': _effect_id(term),
            'title': f'Proposed: {term.law} in {term.coordinate}, added to {channel}',
            'words': describe(term),
            'settled_by': 'A run at another rate and elevation: the law must hold there without a '
                          'change.',
            'target': channel,
            'coordinate': coordinate,
            'unit': UNITS.get(channel, 'm'),
            'turn': TURN * full_scale_load,
            'size': {'low': -REACH * size, 'high': REACH * size, 'scale': size, 'start': size},
            'table': {
                'at': [float(f'{value:.9g}') for value in at],
                'values': [float(f'{value / size:.6g}') for value in values]}}
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, yaml.safe_dump(
            document, sort_keys=False, default_flow_style=None, width=98))
    return list(paths)


def _table(term: Term) -> tuple[str, NDArray[np.float64], NDArray[np.float64]]:
    """Coordinate of the effect file, and the law over it."""
    if term.memory:
        used = term.values != 0.0
        return REMEMBERED[term.memory][2], term.at[used], term.values[used]
    if term.form is None:
        return term.coordinate, term.at, term.values
    at = np.linspace(term.at[0], term.at[-1], TABLE_POINTS)
    along = dict.fromkeys(('load', 'rate', 'time', term.coordinate), at)
    along['direction'] = np.ones(at.size)
    return term.coordinate, at, term.evaluate(along)


def proposal_lines(law: Mapping[str, Any] | None) -> list[str]:
    """The proposed law, its misfit reduction, and its doubts."""
    if not law:
        return []
    lines = ['', 'A law that would explain the misfit (a proposal; the verdict stays unknown):']
    for term in law['terms']:
        lines.append(f'  {term["channel"]} += {term["law"]} in {term["coordinate"]}: '
                     f'{term["formula"]}')
        lines += [
            f'    {name} {quantity(size["value"], size["unit"], size["std"])}'
            for name, size in term['parameters'].items()]
    gain = law['gain']
    lines.append(f'  misfit reduction {wording.gain_words(gain["fit"], gain["held_out"])}')
    lines += [f'  doubt: {doubt}' for doubt in law['doubts']]
    return [*lines, *(f'  effect file: {path}' for path in law['effect_files'])]
