"""Arguments of the commands: roles of paths and their guard, shared options, what they name."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
import contextlib
from dataclasses import dataclass
import os
from pathlib import Path
import re
from typing import Any, NoReturn, TYPE_CHECKING

from saddlering_ros.cli._terminal import Bar
from saddlering_ros.errors import did_you_mean, plain_number, SaddleringError, whole_number
from saddlering_ros.files import (
    BAG_FILES,
    bag_folder,
    check_ending,
    FileConflict,
    PAGE_ENDINGS,
    resolved,
    same_file,
    spare_bags,
    spare_files,
)

if TYPE_CHECKING:
    from saddlering_ros import Bag, Rig
    from saddlering_ros.record import Record
    from saddlering_ros.rig import ParameterSet

UNUSABLE = 2
MAX_DOMAIN = 232
"""The ports of a higher domain do not exist (DDS wire protocol, 9.6.1)."""

_CHOICE = re.compile(r"argument (\S+): invalid choice: '(.*?)' \(choose from (.*)\)", re.S)


class OneLineParser(argparse.ArgumentParser):
    """An argument parser whose error is one line, with the nearest valid word."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault('formatter_class', HelpFormatter)
        super().__init__(*args, **kwargs)
        self.register('type', float, plain_number)
        self.register('type', int, whole_number)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; an unknown option is refused with the most similar one."""
        parsed, unknown = self.parse_known_args(args, namespace)
        if unknown:
            commands = [action.choices for action in self._actions
                        if isinstance(action, argparse._SubParsersAction)]
            parser = commands[0][parsed.command] if commands else self
            parser.error(f'unknown: {" ".join(unknown)}'
                         + did_you_mean(unknown[0].partition('=')[0], parser.options()))
        return parsed

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """The value of an argument; argparse makes an empty list of `--name=--`."""
        if arg_strings == ['--'] and action.option_strings:
            raise argparse.ArgumentError(action, "invalid value: '--'")
        return super()._get_values(action, arg_strings)

    def options(self) -> list[str]:
        """The long options of this parser."""
        return [text for action in self._actions for text in action.option_strings
                if text.startswith('--')]

    def path_arguments(self) -> list[argparse.Action]:
        """The arguments that name files or folders, by their type."""
        return [action for action in self._actions if isinstance(action.type, Role)]

    def error(self, message: str) -> NoReturn:
        """Print the error and how to get help; exit with status 2."""
        choice = _CHOICE.fullmatch(message)
        if choice is not None:
            given = re.findall(r"[^\s',]+", choice[3])
            message = (f'{choice[1]}: there is no {choice[2]!r}{did_you_mean(choice[2], given)} '
                       f'({", ".join(given)})')
        self.exit(UNUSABLE, f'{self.prog}: {" ".join(message.split())}; see {self.prog} --help\n')


class HelpFormatter(argparse.HelpFormatter):
    """Wraps descriptions, leaves examples as they are written."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith('examples:'):
            return ''.join(indent + line for line in text.splitlines(keepends=True))
        return super()._fill_text(text, width, indent)


def examples_text(examples: Sequence[tuple[str, str]]) -> str:
    """Examples of a command, each with its meaning, as its help shows them."""
    if not examples:
        return ''
    return 'examples:\n' + '\n'.join(f'  # {words}\n  {line}' for line, words in examples)


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
"""A file, or a bag, that is written as a whole."""

page_written = Role(is_written=True)
"""A page (HTML)."""

text_written = Role(str, is_written=True)
"""A file; '-' is standard output."""

folder_filled = Role(is_written=True)
"""A folder for files; the files that it holds already stay."""


@dataclass(frozen=True)
class _Named:
    """A path, the argument that named it, and its role."""

    path: Path
    words: str
    role: Role


def check_files(args: argparse.Namespace, arguments: Sequence[argparse.Action]) -> None:
    """FileConflict if an output is an input, lies in a bag that is read, or is given twice.

    arguments: those of the command that name paths.
    """
    named = [path for action in arguments for path in _named(args, action)]
    outputs = [path for path in named if path.role.is_written]
    files = [path for path in named if not (path.role.is_written or path.role.is_bag)]
    bags = [bag for path in named if path.role.is_bag for bag in _bags(path)]
    files_and_words = [*((file.path, file.words) for file in files), *_effects_of_environment()]
    for number, output in enumerate(outputs):
        for other in outputs[:number]:
            if same_file(output.path, other.path):
                raise FileConflict(f'{output.words} and {other.words} are the same file: choose '
                                   'two files')
        spare_files(output.path, output.words, files_and_words)
        spare_bags(output.path, output.words, [(bag.path, bag.words) for bag in bags])
        if output.role is not folder_filled:
            for source in [*files, *bags]:
                if any(same_file(folder, output.path) for folder in resolved(source.path).parents):
                    raise FileConflict(f'{output.words} is the folder that holds {source.words}, '
                                       'which is read: choose another place')
        if output.role is page_written:
            check_ending(output.path, PAGE_ENDINGS, FileConflict)


def _effects_of_environment() -> Iterator[tuple[Path, str]]:
    """The effect files of the folder that the environment names."""
    if os.environ.get('SADDLERING_EFFECTS'):
        from saddlering_ros.effects import own_files

        yield from ((file, f'{file} (SADDLERING_EFFECTS)') for file in own_files())


