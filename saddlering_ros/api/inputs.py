"""Inputs of the API: bags that are read once, rigs and parameters as objects or files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import importlib
import math
import os
from pathlib import Path
from typing import Any, Protocol, TYPE_CHECKING

import numpy as np

from saddlering_ros.bags.reader import read_run
from saddlering_ros.bags.samples import displacement_columns
from saddlering_ros.doubts import comparison
from saddlering_ros.errors import SaddleringError
from saddlering_ros.files import Origin, origins_of
from saddlering_ros.progress import IsCancelled, OnProgress, Progress, Watch
from saddlering_ros.record import displacement as measured
from saddlering_ros.record.displacement import MeasuredRun
from saddlering_ros.record.record import condensed, fit_limit, Record
from saddlering_ros.record.scratch import extremes
from saddlering_ros.rig import load_rig, ParameterSet, read_parameters, Rig, short_digest

if TYPE_CHECKING:
    import pandas
    import polars


class ApiError(SaddleringError):
    """An argument that cannot be used, or a result that cannot be saved as asked."""


RigLike = Rig | Path | str | None
"""A rig, a rig file, or None for that of SADDLERING_RIG, or else for the shipped rig."""


class HasParameters(Protocol):
    """A result that found contact parameters."""

    @property
    def parameters(self) -> ParameterSet:
        """Contact law and effects."""


ParametersLike = ParameterSet | HasParameters | Path | str
"""Contact parameters: a `ParameterSet`, a parameter file, or a result that found some."""

Columns = Mapping[str, Any]
"""Lists or arrays of equal length by name."""


class Tabular(ABC):
    """What bags, curves and results share: a summary, and tables of columns."""

    @abstractmethod
    def summary(self) -> str:
        """The content in a few lines, as the command prints it."""

    @abstractmethod
    def columns(self) -> dict[str, Any]:
        """The main table as lists or arrays by column name (SI units)."""

    def __repr__(self) -> str:
        return f'<{type(self).__name__} {self._headline()}>'

    def _headline(self) -> str:
        return self.summary().splitlines()[0]

    def _repr_html_(self) -> str:
        from saddlering_ros.pages import html

        return html.commands(self.summary().splitlines())

    def _tables(self) -> dict[str, Callable[[], Columns]]:
        """Tables beside that of `columns`, by name."""
        return {}

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables beside that of `columns`."""
        return tuple(self._tables())

    def table(self, name: str = '') -> dict[str, Any]:
        """A table of `tables` as lists by column name (SI units); '': that of `columns`."""
        if not name:
            return self.columns()
        if name not in self.tables:
            raise ApiError(f'table {name!r} is not one of this result: give one of '
                           f'{", ".join(self.tables) or "none"}')
        return dict(self._tables()[name]())

    def to_dataframe(self, table: str = '') -> pandas.DataFrame:
        """A table as a pandas DataFrame (pandas is not installed by itself)."""
        return frame('pandas', self.table(table))

    def to_polars(self, table: str = '') -> polars.DataFrame:
        """A table as a polars DataFrame (polars is not installed by itself)."""
        return frame('polars', self.table(table))


def frame(library: str, columns: Columns) -> Any:
    """Columns as a DataFrame of a library; ApiError if the library is not installed."""
    try:
        return importlib.import_module(library).DataFrame(dict(columns))
    except ModuleNotFoundError as problem:
        raise ApiError(f'a DataFrame needs {library}: pip install {library}, or use columns(), '
                       'which gives the same as plain lists') from problem


def columns_of(rows: Sequence[Mapping[str, Any]],
               keys: Sequence[str] = ()) -> dict[str, list[Any]]:
    """Rows with the same keys as lists by key; keys: those of a table that may have no row."""
    return {key: [row[key] for row in rows] for key in keys or (rows[0] if rows else ())}


@dataclass(frozen=True, repr=False)
class Bag(Tabular):
    """A test of a bag, aligned at the stamps of the load; `read_bag` returns it.

    run: the arrays as read (gaps [m], load [N], stamps [ns], notes); rig: the rig of the test.
    """

    run: Record
    rig: Rig

    @property
    def name(self) -> str:
        """The name of the bag without its folder."""
        return self.run.name

    @property
    def path(self) -> Path:
        """The path of the bag."""
        return self.run.path

    @property
    def test(self) -> str:
        """'static' or 'dynamic'."""
        return self.run.test

    @property
    def elevation_deg(self) -> float:
        """Elevation of the barrel in degrees."""
        return round(math.degrees(self.run.elevation), 9)

    @property
    def notes(self) -> tuple[str, ...]:
        """Faults of the bag that do not prevent its use."""
        return tuple(self.run.notes)

    @cached_property
    def displacement(self) -> MeasuredRun:
        """Measured delta_x, delta_y, parity [m] and gamma [rad] at the load's stamps."""
        return measured.displacement_of_run(self.rig, self.run)

    def summary(self) -> str:
        """Test, elevation, length, load and notes in a few lines."""
        run = self.run
        lowest, highest = extremes(run.load)
        loads = self.rig.force_range(float(lowest), float(highest), 2)
        lines = [
            f'{self.name}: {self.test} test at {self.elevation_deg:g} deg, {len(run.time)} load '
            f'samples over {run.time[-1]:.1f} s, load {loads}']
        return '\n'.join([*lines, *(f'note: {note}' for note in self.notes)])

    def columns(self) -> dict[str, Any]:
        """Measured displacement as arrays by name: stamp_ns, time, load and the four channels."""
        zero = measured.zero_of_run(self.rig, self.run)
        rows = measured.measured_rows(self.rig, self.run, zero, slice(None))
        return displacement_columns(self.run, rows)


