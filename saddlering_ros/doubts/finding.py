"""A finding: what is doubtful and what to do about it, and where."""

from dataclasses import dataclass

FAULT, NOTE = 'fault', 'note'
"""Severities: to be mended before a test; to be read before a result is trusted."""


@dataclass(frozen=True)
class Finding:
    """What is doubtful, with the remedy; where: the topic, '' for the record as a whole."""

    words: str
    where: str = ''
    severity: str = NOTE

    def __str__(self) -> str:
        return f'{self.where}: {self.words}' if self.where else self.words


@dataclass(frozen=True)
class Kind:
    """A kind of finding: the one place of its words, with figures in braces, and of its limit.

    limit: that the record exceeds, in the unit that is stated beside it.
    """

    words: str
    limit: float = 0.0

    def at(self, where: str = '', /, **figures: object) -> Finding:
        """The finding of this kind with its figures."""
        return Finding(self.words.format(**figures), where)