def _named(args: argparse.Namespace, action: argparse.Action) -> Iterator[_Named]:
    """Each path of an argument; '-' and devices are no files to lose."""
    value = getattr(args, action.dest, None)
    given = value if isinstance(value, list) else [value]
    # An option that may be given several times has a list of each time.
    for text in (one for item in given for one in (item if isinstance(item, list) else [item])):
        if text is None or str(text) == '-':
            continue
        path = Path(text)
        with contextlib.suppress(OSError):  # such as of a name that is too long
            if path.exists() and not (path.is_file() or path.is_dir()):
                continue
        option = ''.join(f'{name} ' for name in action.option_strings[-1:])
        role: Any = action.type
        if role is effects_read and path.is_dir():
            yield from (_Named(file, f'{option}{file}', role) for file in path.glob('*.yaml'))
        yield _Named(path, f'{option}{text}', role)


def _bags(named: _Named) -> Iterator[_Named]:
    """The bags of a path: the folder that it is, or those below it, or the file."""
    if named.role is bags_below:
        yield from (_Named(file.parent, str(file.parent), named.role)
                    for file in sorted(named.path.rglob(BAG_FILES[0])))
    else:
        yield _Named(bag_folder(named.path), named.words, named.role)


# -- options that several commands share ---------------------------------------------------------

def add_rig_option(
    parser: argparse.ArgumentParser,
    words: str = 'rig file (default: that of SADDLERING_RIG, or the shipped rig)',
) -> None:
    """The rig file."""
    parser.add_argument('--rig', type=file_read, help=words)


def add_json_option(
    parser: argparse.ArgumentParser, words: str = 'write a summary as JSON; - for stdout',
) -> None:
    """The place of the figures as JSON; words: say that - stands for standard output."""
    parser.add_argument('--json', type=text_written, metavar='FILE', help=words)


def add_bags_options(parser: argparse.ArgumentParser, words: str) -> None:
    """Several bags, and the options for reading them; words: what the command does with them."""
    parser.add_argument('bags', type=bag_read, nargs='+', metavar='BAG', help=words)
    add_reading_options(parser)


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    """The rig of the bags, and their metadata."""
    add_rig_option(parser)
    add_trust_option(parser)
    add_fact_options(parser)


def add_fact_options(parser: argparse.ArgumentParser) -> None:
    """Options that replace the test metadata of the bag."""
    parser.add_argument('--test', choices=('static', 'dynamic'),
                        help='kind of test, in place of that of the bag')
    parser.add_argument('--elevation', type=float, metavar='DEG',
                        help='elevation, in place of that of the bag')


def add_report_option(parser: argparse.ArgumentParser) -> None:
    """The place of a report."""
    parser.add_argument('--report', type=page_written, metavar='FILE.html', help='write a report')


def add_trust_option(parser: argparse.ArgumentParser) -> None:
    """The option to continue although a bag or the parameters state another rig."""
    parser.add_argument('--trust-rig', action='store_true',
                        help='accept a bag or parameters that state another rig than --rig')


def add_parameter_options(parser: argparse.ArgumentParser) -> None:
    """The parameter file of a simulation, and the folder of the user's own effects in it."""
    parser.add_argument('--params', type=file_read, required=True, metavar='FILE',
                        help='parameter file of an identification or diagnosis')
    add_effects_option(parser)


def add_effects_option(parser: argparse.ArgumentParser) -> None:
    """The folder of the user's own effects."""
    parser.add_argument('--effects', type=effects_read, metavar='DIR',
                        help='folder of your own effects, one YAML file each')


def add_network_options(parser: argparse.ArgumentParser) -> None:
    """The ROS domain and the namespace of the rig."""
    parser.add_argument('--domain', type=int, help='ROS domain (default: ROS_DOMAIN_ID, or 0)')
    parser.add_argument('--namespace', default='', metavar='NS',
                        help='namespace of the rig, so that several rigs share a domain '
                             '(default: the root)')


def domain_of(args: argparse.Namespace) -> int:
    """The ROS domain of --domain, of the environment, or 0."""
    text = os.environ.get('ROS_DOMAIN_ID') or '0' if args.domain is None else str(args.domain)
    if not (text.isascii() and text.isdecimal()) or int(text) > MAX_DOMAIN:
        name = 'ROS_DOMAIN_ID' if args.domain is None else '--domain'
        raise SaddleringError(f'{name} is {text!r}: give a ROS domain from 0 to {MAX_DOMAIN}')
    return int(text)


def in_options(message: str) -> str:
    """A message of the Python API with the options of the command line for its arguments."""
    for argument, option in (('trust_rig=True', '--trust-rig'), ('overwrite=True', '--overwrite'),
                             ('elevation_deg=', 'elevation=')):
        message = message.replace(argument, option)
    return re.sub(r"\b(rig|test|elevation)=('?)(\w+)\2", r'--\1 \3', message)


def radians(degrees: float | None) -> float | None:
    """Degrees as typed, in radians."""
    import math

    return None if degrees is None else math.radians(degrees)


# -- what the options name -----------------------------------------------------------------------

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
    """The test of one bag of a command, with a bar of how much was read.

    BagError if the bag states another rig, unless --trust-rig.
    """
    from saddlering_ros.bags import read_run
    from saddlering_ros.doubts.comparison import refuse_other_rig

    with Bar() as bar:
        run = read_run(bag, test=args.test, elevation=radians(args.elevation), rig=rig,
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
