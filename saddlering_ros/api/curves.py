"""Curves of a test as arrays, table and figure: measured, simulated, and the difference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.api import inputs
from saddlering_ros.api.inputs import Bag, BagLike, ParametersLike, RigLike
from saddlering_ros.bags.samples import displacement_columns, write_samples
from saddlering_ros.files import bag_folder, Provenance, spare_bags
from saddlering_ros.progress import check, IsCancelled, OnProgress, Progress
from saddlering_ros.record.batches import join
from saddlering_ros.record.displacement import measured_stretches
from saddlering_ros.record.residual import residual_stretches, simulated_stretches
from saddlering_ros.rig import CHANNELS, MICRO_UNITS

if TYPE_CHECKING:
    from saddlering_ros.api.results import Plot

Array = NDArray[np.float64]

MAX_DRAWN = 4000
"""Largest number of samples of a curve that a figure shows."""


@dataclass(frozen=True, repr=False)
class Curves(inputs.Tabular):
    """The displacement of the ring in one test, sample by sample, as the live nodes give it.

    kind: 'measured', 'simulated' or 'measured minus simulated'; stamp_ns (N,) [ns]; time (N,) [s]
    since the first load of the record; load (N,) [N]; delta_x, delta_y, parity (N,) [m] and gamma
    (N,) [rad], NaN where not known; validity (N,): 0 where all four are known from sound readings;
    notes: what should make a reader doubt the curves.
    """

    bag: Bag
    kind: str
    stamp_ns: NDArray[np.int64]
    time: Array
    load: Array
    delta_x: Array
    delta_y: Array
    gamma: Array
    parity: Array
    validity: NDArray[np.uint8]
    notes: tuple[str, ...]
    provenance: Provenance

    def __len__(self) -> int:
        return len(self.time)

    def summary(self) -> str:
        """The test, the number of samples, and the extent of each channel."""
        lines = [f'{self.bag.name}: {self.kind} at {len(self)} load stamps']
        for name in CHANNELS:
            values = 1e6 * np.asarray(getattr(self, name))
            if np.isfinite(values).any():
                lines.append(f'  {name}: {np.nanmin(values):.2f} to {np.nanmax(values):.2f} '
                             f'{MICRO_UNITS[name]}')
        return '\n'.join([*lines, *(f'note: {note}' for note in self.notes)])

    def columns(self) -> dict[str, NDArray[Any]]:
        """The arrays by name, as the commands write them."""
        return {name: getattr(self, name)
                for name in ('stamp_ns', 'time', 'load', *CHANNELS, 'validity')}

    def save(self, path: Path | str) -> None:
        """Write the table; the suffix selects .csv or .parquet."""
        self._spare_bag(Path(path))
        write_samples(Path(path), [self.columns()], self.provenance)

    def plot(self) -> Plot:
        """delta_x, delta_y and gamma over time."""
        from saddlering_ros.api.results import Plot
        from saddlering_ros.report.figures import over_time

        kept = slice(None, None, max(1, len(self) // MAX_DRAWN))
        channels = {name: np.asarray(getattr(self, name))[kept] for name in CHANNELS[:3]}
        title = f'{self.bag.name}: {self.kind}'
        return Plot(over_time(self.time[kept], channels, title), self._spare_bag)

    def _spare_bag(self, output: Path) -> None:
        spare_bags(output, str(output), [(bag_folder(self.bag.path), str(self.bag.path))])


def displacement(
    bag: BagLike, *, rig: RigLike = None, trust_rig: bool = False,
    on_progress: OnProgress | None = None, is_cancelled: IsCancelled | None = None,
) -> Curves:
    """The measured displacement of the ring in a test.

    The arguments are those of `identify`, for one bag.
    """
    return _curves('measured', measured_stretches, bag, None, rig, trust_rig, on_progress,
                   is_cancelled)


def simulate(
    bag: BagLike, *, parameters: ParametersLike, rig: RigLike = None, trust_rig: bool = False,
    on_progress: OnProgress | None = None, is_cancelled: IsCancelled | None = None,
) -> Curves:
    """The displacement that the model has under the load of a test.

    parameters: a `ParameterSet`, a parameter file, or the result of `identify` or `diagnose`.
    """
    return _curves('simulated', simulated_stretches, bag, parameters, rig, trust_rig,
                   on_progress, is_cancelled)


def residual(
    bag: BagLike, *, parameters: ParametersLike, rig: RigLike = None, trust_rig: bool = False,
    on_progress: OnProgress | None = None, is_cancelled: IsCancelled | None = None,
) -> Curves:
    """Measured minus simulated displacement of a test; the arguments are those of `simulate`."""
    return _curves('measured minus simulated', residual_stretches, bag, parameters, rig,
                   trust_rig, on_progress, is_cancelled)


def _curves(
    kind: str, stretches_of: Callable[..., Any], bag: BagLike, parameters: ParametersLike | None,
    rig: RigLike, trust_rig: bool, on_progress: OnProgress | None,
    is_cancelled: IsCancelled | None,
) -> Curves:
    given = inputs.inputs_of([bag], rig=rig, trust_rig=trust_rig, parameters=parameters,
                             on_progress=on_progress, is_cancelled=is_cancelled)
    of, model = given.bags[0], [] if given.parameters is None else [given.parameters]
    task, notes = 'simulate' if model else 'displacement', list[str]()

    def share_is_done(share: float) -> None:
        check(is_cancelled, task)
        if on_progress is not None:
            on_progress(Progress(task, of.name, share))

    stretches, _ = stretches_of(given.rig, of.run, *model, notes, share_is_done)
    columns = displacement_columns(of.run, join(list(stretches)))
    return Curves(of, kind, **columns, notes=(*of.run.notes, *notes),
                  provenance=Provenance((of.run.origin,), given.files))
