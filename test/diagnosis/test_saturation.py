"""A probe that is cut off: the level at which it stands still is where its fit begins."""

from dataclasses import replace
from pathlib import Path

from few_effects import few_effects
import numpy as np
import pytest

from saddlering_ros.bags.reader import read_run
from saddlering_ros.diagnosis.records import build_record, cut_off_probes
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Problem
from saddlering_ros.discrepancy.search.space import prepare
from saddlering_ros.discrepancy.search.valleys import fit_at_told_sizes
from saddlering_ros.record.record import Record
from saddlering_ros.rig import default_rig

BAGS = Path(__file__).parents[2] / 'bags'
LIMIT = 110e-6


def cut_off(name: str) -> Record:
    """A shipped bag whose probe 2 reads no more than LIMIT above its first readings."""
    run = read_run(BAGS / name)
    gaps, first = run.gaps.copy(), 20 if run.test == 'static' else 300
    gaps[1] = np.minimum(gaps[1], np.nanmean(gaps[1][:first]) + LIMIT)
    return replace(run, gaps=gaps)


def test_a_probe_that_stands_still_while_the_load_moves_tells_its_limit() -> None:
    rig = default_rig()
    for run, count in ((cut_off('static_50'), 1), (read_run(BAGS / 'static_50'), 0)):
        told = cut_off_probes([build_record(rig, run, held_out=False).run], rig)
        assert told == [('probe_saturation', 1, pytest.approx(LIMIT, abs=0.3e-6))] * count


def test_beside_its_limit_the_base_leaves_the_valley_in_which_it_imitates_the_cut() -> None:
    """From the starts at 80 and 120 µm the limit ended at 88 µm, and the verdict was unknown."""
    rig = default_rig()
    runs = [build_record(rig, cut_off(name), held_out=False).run
            for name in ('static_50', 'dynamic_50')]
    with few_effects('probe_saturation'):
        space = prepare(Problem(RingSystem(rig, told=cut_off_probes(runs, rig)), runs))
        told, = fit_at_told_sizes(space)
    assert told.misfit < 0.2 * space.base.misfit
    effect, _, part = told.parts[0]
    assert effect.size.from_unit(float(told.theta_unit[part.start])) == pytest.approx(
        LIMIT, abs=1e-6)