BagLike = Bag | Record | Path | str
"""A bag that was read, or the path of one."""


def read_bag(path: Path | str, *, rig: RigLike = None, test: str | None = None,
             elevation_deg: float | None = None, on_progress: OnProgress | None = None) -> Bag:
    """Read a bag once; pass the result on to `identify`, `validate` and `diagnose`.

    path: a rosbag2 directory or an .mcap file. rig: the rig of the recording, with which the
    wiring is checked. test ('static' or 'dynamic') and elevation_deg [degrees] replace the values
    of the bag. on_progress is called with the share that is read (task 'read'). Raises BagError,
    with one line, if the bag cannot be used.
    """
    check_path('path', path)
    check_calls(on_progress, None)
    in_use = as_rig(rig)
    if elevation_deg is not None:
        check_number('elevation_deg', elevation_deg)
    elevation = None if elevation_deg is None else math.radians(elevation_deg)
    report = on_progress or (lambda progress: None)
    name = Path(path).name
    run = read_run(path, test=test, elevation=elevation, rig=in_use,
                   on_progress=lambda share: report(Progress('read', name, share)))
    report(Progress('read', name, 1.0))
    return Bag(run, in_use)


@dataclass(frozen=True)
class Inputs:
    """Bags, rig and parameters of one call, which fit each other.

    parameters: None where not given; files: the files among the arguments and the user's effect
    files, with their hashes.
    """

    bags: list[Bag]
    held_out: list[Bag]
    rig: Rig
    parameters: ParameterSet | None
    files: tuple[Origin, ...]


def inputs_of(bags: BagLike | Iterable[BagLike], *, rig: RigLike = None, trust_rig: bool = False,
              hold_out: BagLike | Iterable[BagLike] = (),
              parameters: ParametersLike | None = None, on_progress: OnProgress | None = None,
              is_cancelled: IsCancelled | None = None,
              names: tuple[str, str] = ('bags', 'hold_out')) -> Inputs:
    """The inputs of a call; paths are read, one bag may stand without a list.

    Without `rig`, the rig is that with which the bags were read. Raises ApiError, BagError or
    RigError if a bag or the parameters belong to another rig, unless trust_rig. names: of the two
    arguments.
    """
    check_calls(on_progress, is_cancelled)
    given, held = _several(names[0], bags), _several(names[1], hold_out)
    in_use = rig_of([*given, *held], rig)
    law = None if parameters is None else as_parameters(parameters)

    def read(source: BagLike) -> Bag:
        if isinstance(source, Bag):
            return source
        if isinstance(source, Record):
            return Bag(source, in_use)
        Watch('read', is_cancelled=is_cancelled).check()
        return read_bag(source, rig=in_use, on_progress=on_progress)

    fitted, kept = list(map(read, given)), list(map(read, held))
    if not trust_rig:
        for bag in (*fitted, *kept):
            if bag.rig.digest != in_use.digest:
                raise ApiError(
                    f'{bag.name} was read with the rig with the hash '
                    f'{short_digest(bag.rig.digest)}, and rig has {short_digest(in_use.digest)}: '
                    'leave rig out, or give trust_rig=True to continue with it')
        comparison.refuse_other_rig(runs_of([*fitted, *kept]), in_use)
        if law is not None:
            comparison.refuse_parameters_of_other_rig(law, in_use)
    return Inputs(fitted, kept, in_use, law, origins(in_use.source or None, parameters))


def rig_of(bags: Sequence[BagLike], given: RigLike) -> Rig:
    """The given rig, or else that with which the bags were read, or else the default."""
    if given is not None:
        return as_rig(given)
    rigs = {bag.rig.digest: bag.rig for bag in bags if isinstance(bag, Bag)}
    if len(rigs) > 1:
        raise ApiError(f'the bags were read with different rigs (hashes '
                       f'{", ".join(map(short_digest, rigs))}): read all of them with one rig')
    return next(iter(rigs.values()), None) or as_rig(None)


