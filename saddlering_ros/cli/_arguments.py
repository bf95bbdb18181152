"""What commands share: arguments, roles of paths and their guard, and what a command prints."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
import contextlib
from dataclasses import dataclass
from functools import partial
import json
import math
import os
from pathlib import Path
import re
import sys
from typing import Any, NoReturn, TYPE_CHECKING

from saddlering_ros import errors, files
from saddlering_ros.errors import did_you_mean, plain_number, SaddleringError
from saddlering_ros.files import FileConflict

if TYPE_CHECKING:
    from rich.console import Console

    from saddlering_ros import Bag, Rig
    from saddlering_ros.progress import Progress
    from saddlering_ros.record.record import Record
    from saddlering_ros.rig import ParameterSet

_CHOICE = re.compile(r"argument (\S+): invalid choice: '(.*?)' \(choose from (.*)\)", re.S)


class OneLineParser(argparse.ArgumentParser):
    """An argument parser whose error is one line, with the nearest valid word."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault('formatter_class', HelpFormatter)
        super().__init__(*args, **kwargs)
        self.register('type', float, plain_number)
        self.register('type', int, partial(plain_number, kind=int))

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; an unknown option is refused with the most similar one."""
        parsed, unknown = self.parse_known_args(args, namespace)
        if unknown:
            commands = [action.choices for action in self._actions
                        if isinstance(action, argparse._SubParsersAction)]
            parser = commands[0][parsed.command] if commands else self
            options = [text for action in parser._actions for text in action.option_strings]
            taken = [action.dest for action in parser._actions if not action.option_strings]
            if len(taken) == 1 and not any(text.startswith('-') for text in unknown):
                parser.error(f'takes one {taken[0]}, not {" ".join(unknown)} too: run it for '
                             'each')
            parser.error(f'unknown: {" ".join(unknown)}'
                         + did_you_mean(unknown[0].partition('=')[0], options))
        return parsed

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """The value of an argument; argparse makes an empty list of `--name=--`."""
        if arg_strings == ['--'] and action.option_strings:
            raise argparse.ArgumentError(action, "invalid value: '--'")
        return super()._get_values(action, arg_strings)

    def print_help(self, file: Any = None) -> None:
        """Print the help; argparse drops the error of a full disk."""
        print(self.format_help(), end='', file=file, flush=True)

    def error(self, message: str) -> NoReturn:
        """Print the error and how to get help; exit with status 2."""
        choice = _CHOICE.fullmatch(message)
        if choice is not None:
            given = re.findall(r"[^\s',]+", choice[3])
            message = (f'{choice[1]}: there is no {choice[2]!r}{did_you_mean(choice[2], given)} '
                       f'({", ".join(given)})')
        line = f'{self.prog}: {" ".join(message.split())}; see {self.prog} --help\n'
        self.exit(errors.UNUSABLE, line)


class HelpFormatter(argparse.HelpFormatter):
    """Wraps descriptions, leaves examples as they are written."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith('examples:'):
            return ''.join(indent + line for line in text.splitlines(keepends=True))
        return super()._fill_text(text, width, indent)


# -- what a command declares ---------------------------------------------------------------------

AddOption = Callable[[argparse.ArgumentParser], argparse.Action]


def option(name: str, words: str, **settings: Any) -> AddOption:
    """An argument of a command with its words in the help; settings: those of argparse."""
    return lambda parser: parser.add_argument(name, help=words, **settings)


@dataclass(frozen=True)
class Command:
    """A subcommand: name, line of the list, description, arguments, examples with meaning."""

    name: str
    words: str
    description: str
    options: tuple[AddOption, ...]
    examples: tuple[tuple[str, str], ...]


def examples_text(examples: Sequence[tuple[str, str]]) -> str:
    """Examples of a command, each with its meaning, as its help shows them."""
    return 'examples:\n' + '\n'.join(f'  # {words}\n  {line}' for line, words in examples)


class Within:
    """Type of an argument that is a number from low to high."""

    def __init__(self, kind: type[int] | type[float], low: float, high: float = math.inf,
                 unit: str = '') -> None:
        self.low, self.high, self.unit, self.kind = low, high, unit, kind
        self.__name__ = kind.__name__  # of a message of argparse

    def __call__(self, text: str) -> float:
        return plain_number(text, self.kind)


