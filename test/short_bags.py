"""Bags of a virtual rig, short but whole: the five shipped tests, each in a few seconds."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from made_once import MadeOnce

from benchmarks import examiner
from benchmarks.examiner import draw_truth, DrawSettings, RecordSettings, RUNS, Truth

SHORT = RecordSettings(hold=2.0, static_rate=25.0, duration=8.0, dynamic_rate=500.0)


class ShortBags:
    """Calling it gives bags of one rig, side by side in a folder; each is written once for a run.
    """

    def __init__(self, made: MadeOnce) -> None:
        self._made = made

    def __call__(self, effect: str | None = None, value: float = 0.0, parameter: str = '',
                 runs: Sequence[str] = tuple(RUNS), seed: int = 4) -> list[Path]:
        """Bags of `runs` on a rig with that effect of that size, or without any."""
        settings = DrawSettings()
        if effect is not None:
            settings = DrawSettings((effect,), fixed={effect: {parameter: value}})
        rig = f'bags_{effect}_{parameter}_{value}_{seed}'
        truth = draw_truth(seed, 'clean' if effect is None else 'single', settings)
        return [self._made.folder(f'{rig}/{run}', partial(_write, truth, run)) for run in runs]


def _write(truth: Truth, run: str, folder: Path) -> None:
    bag, = examiner.write_campaign(truth, folder, [run], SHORT)
    for file in bag.iterdir():
        file.rename(folder / file.name)
    bag.rmdir()
