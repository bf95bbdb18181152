"""The `saddlering` command: a module for each subcommand, found by walking this folder.

Commands that do the same to other curves share one. A subcommand's module has COMMANDS and
`run(args) -> int`, imports nothing heavy before `run`, and raises SaddleringError for each error
that its user can correct. The type of an argument declares the role of a path
(`_arguments.Role`) and the range of a number (`Within`).
"""

import signal
import sys

if ((sys.argv[0].endswith('saddlering') or f'{__name__}.main' in sys.orig_argv)
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler):
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # while it imports, nothing is open