def check_ranges(args: argparse.Namespace) -> None:
    """SaddleringError if a number is not in the range that its argument declares."""
    for action in getattr(args, 'arguments', ()):
        kind, value = action.type, getattr(args, action.dest, None)
        if isinstance(kind, Within) and value is not None and not kind.low <= value <= kind.high:
            ends = (f'{kind.low:g} or more' if math.isinf(kind.high) else
                    f'{kind.low:g} to {kind.high:g}')
            raise SaddleringError(f'{action.option_strings[-1]} is {value:g}: give {ends}'
                                  f'{kind.unit}')


# -- roles of paths: the type of an argument declares what the command does with its path --------

@dataclass(frozen=True, eq=False)
class Role:
    """Type of an argument that names a path: what the command does with it.

    kind: of the value; is_bag: it is, or holds, bags; is_written: it is written, else read.
    """

    kind: type[Path] | type[str] = Path
    is_bag: bool = False
    is_written: bool = False

    def __call__(self, text: str) -> Path | str:
        return self.kind(text)


bag_read = Role(str, is_bag=True)
bags_below = Role(is_bag=True)
"""A folder with bags below it."""

file_read = Role()
effects_read = Role()
"""A folder of effect files."""

file_written = Role(is_written=True)
bag_written = Role(is_bag=True, is_written=True)
page_written = Role(is_written=True)
text_written = Role(str, is_written=True)
"""A file; '-' is standard output."""

folder_filled = Role(is_written=True)
"""A folder for files; the files that it holds already stay."""


def check_files(args: argparse.Namespace) -> None:
    """FileConflict if an output is an input, lies in a bag that is read, or is given twice."""
    named = [one for action in getattr(args, 'arguments', ()) if isinstance(action.type, Role)
             for one in _named(args, action)]
    outputs = [one for one in named if one[2].is_written]
    read = [(path, words) for path, words, role in named if not (role.is_written or role.is_bag)]
    bags = [(files.bag_folder(path), words) for path, words, role in named
            if role.is_bag and not role.is_written and role is not bags_below]
    bags += [(file.parent, str(file.parent)) for path, _, role in named if role is bags_below
             for file in sorted(path.rglob(files.BAG_FILES[0]))]
    sources = [*read, *bags]
    if os.environ.get('SADDLERING_EFFECTS'):
        from saddlering_ros.effects import own_files

        read += [(file, f'{file} (SADDLERING_EFFECTS)') for file in own_files()]
    for number, (output, its_words, its_role) in enumerate(outputs):
        for other, words, _ in outputs[:number]:
            if files.same_file(output, other):
                raise FileConflict(f'{its_words} and {words} are the same file: choose two files')
        files.spare_files(output, its_words, read)
        files.spare_bags(output, its_words, bags)
        place = files.resolved(output)
        if output.is_dir() and not (its_role.is_bag or its_role is folder_filled):
            raise FileConflict(f'{its_words}: is a directory: give the name of a file')
        files.check_writable(place if its_role is folder_filled else place.parent, its_words)
        for source, words in sources if its_role is not folder_filled else ():
            if any(files.same_file(folder, output) for folder in files.resolved(source).parents):
                raise FileConflict(f'{its_words} is the folder that holds {words}, which is '
                                   'read: choose another place')
        if its_role is page_written:
            files.check_ending(output, files.PAGE_ENDINGS, FileConflict)


def _named(args: argparse.Namespace, action: argparse.Action) -> Iterator[tuple[Path, str, Role]]:
    """Each path of an argument, the words that name it, and its role; '-' and devices are none."""
    value = getattr(args, action.dest, None)
    given = value if isinstance(value, list) else [value]
    # An option that may be given several times has a list of each time.
    for text in (one for part in given for one in (part if isinstance(part, list) else [part])):
        if text is None or str(text) == '-':
            continue
        path = Path(text)
        with contextlib.suppress(OSError):  # such as of a name that is too long
            if path.exists() and not (path.is_file() or path.is_dir()):
                continue
        option = ''.join(f'{name} ' for name in action.option_strings[-1:])
        role: Any = action.type
        if role is effects_read and path.is_dir():
            yield from ((file, f'{option}{file}', role) for file in path.glob('*.yaml'))
        yield path, f'{option}{text}', role


