"""The gallery of verdicts: python docs/gallery.py CACHE writes images/gallery_*.png.

Each cause of the virtual rig is hidden in short bags of one rig, and the bags are diagnosed. CACHE
keeps each verdict, so that a run that was cut off goes on where it stopped (five minutes for all).
"""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path
import sys
import tempfile
import textwrap
from typing import Any

from matplotlib.figure import Figure
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'benchmarks'))

from examiner import draw_truth, DrawSettings, RecordSettings, write_campaign

from saddlering_ros import diagnose
from saddlering_ros.effects import catalogue
from saddlering_ros.effects.extension import STAGES
from saddlering_ros.pages.charts import AFTER, BEFORE, DARK, drawing, LIGHT, NOISE
from saddlering_ros.pages.html import png
from saddlering_ros.report.figures import curves_of, MICRO, RunCurves, SYMBOLS
from saddlering_ros.rig import CHANNELS, MICRO_UNITS
from saddlering_ros.virtual_rig.effects import EFFECTS

IMAGES = Path(__file__).resolve().parent / 'images'
FITTED, HELD_OUT = ('static_50', 'dynamic_50', 'static_70'), ('dynamic_70',)
SHORT = RecordSettings(hold=2.0, static_rate=25.0, duration=8.0, dynamic_rate=500.0)
SEED, COLUMNS = 4, 3
TOO_SHORT = 'damping_law'
"""At twice its size a ring with this law finds no rest in so short a record."""

OUTSIDE = 'out:heat_wave'
"""A cause that no catalogue holds, for the verdict `unknown`."""

KINDS = {'named': ('named', False), 'with a rest': ('named', True),
         'ambiguous': ('ambiguous', False)}
"""Verdicts of the first sheet, and whether they leave a rest."""

Case = dict[str, Any]


def case(name: str, cache: Path) -> Case:
    """The verdict on a rig with this cause ('': sound), and the misfit that it changes most."""
    kept = cache / f'{name.replace(":", "_") or "sound"}.json'
    if kept.exists():
        return dict(json.loads(kept.read_text()))
    settings, kind = DrawSettings(), 'clean'
    if name:
        # Twice the typical size, which most of these short records show.
        main = EFFECTS[name].parameters[0]
        size = 2.0 * main.typical if not main.choices else main.typical
        settings = DrawSettings((name,), fixed={name: {main.name: size}})
        kind = 'single' if EFFECTS[name].in_catalogue else 'outside'
    with tempfile.TemporaryDirectory() as folder:
        truth = draw_truth(SEED, kind, settings)
        bags = write_campaign(truth, Path(folder), (*FITTED, *HELD_OUT), SHORT)
        found = diagnose(bags[:len(FITTED)], hold_out=bags[len(FITTED):])
    is_established = found.verdict in ('named', 'ambiguous')
    run, channel = _most_changed(curves_of(found.found), is_established)
    row = CHANNELS.index(channel)
    over = run.load_in_unit if run.test == 'static' else run.time
    made = {
        'cause': name, 'verdict': found.verdict, 'causes': list(found.causes),
        'words': found.document['headline'], 'run': run.name,
        'channel': f'{SYMBOLS[channel]} / {MICRO_UNITS[channel]}',
        'over': 'load / t' if run.test == 'static' else 'time / s',
        'at': over.tolist(), 'noise': MICRO * run.noise[channel],
        'before': (MICRO * (run.measured - run.before)[row]).tolist(),
        'after': (MICRO * (run.measured - run.after)[row]).tolist()}
    kept.write_text(json.dumps(made))
    return made


def _most_changed(runs: Sequence[RunCurves], is_established: bool) -> tuple[RunCurves, str]:
    """Run and channel whose misfit over the noise falls most; without a cause is largest."""
    def worth(run: RunCurves, channel: str) -> float:
        before, after = (float(np.sqrt(np.mean(run.residual(channel, extended=extended)**2)))
                         for extended in (False, True))
        return (before - after if is_established else before) / max(run.noise[channel], 1e-12)

    return max(((run, channel) for run in runs for channel in CHANNELS),
               key=lambda pair: worth(*pair))


def sheet(cases: Sequence[Case], columns: int = COLUMNS, alone: str = 'contact law alone'
          ) -> Figure:
    """One panel a case: title, misfit without and with the causes, words of the verdict."""
    rows = -(-len(cases) // columns)
    with drawing():
        figure = Figure(figsize=(10.5, 2.55 * rows + 0.3), layout='constrained')
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes in grid.flat[len(cases):]:
            axes.axis('off')
        for axes, one in zip(grid.flat, cases, strict=False):
            for opacity, size in ((DARK, one['noise']), (LIGHT, one.get('allowed', 0.0))):
                axes.axhspan(-2 * size, 2 * size, color=NOISE, alpha=opacity, lw=0)
            axes.plot(one['at'], one['before'], color=BEFORE, lw=0.9, label=alone)
            if one['verdict'] in ('named', 'ambiguous'):
                axes.plot(one['at'], one['after'], color=AFTER, lw=0.9, label='with the cause')
            effect = catalogue().get(one['cause'])
            axes.set_title(effect.title if effect else one['title'], fontsize=9, weight='bold')
            axes.set_ylabel(f'misfit {one["channel"]}', fontsize=7.5)
            axes.tick_params(labelsize=7)
            words = textwrap.fill(
                f'{one["verdict"]}: {one["words"]}', 156 // columns, max_lines=5,
                placeholder=' …')
            axes.set_xlabel(f'{one["run"]}, {one["over"]}\n{words}', fontsize=6.8, loc='left')
        named = max((axes.get_legend_handles_labels() for axes in grid.flat),
                    key=lambda pair: len(pair[0]))
        figure.legend(*named, loc='outside upper right', ncols=2)
    return figure


def main() -> None:
    """Every sheet, from the verdicts in the cache."""
    cache = Path(sys.argv[1])
    cache.mkdir(parents=True, exist_ok=True)
    wanted = sys.argv[2:] or ['', OUTSIDE, *(
        name for name in catalogue() if name in EFFECTS and name != TOO_SHORT)]
    cases = {name: case(name, cache) for name in wanted}
    if sys.argv[2:]:
        return
    for stage in STAGES:
        of_stage = [one for name, one in cases.items()
                    if name in catalogue() and catalogue()[name].stage == stage]
        name = f'gallery_{stage.replace(" ", "_")}.png'
        (IMAGES / name).write_bytes(png(sheet(of_stage)))
    of_verdict = {kind: [one for one in cases.values() if one['verdict'] == verdict
                         and (' mainly ' in one['words']) == has_rest]
                  for kind, (verdict, has_rest) in KINDS.items()}
    verdicts = [{**cases[''], 'title': 'A sound ring'},
                *(one for found in of_verdict.values() for one in found[:1]),
                {**cases[OUTSIDE], 'title': 'A draught at one probe (in no catalogue)'}]
    (IMAGES / 'gallery_verdicts.png').write_bytes(png(sheet(verdicts)))


if __name__ == '__main__':
    main()
