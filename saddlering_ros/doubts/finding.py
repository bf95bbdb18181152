"""A finding: what is doubtful and what to do about it, where, and by which limit it was judged."""

from __future__ import annotations

from dataclasses import dataclass

FAULT, NOTE = 'fault', 'note'
"""Severities: to be mended before a test; to be read before a result is trusted."""


@dataclass(frozen=True)
class Finding:
    """One finding.

    id: of its kind; words: what is doubtful, with the remedy; where: the topic, '' for the record
    as a whole; threshold: limit that the record exceeds, in the unit that its kind states, None
    if no number decides.
    """

    id: str
    words: str
    where: str = ''
    threshold: float | None = None
    severity: str = NOTE

    def __str__(self) -> str:
        return f'{self.where}: {self.words}' if self.where else self.words


@dataclass(frozen=True)
class Kind:
    """A kind of finding: the one place of its words, with figures in braces, and of its limit."""

    id: str
    words: str
    threshold: float | None = None
    severity: str = NOTE

    def at(self, where: str = '', /, **figures: object) -> Finding:
        """The finding of this kind with its figures."""
        return Finding(self.id, self.words.format(**figures), where, self.threshold, self.severity)

    @property
    def limit(self) -> float:
        """The threshold of a kind that a number decides."""
        assert self.threshold is not None
        return self.threshold
