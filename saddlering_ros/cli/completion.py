"""`saddlering completion`: completion of commands, options and effects in a shell."""

from __future__ import annotations

import argparse
from typing import Any

SHELLS = ('bash', 'zsh', 'fish', 'tcsh')


EXAMPLES = (
    ('eval "$(saddlering completion bash)"', 'in this shell; add it to ~/.bashrc to keep it'),
)
UNTRIED = 'changes the shell it is typed in'
"""Why no test types these examples."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'completion', help='complete commands and options by the tab key',
        description='Print a script for the shell, with which the tab key completes commands, '
                    'options, kinds of test and effects.')
    parser.add_argument('shell', choices=SHELLS, help='the shell in use')


def run(args: argparse.Namespace) -> int:
    """Print it."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(['saddlering'], shell=args.shell))
    return 0
