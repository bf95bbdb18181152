"""The standard uncertainty of a quantity in a digital calibration certificate (DCC).

The few elements of PTB's schema (https://ptb.de/dcc, versions 2 and 3; D-SI 1 and 2) that are
needed are read by the standard library: pydcc, the library for DCC, had its last release in July
2024, calls itself alpha, and needs seven packages, one of them for the network. A document type,
by which entities are declared, is refused before anything is expanded.
"""

from __future__ import annotations

from collections.abc import Iterable
import math
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

from saddlering_ros.rig.ros_yaml import RigError

MAX_CERTIFICATE = 32 << 20
"""Size of the largest certificate that is read [bytes]: some hold a scanned document."""

PREFIXES = {'': 1.0, 'nano': 1e-9, 'micro': 1e-6, 'milli': 1e-3, 'centi': 1e-2, 'kilo': 1e3,
            'mega': 1e6}
UNITS = {'metre': ('m', 1.0), 'newton': ('N', 1.0), 'second': ('s', 1.0), 'radian': ('rad', 1.0),
         'degree': ('rad', math.pi / 180.0), 'one': ('1', 1.0), 'percent': ('1', 1e-2)}
"""Names of D-SI units (https://ptb.de/si) with the SI unit and the factor to it."""

UNIT = re.compile(rf'\\(?:({"|".join(filter(None, PREFIXES))})\\)?({"|".join(UNITS)})')


def certified(path: Path, quantity: str, unit: str, where: str) -> float:
    """Standard uncertainty of a quantity in a certificate, in `unit`; as a share for '1'.

    quantity: its refType, id or name. Of a list the largest counts. RigError (one line) if the
    certificate cannot be used.
    """
    root = _document(path, where)
    found = [item for item in root.iter() if _local(item) == 'quantity'
             and quantity in _names(item)]
    if len(found) != 1:
        known = sorted({name for item in root.iter() if _local(item) == 'quantity'
                        for name in _names(item)})
        raise RigError(f'{where}: {path} has {len(found)} quantities called {quantity!r}: give '
                       f'one of {", ".join(known[:12]) or "none"}')
    spreads = [spread for real in found[0].iter() if _local(real) in ('real', 'realListXMLList')
               for spread in _spreads(real, unit, f'{where}: {path}: {quantity}')]
    if not spreads or not 0.0 < max(spreads) < math.inf:
        raise RigError(f'{where}: {path}: {quantity} states no uncertainty above zero: give '
                       'another quantity, or a number')
    return max(spreads)


def _document(path: Path, where: str) -> ElementTree.Element:
    try:
        if not path.is_file() or path.stat().st_size > MAX_CERTIFICATE:
            raise RigError(f'{where}: {path} is no certificate (a regular file of at most 32 MB): '
                           'check the path')
        data = path.read_bytes()
        parser = expat.ParserCreate()
        parser.StartDoctypeDeclHandler = lambda *_: _refuse(path, where)
        parser.Parse(data, True)
        return ElementTree.fromstring(data)
    except (OSError, expat.ExpatError, ElementTree.ParseError) as problem:
        raise RigError(f'{where}: {path} cannot be read as XML ({problem}): check the certificate'
                       ) from problem


def _refuse(path: Path, where: str) -> None:
    raise RigError(f'{where}: {path} declares a document type, which no DCC has: ask the '
                   'laboratory for the certificate')


def _local(item: ElementTree.Element) -> str:
    return item.tag.rpartition('}')[2]


def _names(quantity: ElementTree.Element) -> set[str]:
    """Words by which a quantity can be chosen."""
    named = [content.text or '' for child in quantity if _local(child) == 'name'
             for content in child.iter() if _local(content) == 'content']
    return {*(quantity.get('refType') or '').split(), quantity.get('id') or '',
            *map(str.strip, named)} - {''}


def _spreads(real: ElementTree.Element, unit: str, where: str) -> list[float]:
    """Standard uncertainties of one real or list of reals."""
    def numbers(*names: str) -> list[float]:
        try:
            return [float(text) for text in _texts(real, names)]
        except ValueError as problem:
            raise RigError(f'{where} has an entry that is no number ({problem}): check the '
                           'certificate') from problem

    values, expanded = numbers('value'), numbers('uncertainty', 'valueExpandedMU')
    spreads = numbers('valueStandardMU', 'standardUncertainty')
    if expanded:
        factors = numbers('coverageFactor') or [math.nan]
        factors = factors * len(expanded) if len(factors) == 1 else factors
        spreads = [one / factor for one, factor in zip(expanded, factors, strict=False)]
    symbol, factor = _unit(next(iter(_texts(real, ('unit',))), ''), where)
    if unit == '1' and symbol != '1':
        return [spread / abs(value) for spread, value in zip(spreads, values, strict=False)
                if value]
    if symbol != unit:
        raise RigError(f'{where} is in {symbol}, and {unit} is needed: give another quantity')
    return [factor * spread for spread in spreads]


def _texts(real: ElementTree.Element, names: Iterable[str]) -> list[str]:
    wanted = {*names, *(f'{name}XMLList' for name in names)}
    return [word for item in real.iter() if _local(item) in wanted
            for word in (item.text or '').split()]


def _unit(text: str, where: str) -> tuple[str, float]:
    """SI unit and factor of a D-SI unit; units of other quantities serve for shares only."""
    found = UNIT.fullmatch(text)
    if found is None:
        return text or 'no unit', 1.0
    symbol, factor = UNITS[found[2]]
    return symbol, factor * PREFIXES[found[1] or '']


def from_certificate(entry: dict[str, Any], unit: str, folder: Path, where: str) -> float:
    """Standard uncertainty of an entry {certificate: FILE.xml, quantity: NAME} of a rig file."""
    if set(entry) != {'certificate', 'quantity'} or not all(
            isinstance(value, str) for value in entry.values()):
        raise RigError(f'{where} is {entry!r}: give {{certificate: FILE.xml, quantity: NAME}}')
    return certified(folder / entry['certificate'], entry['quantity'], unit, where)
