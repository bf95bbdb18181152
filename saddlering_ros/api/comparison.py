"""`compare` of the API: what changed in one ring between two sessions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from saddlering_ros.api import inputs
from saddlering_ros.api.inputs import BagLike, for_fits, inputs_of, RigLike
from saddlering_ros.api.results import Plot, Result
from saddlering_ros.comparison.change import Change, compare_records
from saddlering_ros.doubts.comparison import refuse_repeats
from saddlering_ros.progress import IsCancelled, OnProgress


@dataclass(frozen=True, repr=False)
class ComparisonResult(Result):
    """What changed between two sessions; `change` holds every figure."""

    change: Change

    @property
    def verdict(self) -> str:
        """'none', 'named', 'ambiguous' or 'unknown', of the change."""
        return self.change.verdict

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        return self.change.headline

    def summary(self) -> str:
        """Verdict, changes with their errors, contact law, figures of makers, notes."""
        from saddlering_ros.report.change import change_text

        return change_text(self.change)

    def columns(self) -> dict[str, list[Any]]:
        """One row per parameter of each cause: the change, its std, unit and p-value."""
        rows = [(cause.effect, name, item.value, item.std, item.unit, cause.p_value)
                for cause in self.change.diagnosis.causes
                for name, item in cause.parameters.items()]
        names = ('effect', 'parameter', 'change', 'std', 'unit', 'p_value')
        return {name: [row[place] for row in rows] for place, name in enumerate(names)}

    def plot(self) -> Plot:
        """The change of the later runs over the load."""
        from saddlering_ros.pages.charts import draw
        from saddlering_ros.report.change import change_chart

        return Plot(draw(change_chart(self.change)), self._spare_inputs)

    def _write_report(self, path: Path, command: str) -> tuple[Path, ...]:
        from saddlering_ros.report.change import write_change_page

        write_change_page(self.change, path, command)
        return (path,)

    def _document(self) -> dict[str, Any]:
        return self.change.to_json()


def compare(
    before: BagLike | Iterable[BagLike], after: BagLike | Iterable[BagLike], *,
    between: Sequence[Iterable[BagLike]] = (), rig: RigLike = None, seed: int = 0,
    trust_rig: bool = False,
    on_progress: OnProgress | None = None, is_cancelled: IsCancelled | None = None,
) -> ComparisonResult:
    """What changed in one ring from the bags of one session to those of a later one.

    What both sessions have (unequal rollers, waviness, errors of the rig file and of the
    simulator, gains of the instruments) is measured by the earlier session and cancels. The
    sessions may have different tests. between: sessions between the two, in order of time; the
    result then has the evidence of the whole series, which may be read after every session. The
    other arguments are those of `diagnose`.
    """
    inputs.check_whole('seed', seed, 0)
    given = inputs_of(before, hold_out=after, rig=rig, trust_rig=trust_rig,
                      on_progress=on_progress, is_cancelled=is_cancelled,
                      names=('before', 'after'))
    refuse_repeats(inputs.runs_of([*given.bags, *given.held_out]))
    earlier, later = for_fits(given.bags, given.held_out)
    others = [
        for_fits(inputs_of(bags, rig=given.rig, trust_rig=trust_rig, on_progress=on_progress,
                           is_cancelled=is_cancelled, names=('between', '')).bags)[0]
        for bags in between]
    change = compare_records(
        inputs.runs_of(earlier), inputs.runs_of(later), rig=given.rig,
        between=[inputs.runs_of(bags) for bags in others], seed=seed,
        on_progress=on_progress, is_cancelled=is_cancelled)
    used = [*earlier, *(bag for bags in others for bag in bags), *later]
    return ComparisonResult(tuple(used), given.rig, given.files, change)
