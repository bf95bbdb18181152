"""Parsers with one-line errors, suggestions for misspelt words, and examples in the help."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import re
from typing import Any, NoReturn

from saddlering_ros.cli._examples import EXAMPLES
from saddlering_ros.suggestion import did_you_mean

UNUSABLE = 2
_CHOICE = re.compile(r"argument (\S+): invalid choice: '(.*?)' \(choose from (.*)\)", re.S)


class OneLineParser(argparse.ArgumentParser):
    """An argument parser whose error is one line, with the nearest valid word."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault('formatter_class', HelpFormatter)
        super().__init__(*args, **kwargs)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; an unknown option is refused with the most similar one."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            parser = self._subparser(getattr(found, 'command', None))
            parser.error(f'unknown: {" ".join(unknown)}'
                         + did_you_mean(unknown[0].partition('=')[0], parser.options()))
        return found

    def options(self) -> list[str]:
        """The long options of this parser."""
        return [text for action in self._actions for text in action.option_strings
                if text.startswith('--')]

    def error(self, message: str) -> NoReturn:
        """Print the error and how to get help; exit with status 2."""
        choice = _CHOICE.fullmatch(message)
        if choice is not None:
            given = re.findall(r"[^\s',]+", choice[3])
            message = (f'{choice[1]}: there is no {choice[2]!r}{did_you_mean(choice[2], given)} '
                       f'({", ".join(given)})')
        self.exit(UNUSABLE, f'{self.prog}: {" ".join(message.split())}; see {self.prog} --help\n')

    def _subparser(self, command: str | None) -> OneLineParser:
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction) and command in action.choices:
                found: OneLineParser = action.choices[command]
                return found
        return self


class HelpFormatter(argparse.HelpFormatter):
    """Wraps descriptions, leaves examples as they are written."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith('examples:'):
            return ''.join(indent + line for line in text.splitlines(keepends=True))
        return super()._fill_text(text, width, indent)


def examples_text(command: str) -> str:
    """The examples of a command as its help shows them."""
    lines: Sequence[tuple[str, str]] = EXAMPLES.get(command, ())
    if not lines:
        return ''
    return 'examples:\n' + '\n'.join(f'  # {words}\n  {line}' for line, words in lines)
