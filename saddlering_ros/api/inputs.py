"""Inputs of the API: bags that are read once, rigs and parameters as objects or files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING

from saddlering_ros.api.arguments import check_calls, check_number, check_path, several
from saddlering_ros.api.errors import ApiError
from saddlering_ros.api.tables import dataframe
from saddlering_ros.bags import read_run, refuse_other_rig, refuse_repeats
from saddlering_ros.bags.samples import measured_samples
from saddlering_ros.files import Origin
from saddlering_ros.progress import check, IsCancelled, OnProgress, Progress
from saddlering_ros.record import condensed, displacement_of_run, fit_limit, MeasuredRun, Record
from saddlering_ros.record.scratch import extremes
from saddlering_ros.rig import (
    load_rig,
    ParameterSet,
    read_parameters,
    Rig,
    short_digest,
)

if TYPE_CHECKING:
    import pandas

RigLike = Rig | Path | str | None
"""A rig, a rig file, or None for the shipped rig."""

ParametersLike = Any
"""Contact parameters: a `ParameterSet`, a parameter file, or a result that found some."""


@dataclass(frozen=True)
class Bag:
    """A test of a bag, aligned at the stamps of the load; `read_bag` returns it.

    run: the arrays as read (gaps [m], load [N], stamps [ns], notes); rig: the rig of the test.
    """

    run: Record
    rig: Rig

    def __repr__(self) -> str:
        return f'<Bag {self.summary().splitlines()[0]}>'

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
        return displacement_of_run(self.rig, self.run)

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
        return measured_samples(self.displacement).columns()

    def to_dataframe(self) -> pandas.DataFrame:
        """The same as a pandas DataFrame, one row per sample."""
        return dataframe(self.columns())

    def _repr_html_(self) -> str:
        from saddlering_ros.pages import html

        return html.paragraph(self.summary())


BagLike = Bag | Record | Path | str
"""A bag that was read, or the path of one."""


def read_bag(
    path: Path | str, *, rig: RigLike = None, test: str | None = None,
    elevation_deg: float | None = None, on_progress: OnProgress | None = None,
) -> Bag:
    """Read a bag once; pass the result on to `identify`, `validate` and `diagnose`.

    path: a rosbag2 directory or an .mcap file. rig: the rig of the recording, with which the
    wiring is checked. test ('static' or 'dynamic') and elevation_deg [degrees] replace the values
    of the bag. on_progress is called with the share that is read (task 'read'). Raises BagError,
    with one line, if the bag cannot be used.
    """
    check_path('path', path)
    check_calls(on_progress, None)
    known = as_rig(rig)
    if elevation_deg is not None:
        check_number('elevation_deg', elevation_deg)
    elevation = None if elevation_deg is None else math.radians(elevation_deg)
    report = on_progress or (lambda progress: None)
    name = Path(path).name
    return Bag(read_run(path, test=test, elevation=elevation, rig=known,
                        on_progress=lambda share: report(Progress('read', name, share))), known)


def as_bags(
    given: BagLike | Iterable[BagLike], rig: Rig, on_progress: OnProgress | None = None,
    is_cancelled: IsCancelled | None = None, *, name: str = 'bags',
) -> list[Bag]:
    """Bags from bags or paths, one or several; paths are read. name: of the argument."""
    check_calls(on_progress, is_cancelled)
    return [_as_bag(item, rig, on_progress, is_cancelled)
            for item in several(name, given, (Bag, Record))]


def _as_bag(
    given: BagLike, rig: Rig, on_progress: OnProgress | None, is_cancelled: IsCancelled | None,
) -> Bag:
    """A bag that was read as it is, a path as a bag."""
    if isinstance(given, Bag):
        return given
    if isinstance(given, Record):
        return Bag(given, rig)
    check(is_cancelled, 'read')
    return read_bag(given, rig=rig, on_progress=on_progress)


def for_fits(bags: Sequence[Bag], held_out: Sequence[Bag] = ()) -> tuple[list[Bag], list[Bag]]:
    """The same bags, long ones as averages; BagError if a recording is among them twice."""
    refuse_repeats(runs_of(bags), runs_of(held_out))
    limit = fit_limit(runs_of([*bags, *held_out]))
    fitted, held = ([Bag(condensed(bag.run, bag.rig, limit), bag.rig) for bag in several]
                    for several in (bags, held_out))
    return fitted, held


def runs_of(bags: Sequence[Bag]) -> list[Record]:
    """The arrays of bags."""
    return [bag.run for bag in bags]


def check_rig(bags: Sequence[Bag], known: Rig, given: RigLike, trust_rig: bool) -> None:
    """Refuse bags that state another rig than the one in use, unless the user trusts it."""
    if not trust_rig:
        refuse_other_rig(runs_of(bags), known, is_given=given is not None)


def check_parameters(law: ParameterSet, known: Rig, trust_rig: bool) -> None:
    """Refuse parameters that were found on another rig, unless the user trusts the rig."""
    found = law.source.rig_hash
    if found and found != known.digest and not trust_rig:
        raise ApiError(
            f'the parameters belong to the rig with the hash {short_digest(found)}, and the rig '
            f'in use has {short_digest(known.digest)}: give the file of that rig with --rig, or '
            '--trust-rig to continue with this rig')


def as_rig(given: RigLike) -> Rig:
    """A rig as it is, a file as a rig, None as the shipped one."""
    if isinstance(given, Rig):
        return given
    if given is not None:
        check_path('rig', given, ', a Rig or None')
    return load_rig(given)


def as_parameters(given: ParametersLike) -> ParameterSet:
    """Parameters as they are, from a file, or from the result that found them."""
    found = getattr(given, 'parameters', given)
    if isinstance(found, ParameterSet):
        return found
    if isinstance(found, (Path, str)):
        return read_parameters(found)
    raise ApiError(f'parameters: {type(given).__name__} holds none: give a ParameterSet, a '
                   'parameter file or the result of identify or diagnose')


def origins(*given: object) -> tuple[Origin, ...]:
    """The files among the arguments and the user's effect files, with their hashes."""
    from saddlering_ros.effects import own_files
    from saddlering_ros.files import origins_of

    return origins_of(*(item for item in given if isinstance(item, (Path, str))), *own_files())