def for_fits(bags: Sequence[Bag], held_out: Sequence[Bag] = ()) -> tuple[list[Bag], list[Bag]]:
    """The same bags, long ones as averages; BagError if a recording is among them twice."""
    comparison.refuse_repeats(runs_of(bags), runs_of(held_out))
    limit = fit_limit(runs_of([*bags, *held_out]))
    fitted, held = ([Bag(condensed(bag.run, bag.rig, limit), bag.rig) for bag in several]
                    for several in (bags, held_out))
    return fitted, held


def runs_of(bags: Sequence[Bag]) -> list[Record]:
    """The arrays of bags."""
    return [bag.run for bag in bags]


def as_rig(given: RigLike) -> Rig:
    """A rig as it is, a file as a rig, None as the default."""
    if isinstance(given, Rig):
        return given
    if given is not None:
        check_path('rig', given, ', a Rig or None')
    return load_rig(given)


def as_parameters(given: ParametersLike) -> ParameterSet:
    """Parameters as they are, from a file, or from the result that found them."""
    law = getattr(given, 'parameters', given)
    if isinstance(law, ParameterSet):
        return law
    if isinstance(law, (Path, str)):
        return read_parameters(law)
    raise no_parameters(given)


def no_parameters(given: object) -> ApiError:
    """The fault of an argument that holds no parameters."""
    return ApiError(f'parameters: {type(given).__name__} holds none: give a ParameterSet, a '
                    'parameter file or the result of identify or diagnose')


def origins(*given: object) -> tuple[Origin, ...]:
    """The files among the arguments and the user's effect files, with their hashes."""
    from saddlering_ros.effects import own_files

    return origins_of(*(file for file in given if isinstance(file, (Path, str))), *own_files())


def check_path(name: str, given: object, also: str = '') -> None:
    """ApiError unless an argument is a path; `also` names what else it may be."""
    if not isinstance(given, (str, os.PathLike)):
        raise ApiError(f'{name} is {_kind(given)}: give a path{also}')


def check_whole(name: str, given: object, low: float = -math.inf) -> None:
    """ApiError unless an argument is a whole number, at least `low`."""
    is_whole = isinstance(given, (int, np.integer)) and not isinstance(given, bool)
    if not is_whole or given < low:  # type: ignore[operator]
        raise ApiError(f'{name} is {given!r}: give a whole number'
                       + (f', {low:g} or above' if math.isfinite(low) else ''))


def check_number(name: str, given: object) -> None:
    """ApiError unless an argument is a finite number."""
    if not _is_number(given):
        raise ApiError(f'{name} is {given!r}: give a number')


def check_bounds(bounds: object) -> None:
    """ApiError unless bounds are pairs of numbers by the name of a parameter."""
    if not isinstance(bounds, Mapping):
        raise ApiError(f'bounds is {_kind(bounds)}: give {{name: (low, high)}}')
    for name, pair in bounds.items():
        if not (isinstance(pair, (tuple, list)) and len(pair) == 2 and all(map(_is_number, pair))):
            raise ApiError(f'bounds of {name} are {pair!r}: give (low, high) in SI units')


def check_calls(on_progress: OnProgress | None, is_cancelled: IsCancelled | None) -> None:
    """ApiError unless both can be called or are None."""
    for name, given in (('on_progress', on_progress), ('is_cancelled', is_cancelled)):
        if given is not None and not callable(given):
            raise ApiError(f'{name} is {_kind(given)}: give a function, or None')


def sessions_of(name: str, given: Any) -> list[list[BagLike]]:
    """The sessions of an argument; ApiError for one session in place of a list of them."""
    if isinstance(given, BagLike | Mapping) or not isinstance(given, Iterable):
        raise ApiError(f'{name} is {_kind(given)}: give a list of sessions, each a list of bags')
    return [_several(f'{name}[{place}]', session) for place, session in enumerate(given)]


def _several(name: str, given: Any) -> list[BagLike]:
    """The bags of an argument that is one of them or several."""
    if isinstance(given, BagLike):
        return [given]
    advice = 'give bags of read_bag or paths, one or a list of them'
    if isinstance(given, Mapping) or not isinstance(given, Iterable):
        raise ApiError(f'{name} is {_kind(given)}: {advice}')
    items = list(given)
    for place, bag in enumerate(items):
        if not isinstance(bag, BagLike):
            raise ApiError(f'{name}[{place}] is {_kind(bag)}: {advice}')
    return items


def _is_number(given: object) -> bool:
    return (isinstance(given, (int, float, np.integer, np.floating))
            and not isinstance(given, bool) and math.isfinite(given))


def _kind(given: object) -> str:
    return 'None' if given is None else f'of type {type(given).__name__}'
