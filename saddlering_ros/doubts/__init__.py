"""What is doubtful in a record, on its rig, beside other records, or in a driver; in words."""

FAULT, NOTE = 'fault', 'note'
"""Severities: to be mended before a test; to be read before a result is trusted."""


class Finding(str):
    """A line on what is doubtful, with the remedy, and data behind it.

    where: the topic, '' for the record as a whole; units: those that its readings look like, ''.
    """

    def __new__(cls, words: str, where: str = '', *_: str, units: str = '') -> 'Finding':
        return super().__new__(cls, f'{where}: {words}' if where else words)

    def __init__(self, words: str, where: str = '', severity: str = NOTE, *, units: str = '',
                 ) -> None:
        self.words, self.where, self.severity, self.units = words, where, severity, units
