"""What is doubtful in a record, on its rig, beside other records, or in a driver; in words."""

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
