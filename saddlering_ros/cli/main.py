"""The `saddlering` command itself: finds the subcommands, runs one, turns errors into statuses.

Exit status: 0 done; 2 unusable arguments or input; 1 a failure of our own; 130 interrupted.
With each status but 0, stderr gets one line with fault and place.
"""

import argparse
from collections.abc import Callable, Sequence
import errno
import importlib
import io
import os
import pkgutil
import shlex
import signal
import sys
import tempfile
import time
from types import FrameType, ModuleType
from typing import Any

from saddlering_ros import __version__, cli
from saddlering_ros.cli import _arguments as arguments
from saddlering_ros.errors import printable, SaddleringError, UNUSABLE

OUR_FAILURE = 1
INTERRUPTED, READER_GONE = 128 + signal.SIGINT, 128 + signal.SIGPIPE

Run = Callable[[argparse.Namespace], int]

UNUSABLE_FILE = frozenset({
    errno.ENOENT, errno.EACCES, errno.EPERM, errno.EISDIR, errno.ENOTDIR, errno.EEXIST,
    errno.EROFS, errno.ENAMETOOLONG, errno.ELOOP})
"""Operating system errors that mean the user named a file that cannot be used."""

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT})
"""Errors of a full disk, where no file is named: of standard output, or of a scratch file."""

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
RETRY = 0.01
"""Seconds after which a signal that came at a bad moment is taken up again."""

CALLED_BACK = frozenset({'_numba_unpickle', 'typeof_pyval', '_raw_object_cache_notify',
                         '_raw_object_cache_getbuffer', '__del__'})
ENDS_OF_OBJECTS = frozenset({('weakref', 'remove'), ('_weakrefset', '_remove')})
"""Functions, the latter with their modules, that compiled code calls: those of numba and of LLVM,
and those that end an object, in which Python drops an exception."""

LONGEST_CLOSING = 5.0
"""A signal that is repeated within this time [s] waits: what is open is being closed."""

SHOWN = ('demo', 'info', 'identify', 'diagnose', 'live')
"""Commands whose first example stands in the help of saddlering itself."""


def subcommand_modules() -> list[ModuleType]:
    """Return the modules of this folder that define subcommands, by name."""
    names = sorted(module.name for module in pkgutil.iter_modules(cli.__path__))
    return [importlib.import_module(f'{cli.__name__}.{name}') for name in names
            if name != 'main' and not name.startswith('_')]


def build_parser() -> tuple[arguments.OneLineParser, dict[str, tuple[arguments.Command, Run]]]:
    """Return the parser, and each subcommand by its name with the function that runs it."""
    parser = arguments.OneLineParser(
        prog='saddlering',
        description='Test rig, simulator and diagnosis of a saddle ring.')
    parser.add_argument('--version', action=_Version, help='show the version and exit')
    arguments.TRACEBACK(parser)
    subparsers = parser.add_subparsers(dest='command', metavar='COMMAND', required=True)
    commands: dict[str, tuple[arguments.Command, Run]] = {}
    for module in subcommand_modules():
        for command in module.COMMANDS:
            of_command = subparsers.add_parser(
                command.name, help=command.words, description=command.description,
                epilog=arguments.examples_text(command.examples))
            for add in (*command.options, arguments.TRACEBACK):
                add(of_command)
            of_command.set_defaults(arguments=of_command._actions)
            commands[command.name] = command, module.run
    parser.epilog = arguments.examples_text([
        commands[name][0].examples[0] for name in SHOWN if name in commands])
    return parser, commands


def run_reporting(run: Run, args: argparse.Namespace) -> int:
    """Run something; print an error as one line; return the exit status."""
    try:
        status = run(args)
        sys.stdout.flush()
        return status
    except SaddleringError as error:
        return _complain(str(error), UNUSABLE, args)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        _drop_output()
        return READER_GONE
    except ModuleNotFoundError as error:
        return _complain(
            f'Python package {error.name} is not installed here; docs/install.md lists the '
            'requirements', OUR_FAILURE, args)
    except Exception as error:
        if (isinstance(error, OSError) and error.filename is not None
                and error.errno in UNUSABLE_FILE):
            return _complain(f'{error.filename}: {error.strerror}', UNUSABLE, args)
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            try:
                sys.stdout.flush()
            except OSError:
                _drop_output()
            return _complain(
                f'{error.strerror}: standard output or the folder of scratch files, '
                f'{tempfile.gettempdir()}, is full: choose another place', UNUSABLE, args)
        hint = '' if args.traceback else ' (--traceback shows the place)'
        return _complain(f'failed: {type(error).__name__}: {error}{hint}', OUR_FAILURE, args)