# -- options that several commands share ---------------------------------------------------------

RIG = option('--rig', 'rig file (default: that of SADDLERING_RIG, or the shipped rig)',
             type=file_read)
TRUST = option('--trust-rig', 'accept a bag or parameters that state another rig than --rig',
               action='store_true')
METADATA = (
    option('--test', 'kind of test, in place of that of the bag', choices=('static', 'dynamic')),
    option('--elevation', 'elevation, in place of that of the bag',
           type=Within(float, -10.0, 90.0), metavar='DEG'))
"""Options that replace the test metadata of the bag."""

READING = (RIG, TRUST, *METADATA)
"""The rig of the bags, and their metadata."""

EFFECTS = option('--effects', 'folder of your own effects, one YAML file each', type=effects_read,
                 metavar='DIR')
MODEL = (option('--params', 'parameter file of an identification or diagnosis', type=file_read,
                required=True, metavar='FILE'), EFFECTS)
"""The parameter file of a simulation, and the folder of the user's own effects in it."""

REPORT = option('--report', 'write a report', type=page_written, metavar='FILE.html')
NETWORK = (
    option('--domain', 'ROS domain (default: ROS_DOMAIN_ID, or 0)', type=int),
    option('--namespace', 'namespace of the rig, so that several rigs share a domain (default: '
           'the root)', default='', metavar='NS'))
"""The ROS domain and the namespace of the rig."""

TRACEBACK = option('--traceback', 'show the place in the code where an error occurred',
                   action='store_true', default=argparse.SUPPRESS)
OVERWRITE = option('--overwrite', 'replace an existing bag', action='store_true')


def json_option(words: str = 'write a summary as JSON; - for stdout') -> AddOption:
    """The place of the figures as JSON; words: say that - stands for standard output."""
    return option('--json', words, type=text_written, metavar='FILE')


def bags_option(words: str) -> AddOption:
    """Several bags; words: what the command does with them."""
    return option('bags', words, type=bag_read, nargs='+', metavar='BAG')


def domain_of(args: argparse.Namespace) -> int:
    """The ROS domain of --domain, of the environment, or 0."""
    from saddlering_ros.ros.launcher import domain_from

    if args.domain is not None:
        return domain_from(str(args.domain), '--domain')
    return domain_from(os.environ.get('ROS_DOMAIN_ID') or '0', 'ROS_DOMAIN_ID')


def in_options(message: str) -> str:
    """A message of the Python API with the options of the command line for its arguments."""
    for argument, option in (('trust_rig=True', '--trust-rig'), ('overwrite=True', '--overwrite'),
                             ('elevation_deg=', 'elevation=')):
        message = message.replace(argument, option)
    return re.sub(r"\b(rig|test|elevation)=('?)(\w+)\2", r'--\1 \3', message)


# -- what the options name -----------------------------------------------------------------------

def elevation_of(args: argparse.Namespace) -> float | None:
    """The elevation as typed in degrees, in radians."""
    return None if args.elevation is None else math.radians(args.elevation)


def take_effects(args: argparse.Namespace) -> None:
    """Take the user's own effects into the catalogue, if a folder is given."""
    from saddlering_ros.effects import use_folder

    if args.effects is not None:
        use_folder(args.effects)


def bags_of(args: argparse.Namespace, paths: Sequence[str], rig: Rig) -> list[Bag]:
    """The bags at these paths, read once, with the metadata of the options."""
    from saddlering_ros import read_bag

    with Bar() as bar:
        return [read_bag(path, rig=rig, test=args.test, elevation_deg=args.elevation,
                         on_progress=bar.tell)
                for path in paths]


def read_shown(args: argparse.Namespace, bag: str, rig: Rig) -> Record:
    """The test of one bag, with a bar; BagError if it states another rig, unless --trust-rig."""
    from saddlering_ros.bags.reader import read_run
    from saddlering_ros.doubts.comparison import refuse_other_rig

    with Bar() as bar:
        run = read_run(bag, test=args.test, elevation=elevation_of(args), rig=rig,
                       on_progress=bar.reading(bag))
    if not args.trust_rig:
        refuse_other_rig([run], rig)
    return run


