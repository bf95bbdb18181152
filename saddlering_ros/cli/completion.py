"""`saddlering completion`: what a shell needs to complete commands, options and effects."""

from __future__ import annotations

import argparse
from typing import Any

SHELLS = ('bash', 'zsh', 'fish', 'tcsh')


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'completion', help='completion of commands, options and effects for your shell',
        description='Print what the shell has to evaluate so that the tab key completes commands, '
                    'options, kinds of test and effects.')
    parser.add_argument('shell', choices=SHELLS, help='the shell you type in')


def run(args: argparse.Namespace) -> int:
    """Print it."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(['saddlering'], shell=args.shell))
    return 0