def _drop_output() -> None:
    """Let the flush of Python at exit not report again that standard output takes nothing."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_any_text() -> None:
    """Let both streams print every text: what their encoding lacks is printed as a code of it.

    Python does so for standard error only. Every locale of today is UTF-8 (Python takes C and
    POSIX for it too), so that signs in ASCII would be a translation for nobody.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')


def main(argv: Sequence[str] | None = None) -> int:
    """Run `saddlering` with `argv` (default: the process's own); return the exit status."""
    # A process started with a closed standard stream (`>&-`) gets the null device in its place: a
    # file opened later would take the stream's number and receive the printed text.
    for number, name, mode in ((0, 'stdin', 'r'), (1, 'stdout', 'w'), (2, 'stderr', 'w')):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
            setattr(sys, name, os.fdopen(number, mode))
    print_any_text()
    given = argparse.Namespace(command='', traceback=False, signals=leave_by_exception())

    def parse_and_run(args: argparse.Namespace) -> int:
        parser, commands = build_parser()
        if '_ARGCOMPLETE' in os.environ:  # the shell asks for completions of this line
            import argcomplete

            argcomplete.autocomplete(parser)
        parser.parse_args(argv, args)
        words = sys.argv[1:] if argv is None else argv
        args.command_line = shlex.join(['saddlering', *map(str, words)])
        # A command without --rig takes the rig file of the project, named on standard error.
        if getattr(args, 'rig', '') is None and os.environ.get('SADDLERING_RIG'):
            from saddlering_ros.rig import load_rig, short_digest
            from saddlering_ros.rig.description import rig_file_of_project

            args.rig = rig_file_of_project()
            print(f'saddlering {args.command}: rig: {args.rig} (SADDLERING_RIG), hash '
                  f'{short_digest(load_rig(args.rig).digest)}', file=sys.stderr)
        arguments.check_ranges(args)
        arguments.check_files(args)
        return commands[args.command][1](args)

    return run_reporting(parse_and_run, given)


def leave_by_exception() -> list[int]:
    """End the process by an exception, so that everything open is closed, and children end.

    Compiled code calls back into Python (to rebuild an object, to find an argument's type, at the
    end of an object) and does not check whether that raised: an exception there ends in a
    segmentation fault, or is lost. There the signal is put off by some milliseconds. The list gets
    the signals that came: an import of compiled code turns the exception of one into its own.
    """
    came: list[int] = []

    def leave(number: int, frame: FrameType | None) -> None:
        inner = frame
        while inner is not None:  # whether compiled code waits for one of the frames to return
            name = inner.f_code.co_name
            if name in CALLED_BACK or (inner.f_globals.get('__name__'), name) in ENDS_OF_OBJECTS:
                signal.signal(signal.SIGALRM, lambda _, later: leave(number, later))
                signal.setitimer(signal.ITIMER_REAL, RETRY)
                return
            inner = inner.f_back
        began = time.monotonic()

        def again(number: int, frame: FrameType | None) -> None:
            if time.monotonic() - began > LONGEST_CLOSING:
                leave(number, frame)

        for one in ENDING:
            if signal.getsignal(one) is leave:
                signal.signal(one, again)
        came.append(number)
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + number)

    for number in ENDING[1:]:
        signal.signal(number, leave)
    if signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL):
        signal.signal(signal.SIGINT, leave)
    return came


class _Version(argparse.Action):
    """Prints the version; the hash of the code is taken only then."""

    def __init__(self, option_strings: Sequence[str], dest: str, **options: Any) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, **options)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from saddlering_ros.files import code_hash

        print(f'saddlering {__version__} (code {code_hash()})', flush=True)
        parser.exit()


def _complain(message: str, status: int, args: argparse.Namespace) -> int:
    if args.signals and status == OUR_FAILURE:
        return 128 + int(args.signals[0])
    if args.traceback:
        import traceback
        traceback.print_exc()
    line = ' '.join(arguments.in_options(message).split())
    print(f'saddlering {args.command}'.rstrip() + f': {printable(line)}', file=sys.stderr)
    return status


if __name__ == '__main__':
    sys.exit(main())
