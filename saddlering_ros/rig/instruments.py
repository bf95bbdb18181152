"""Standard uncertainties (k = 1) of instruments and dimensions, as certificates state them.

Of a digital calibration certificate (DCC) the few elements of PTB's schema (https://ptb.de/dcc,
versions 2 and 3; D-SI 1 and 2) that are needed are read by the standard library: pydcc, the
library for DCC, had its last release in July 2024, calls itself alpha, and needs seven packages,
one of them for the network. A document type, by which entities are declared, is refused before
anything is expanded.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
import json
import math
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from saddlering_ros.errors import refuse_unknown_keys
from saddlering_ros.plain_yaml import is_number
from saddlering_ros.rig.parameter_file import RigError

FOUR_PROBES = 'probe_gain'
"""The entry that may be one number or four, one for each probe."""


@dataclass(frozen=True)
class Instruments:
    """Standard uncertainties; None where no certificate states one."""

    load_gain: float | None = None  # share
    load_offset: float | None = None  # [N]
    load_nonlinearity: float | None = None  # share of full scale
    elevation: float | None = None  # [rad]
    probe_gain: tuple[float, float, float, float] | None = None  # share, of each probe
    probe_nonlinearity: float | None = None  # [1/m]
    probe_lag: float | None = None  # [s]
    clock: float | None = None  # [s], between load and probes
    clearance: float | None = None  # [m] of each row
    weight: float | None = None  # share
    trunnion: float | None = None  # [m]
    axial_span: float | None = None  # [m]
    radial_height: float | None = None  # [m]

    @property
    def not_stated(self) -> tuple[str, ...]:
        """Names of the entries that no certificate states."""
        return tuple(one.name for one in fields(self) if getattr(self, one.name) is None)


NAMES = tuple(one.name for one in fields(Instruments))

UNITS = {'load_offset': 'N', 'elevation': 'rad', 'probe_nonlinearity': '1/m', 'probe_lag': 's',
         'clock': 's', 'clearance': 'm', 'trunnion': 'm', 'axial_span': 'm', 'radial_height': 'm'}
"""SI units of the entries; the others are shares."""


def instruments_from(values: Any, where: str) -> Instruments:
    """Instruments from the section of a rig file; RigError (one line) for an entry of no use.

    An entry {certificate: FILE.xml, quantity: NAME} is read from a DCC beside the rig file.
    """
    if not isinstance(values, dict):
        raise RigError(f'{where}: rig.instruments is not a section: give it as "instruments:" '
                       'with entries')
    refuse_unknown_keys({key: value for key, value in values.items() if key not in NAMES}, NAMES,
                        'rig.instruments', where, RigError)
    stated: dict[str, Any] = {}
    for name, value in values.items():
        entry = f'{where}: rig.instruments.{name}'
        numbers = [_certified(one, UNITS.get(name, '1'), Path(where).parent, entry)
                   if isinstance(one, dict) else one
                   for one in (value if isinstance(value, list) else [value])]
        count = 4 if name == FOUR_PROBES and isinstance(value, list) else 1
        usable = len(numbers) == count and all(
            is_number(one) and 0.0 < one < 1e9 for one in numbers)
        if not usable:
            also = ' or four of them' if name == FOUR_PROBES else ''
            raise RigError(f'{where}: rig.instruments.{name} is {value!r}: give a standard '
                           f'uncertainty above zero{also} (SI units, k = 1)')
        stated[name] = (tuple(map(float, numbers)) * (4 // count) if name == FOUR_PROBES
                        else float(numbers[0]))
    return Instruments(**stated)


def stated_by(texts: Iterable[str], where: str) -> tuple[Instruments, str]:
    """Instruments that bags state, the larger uncertainty of each, and names of certificates."""
    stated: dict[str, Any] = {}
    certificates: set[str] = set()
    for text in filter(None, texts):
        try:
            values = json.loads(text)
            certificates.update(values.pop('certificates', []))
        except (ValueError, AttributeError, TypeError) as problem:
            raise RigError(f'{where}: instruments of the metadata is {text[:40]!r}: give it as '
                           'saddlering import writes it') from problem
        for name, value in asdict(instruments_from(values, where)).items():
            if value is not None:
                larger = np.maximum(stated.get(name, value), value).tolist()
                stated[name] = tuple(larger) if name == FOUR_PROBES else larger
    return Instruments(**stated), ', '.join(sorted(certificates))


def difference_of(first: Instruments, second: Instruments) -> Instruments:
    """Standard uncertainty of the difference of two calibrations, where both are stated."""
    both = {name: np.hypot(getattr(first, name), getattr(second, name)).tolist() for name in NAMES
            if None not in (getattr(first, name), getattr(second, name))}
    return Instruments(**both)


MAX_CERTIFICATE = 32 << 20
"""Size of the largest certificate that is read [bytes]: some hold a scanned document."""

PREFIXES = {'': 1.0, 'nano': 1e-9, 'micro': 1e-6, 'milli': 1e-3, 'centi': 1e-2, 'kilo': 1e3,
            'mega': 1e6}
SI_UNITS = {'metre': ('m', 1.0), 'newton': ('N', 1.0), 'second': ('s', 1.0),
            'radian': ('rad', 1.0), 'degree': ('rad', math.pi / 180.0), 'one': ('1', 1.0),
            'percent': ('1', 1e-2)}
"""Names of D-SI units (https://ptb.de/si) with the SI unit and the factor to it."""

UNIT = re.compile(rf'\\(?:({"|".join(filter(None, PREFIXES))})\\)?({"|".join(SI_UNITS)})')


def _certified(entry: dict[str, Any], unit: str, folder: Path, where: str) -> float:
    """Standard uncertainty of an entry {certificate: FILE.xml, quantity: NAME}, in `unit`.

    quantity: its refType, id or name; unit '1': as a share. Of a list the largest counts.
    """
    if set(entry) != {'certificate', 'quantity'} or not all(
            isinstance(value, str) for value in entry.values()):
        raise RigError(f'{where} is {entry!r}: give {{certificate: FILE.xml, quantity: NAME}}')
    path, quantity = folder / entry['certificate'], entry['quantity']
    quantities = [(one, _names(one)) for one in _document(path, where).iter('quantity')]
    matches = [one for one, names in quantities if quantity in names]
    if len(matches) != 1:
        choices = sorted({name for _, names in quantities for name in names})
        raise RigError(f'{where}: {path} has {len(matches)} quantities called {quantity!r}: give '
                       f'one of {", ".join(choices[:12]) or "none"}')
    spreads = [spread for real in matches[0].iter() if real.tag in ('real', 'realListXMLList')
               for spread in _spreads(real, unit, f'{where}: {path}: {quantity}')]
    if not spreads or not 0.0 < max(spreads) < math.inf:
        raise RigError(f'{where}: {path}: {quantity} states no uncertainty above zero: give '
                       'another quantity, or a number')
    return max(spreads)


def _document(path: Path, where: str) -> ElementTree.Element:
    """The root of a certificate, the tags without their name spaces."""
    def refuse(*_: Any) -> None:
        raise RigError(f'{where}: {path} declares a document type, which no DCC has: ask the '
                       'laboratory for the certificate')

    try:
        if not path.is_file() or path.stat().st_size > MAX_CERTIFICATE:
            raise RigError(f'{where}: {path} is no certificate (a regular file of at most 32 MB): '
                           'check the path')
        data = path.read_bytes()
        parser = expat.ParserCreate()
        parser.StartDoctypeDeclHandler = refuse
        parser.Parse(data, True)
        root = ElementTree.fromstring(data)
    except (OSError, expat.ExpatError, ElementTree.ParseError) as problem:
        raise RigError(f'{where}: {path} cannot be read as XML ({problem}): check the certificate'
                       ) from problem
    for element in root.iter():
        element.tag = element.tag.rpartition('}')[2]
    return root


def _names(quantity: ElementTree.Element) -> set[str]:
    """Words by which a quantity can be chosen."""
    named = [(content.text or '').strip() for content in quantity.iterfind('name//content')]
    return {*(quantity.get('refType') or '').split(), quantity.get('id') or '', *named} - {''}


def _spreads(real: ElementTree.Element, unit: str, where: str) -> list[float]:
    """Standard uncertainties of one real or list of reals."""
    def texts(*names: str) -> list[str]:
        wanted = {*names, *(f'{name}XMLList' for name in names)}
        return [word for element in real.iter() if element.tag in wanted
                for word in (element.text or '').split()]

    def numbers(*names: str) -> list[float]:
        try:
            return list(map(float, texts(*names)))
        except ValueError as problem:
            raise RigError(f'{where} has an entry that is no number ({problem}): check the '
                           'certificate') from problem

    values, expanded = numbers('value'), numbers('uncertainty', 'valueExpandedMU')
    spreads = numbers('valueStandardMU', 'standardUncertainty')
    if expanded:
        factors = numbers('coverageFactor') or [math.nan]
        factors = factors * len(expanded) if len(factors) == 1 else factors
        spreads = [one / factor for one, factor in zip(expanded, factors, strict=False)]
    # Units of other quantities than lengths, forces, times and angles serve for shares only.
    symbol, factor = next(iter(texts('unit')), 'no unit'), 1.0
    match = UNIT.fullmatch(symbol)
    if match is not None:
        symbol, factor = SI_UNITS[match[2]]
        factor *= PREFIXES[match[1] or '']
    if unit == '1' and symbol != '1':
        return [spread / abs(value) for spread, value in zip(spreads, values, strict=False)
                if value]
    if symbol != unit:
        raise RigError(f'{where} is in {symbol}, and {unit} is needed: give another quantity')
    return [factor * spread for spread in spreads]
