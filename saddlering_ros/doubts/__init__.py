"""What is doubtful in a record, on its rig, beside other records, or in a driver; in words."""

FAULT, NOTE = 'fault', 'note'
"""Severities: to be mended before a test; to be read before a result is trusted."""


class Finding(str):
    """A line on what is doubtful, with the remedy, and data behind it.

    where: the topic, '' for the record as a whole; units: those that its readings look like, '';
    is_cut: a file of the bag ends too early.
    """

    def __new__(cls, words: str, where: str = '', *_: str, **_data: object) -> 'Finding':
        return super().__new__(cls, f'{where}: {words}' if where else words)

    def __init__(self, words: str, where: str = '', severity: str = NOTE, *, units: str = '',
                 is_cut: bool = False) -> None:
        self.words, self.where, self.severity = words, where, severity
        self.units, self.is_cut = units, is_cut