def read_model(args: argparse.Namespace) -> tuple[Rig, ParameterSet]:
    """The rig and the parameters of a command; RigError if these belong to another rig."""
    from saddlering_ros.doubts.comparison import refuse_parameters_of_other_rig
    from saddlering_ros.rig import load_rig, read_parameters

    rig, parameters = load_rig(args.rig), read_parameters(args.params)
    if not args.trust_rig:
        refuse_parameters_of_other_rig(parameters, rig)
    return rig, parameters


PIPED_WIDTH = 160  # so that no row of a table is broken in a file


def stdout_console() -> Console:
    """The console on standard output: as wide as the terminal, or wide enough in a pipe."""
    from rich.console import Console

    class Plain(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError  # of the library: status 1, before a file is written

    if sys.stdout.isatty():
        return Plain(markup=False, highlight=False)
    return Plain(width=PIPED_WIDTH, markup=False, highlight=False, soft_wrap=True)


def show_table(titles: Sequence[str], rows: Iterable[Sequence[str]], *, texts: int = 1) -> None:
    """Print a table; the first `texts` columns hold words, the others numbers."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for place, title in enumerate(titles):
        table.add_column(title, justify='left' if place < texts else 'right', overflow='fold')
    for row in rows:
        table.add_row(*row)
    stdout_console().print(table)


def tell_json(args: argparse.Namespace, told: Any) -> bool:
    """Write `told` to the place of --json, if given; whether this is standard output."""
    if args.json is None:
        return False
    document = json.dumps(told, indent=2)
    if args.json == '-':
        print(document, flush=True)  # some commands run for hours
        return True
    files.write_text(args.json, document + '\n')
    return False


def finish(args: argparse.Namespace, result: Any) -> int:
    """Print a result as JSON or as summary, then write and list its files; the status.

    It is told first, so that it is not lost if a file cannot be written, and the files before
    that one are listed.
    """
    is_json_alone, reader_gone = args.json == '-', None
    written: list[Path] = []
    try:
        if is_json_alone:
            tell_json(args, result.to_json())
        else:
            print(result.summary(), flush=True)
    except BrokenPipeError as problem:  # as with `| head`: the files are wanted all the same
        reader_gone = problem
    if args.json is not None and not is_json_alone:
        tell_json(args, result.to_json())
    plots, out = (getattr(args, name, None) for name in ('plots', 'out'))
    try:
        if plots is not None:
            written += result.save_plots(plots)
        if out is not None:
            result.save_parameters(out)
            written.append(out)
        if args.report is not None:
            written += result.write_report(args.report, command=args.command_line)
    finally:
        for path in [] if is_json_alone or reader_gone is not None else written:
            print(f'written: {path}')
    if reader_gone is not None:
        raise reader_gone
    return 0


class Bar:
    """One line per stage on a terminal; no output elsewhere."""

    def __enter__(self) -> Bar:
        self._progress: Any = None
        self._tasks: dict[str, Any] = {}
        if sys.stderr.isatty():
            from rich import progress
            from rich.console import Console

            self._progress = progress.Progress(
                progress.TextColumn('{task.description}', markup=False), progress.BarColumn(),
                progress.TaskProgressColumn(), progress.TimeElapsedColumn(),
                progress.TextColumn('left'), progress.TimeRemainingColumn(),
                console=Console(stderr=True), transient=True)
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def tell(self, progress: Progress) -> None:
        """Show the progress of a computation; an identification gets a line for each stage."""
        if progress.task == 'identify':
            self.show(progress.stage, progress.share, progress.detail)
        else:
            self.show(progress.task, progress.share, progress.stage)

    def reading(self, path: Path | str) -> Callable[[float], None]:
        """Callback that shows the share of a bag that was read."""
        return lambda share: self.show(f'read {Path(path).name}', share)

    def show(self, task: str, share: float, words: str = '') -> None:
        """Show the share of a task that is done (0 to 1); `words` describe its present step."""
        if self._progress is None:
            return
        if task not in self._tasks:
            self._tasks[task] = self._progress.add_task(task, total=1.0)
        self._progress.update(self._tasks[task], completed=share,
                              description=f'{task}  {words}' if words else task)
