"""ASCII in place of signs that a terminal or pipe cannot show, for streams that are not UTF-8."""

from __future__ import annotations

import codecs
import sys

from saddlering_ros.quantities import DIGITS, RAISED_DIGITS

HANDLER = 'saddlering.ascii'
ASCII = str.maketrans({
    '±': '+/-', '×': 'x', '·': '*', '−': '-', '–': '-', '—': '-', '…': '...', '→': '->',
    '≤': '<=', '≥': '>=', 'µ': 'u', 'μ': 'u', '°': ' deg', 'δ': 'delta_', 'γ': 'gamma',
    'Δ': 'delta ', '√': 'sqrt ', '²': '^2', '³': '^3',
})
SUPERSCRIPTS = str.maketrans(RAISED_DIGITS, DIGITS)


def use_ascii_where_needed() -> None:
    """Let standard output and error print ASCII if their encoding is not one of Unicode's."""
    codecs.register_error(HANDLER, _replaced)
    for stream in (sys.stdout, sys.stderr):
        encoding = getattr(stream, 'encoding', None) or ''
        if hasattr(stream, 'reconfigure') and not encoding.lower().startswith('utf'):
            stream.reconfigure(encoding='ascii', errors=HANDLER)


def _replaced(error: UnicodeError) -> tuple[str, int]:
    """The handler of Python's encoder: ASCII for a run of characters that are not."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return in_ascii(error.object[error.start:error.end]), error.end


def in_ascii(text: str) -> str:
    """'10⁷ µm ± 2' as '10^7 um +/- 2'; '?' for a character without a replacement."""
    parts, is_raised = [], False
    for character in text:
        raised = character.translate(SUPERSCRIPTS)
        if raised != character:
            parts.append(raised if is_raised else f'^{raised}')
        else:
            parts.append(character.translate(ASCII))
        is_raised = raised != character
    return ''.join(parts).encode('ascii', 'replace').decode('ascii')
