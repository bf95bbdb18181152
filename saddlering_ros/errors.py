"""Errors that the user can correct: numbers and names that were mistyped, texts of one line."""

from collections.abc import Collection, Iterable
import difflib
import re
from typing import Any

UNUSABLE = 2
"""Exit status of a command or node whose arguments or input cannot be used."""


class SaddleringError(ValueError):
    """An error that the user can correct; the message is one line: fault, place, remedy.

    Layers derive classes of their own from this one. The command line prints the message
    alone on stderr and exits with status 2; any other exception is a defect.
    """


class Cancelled(SaddleringError):
    """A computation was stopped by its caller; `partial` is the result so far, if there is one."""

    def __init__(self, message: str = 'cancelled', partial: object = None) -> None:
        super().__init__(message)
        self.partial = partial


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a computation of which a part is complete; `partial` is its result."""

    def __init__(self, partial: Any) -> None:
        super().__init__()
        self.partial = partial


class BagError(SaddleringError):
    """A bag cannot be used. The message is one line: fault, place, remedy."""

    def __init__(self, message: str) -> None:
        # Names from a damaged file may contain any characters.
        super().__init__(message.replace('\r', ' ').replace('\n', ' '))


class VirtualRigError(SaddleringError):
    """A test that cannot be generated as requested; one line: fault, place, remedy."""


class ReportError(SaddleringError):
    """A report that cannot be drawn or written."""


class LiveError(SaddleringError):
    """A page that cannot be served with these options."""


def counted(number: int, noun: str) -> str:
    """A number of things: '1 gap', '2 gaps'; both forms are given as 'stamp goes|stamps go'."""
    one, _, several = noun.partition('|')
    return f'{number} {one if number == 1 else several or one + "s"}'


def counted_name(number: int, name: str) -> str:
    """A counter by its name: '2 late loads', '1 leap of reading' of leaps_of_reading."""
    words = name.replace('_', ' ')
    return f'{number} ' + (re.sub('(leap|jump|load|duplicate)s', r'\1', words) if number == 1
                           else words)


def printable(text: str) -> str:
    """A text of a file for a terminal: characters that would control it are shown as codes."""
    return ''.join(sign if sign.isprintable() or sign in '\n\t' else repr(sign)[1:-1]
                   for sign in text)


def did_you_mean(word: str, known: Collection[str]) -> str:
    """': did you mean X?' for the known name most like `word`; '' if none is like it."""
    by_lower = {name.lower(): name for name in known}
    nearest = difflib.get_close_matches(word.lower(), by_lower, n=1, cutoff=0.6)
    return f': did you mean {by_lower[nearest[0]]}?' if nearest else ''


def refuse_unknown_keys(given: Iterable[object], known: Collection[str], section: str, where: str,
                        error: type[SaddleringError]) -> None:
    """Raise `error` if `given` holds a key that is not in `known`.

    section: dotted name of the section, '' at the top; where: the file, for the message.
    """
    unknown = [str(key) for key in given if key not in known]
    if not unknown:
        return
    inside = f'{section} has unknown entries' if section else 'has unknown entries'
    guess = did_you_mean(unknown[0], known)
    remedy = guess[2:] if guess else 'remove them or correct their spelling'
    listed = f' (known: {", ".join(sorted(known))})' if known and not guess else ''
    raise error(f'{where}: {inside} ({", ".join(sorted(unknown))}): {remedy}{listed}')


def plain_number(text: str, kind: type[float] = float) -> float:
    """The number (of a kind, float or int) in decimal digits; ValueError for anything else.

    Python also reads 1_0 as ten, and the digits of other scripts, which people write by mistake.
    """
    if '_' in text or not text.isascii():
        raise ValueError(f'{text!r} is no number in decimal digits')
    return kind(text)
