"""Folders of bags without readings: enough for everything but the verdict itself."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

START = 1_767_600_000


def write_bag(folder: Path, ring: str, name: str, *, day: float = 0.0, elevation: float = 50.0,
              **facts: str) -> Path:
    """A rosbag2 directory whose recording is one line of text."""
    bag = folder / ring / name
    bag.mkdir(parents=True)
    (bag / f'{name}_0.mcap').write_text(f'{ring} {name} {day} {facts}')
    custom = {'test': name.partition('_')[0], 'elevation_deg': f'{elevation:g}', 'rig': ring,
              **facts}
    information = {
        'relative_file_paths': [f'{name}_0.mcap'], 'storage_identifier': 'mcap',
        'custom_data': custom,
        'starting_time': {'nanoseconds_since_epoch': int((START + 86400 * day) * 1e9)},
    }
    (bag / 'metadata.yaml').write_text(
        yaml.safe_dump({'rosbag2_bagfile_information': information}))
    return bag


@pytest.fixture(name='works')
def works_fixture(tmp_path: Path) -> Path:
    """Three rings with two tests each; the first has a second session a week later."""
    folder = tmp_path / 'works'
    for ring in ('SR-1', 'SR-2', 'SR-3-friction'):
        write_bag(folder, ring, 'static_50')
        write_bag(folder, ring, 'dynamic_70', elevation=70.0, day=0.1)
    write_bag(folder, 'SR-1', 'static_50_again', day=7.0)
    return folder
