"""Claims on words: the code and the docs use the vocabulary of the field."""

from __future__ import annotations

from pathlib import Path
import re
import subprocess

import pytest

ROOT = Path(__file__).resolve().parents[2]

REPLACED = {
    'saddle bearing': (r'(?i)\bsaddle bearing', 'saddle ring'),
    'free_of': (r'\bfree_of\b', 'marginalise'),
    'Allowance': (r'\bAllowance\b', 'ModelErrorPrior'),
    'scouted': (r'\bscout(ed|ing)?\b', 'coarse_fit'),
    'carried_on': (r'\bcarried_on\b', 'refine'),
    'Battery': (r'\bBattery\b', 'LackOfFitTests'),
    'Ripple': (r'\bRipple\b', 'FastResidual'),
    'Muster': (r'\bMuster\b', 'LockstepGroup'),
    'Inflow': (r'\b(In|Out)flow\b', 'RawSubscription'),
    'unsound': (r'\bunsound\b', 'misfit_with_inflated_nuisances'),
    'small unknowns': (r'(?i)\bsmall unknowns\b', 'nuisance parameters'),
    'knob': (r'\bknobs?\b', 'extension parameter'),
    'kept back': (r'\bkept[ _](back|apart)\b', 'held out'),
    'left out in turn': (r'left out in turn', 'held out'),
    'LEAST_, MOST_, LARGEST_': (r'\b_?(LEAST|MOST|LARGEST|SMALLEST|FEWEST)_', 'MIN_, MAX_'),
}
"""Old word: a pattern that finds it, and what to say."""

NOT_YET: dict[str, tuple[str, ...]] = {
    'kept back': (
        'saddlering_ros/jobs/identification.py',
        'saddlering_ros/virtual_rig/effects.py',
    ),
    'left out in turn': (
        'saddlering_ros/diagnosis/contract.py',
        'saddlering_ros/diagnosis/wording.py',
        'saddlering_ros/discrepancy/conclusion.py',
        'saddlering_ros/discrepancy/proposal/propose.py',
        'saddlering_ros/discrepancy/proposal/selection.py',
    ),
    'LEAST_, MOST_, LARGEST_': (
        'benchmarks/fuzz.py',
        'benchmarks/rigs.py',
        'saddlering_ros/bags/checks.py',
        'saddlering_ros/bags/directory.py',
        'saddlering_ros/bags/mcap_file.py',
        'saddlering_ros/bags/plateaus.py',
        'saddlering_ros/bags/reader.py',
        'saddlering_ros/bags/scan.py',
        'saddlering_ros/bags/stamps.py',
        'saddlering_ros/bags/wiring.py',
        'saddlering_ros/diagnosis/records.py',
        'saddlering_ros/discrepancy/lines.py',
        'saddlering_ros/fleet/drifts.py',
        'saddlering_ros/fleet/random_effects.py',
        'saddlering_ros/identification/load_cell.py',
        'saddlering_ros/identification/rating.py',
        'saddlering_ros/identification/validation.py',
        'saddlering_ros/importing/calibration.py',
        'saddlering_ros/importing/formats/hdf5_file.py',
        'saddlering_ros/importing/formats/matlab_file.py',
        'saddlering_ros/importing/formats/mdf_blocks.py',
        'saddlering_ros/importing/preview.py',
        'saddlering_ros/jobs/action_server.py',
        'saddlering_ros/live/watcher.py',
        'saddlering_ros/rig/quantities.py',
        'saddlering_ros/rig/zeroing.py',
        'saddlering_ros/streams/residual.py',
        'saddlering_ros/virtual_rig/integrator.py',
        'saddlering_ros/virtual_rig/scoring.py',
        'test/diagnosis/test_small_unknowns.py',
        'test/rig/test_zeroing.py',
    ),
}
"""Files in which an old word still stands: this list may only grow shorter."""


def files() -> list[str]:
    """Code and pages; not the record of what was changed and measured."""
    listed = subprocess.run(['git', 'ls-files', '*.py', '*.md'], cwd=ROOT, capture_output=True,
                            text=True, check=False)
    if listed.returncode:
        pytest.skip('this is no git clone')
    own = Path(__file__).relative_to(ROOT).as_posix()
    return [name for name in listed.stdout.split()
            if name not in ('CHANGELOG.md', own) and not name.startswith('docs/benchmarks/')
            and (ROOT / name).is_file()]


@pytest.mark.parametrize('old', REPLACED)
def test_an_old_word_stands_nowhere_else(old: str) -> None:
    pattern, say = re.compile(REPLACED[old][0]), REPLACED[old][1]
    known = {Path(name).name for name in NOT_YET.get(old, ())}  # a file may move
    found = [name for name in files() if Path(name).name not in known
             and pattern.search((ROOT / name).read_text(encoding='utf-8'))]
    assert not found, f'say {say} for {old}'
