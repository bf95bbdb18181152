"""A folder of bags without readings: enough for everything but the verdict itself."""

from pathlib import Path

from campaign_stubs import write_bag
import pytest


@pytest.fixture(name='works')
def works_fixture(tmp_path: Path) -> Path:
    """Three rings with two tests each; the first has a second session a week later."""
    folder = tmp_path / 'works'
    for ring in ('SR-1', 'SR-2', 'SR-3-friction'):
        write_bag(folder, ring, 'static_50')
        write_bag(folder, ring, 'dynamic_70', elevation=70.0, day=0.1)
    write_bag(folder, 'SR-1', 'static_50_again', day=7.0)
    return folder
