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
    """A kind of finding: the one place of its words and of its limit."""

    words: str  # with figures in braces
    limit: float = 0.0  # that the record exceeds, in the unit stated beside it

    def at(self, where: str = '', /, **figures: object) -> Finding:
        """Return the finding of this kind with its figures."""
        return Finding(self.words.format(**figures), where)
