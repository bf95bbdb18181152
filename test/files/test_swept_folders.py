"""Temporary folders of a killed launcher and a killed demonstration go with the next start."""

import os
from pathlib import Path
import subprocess
import sys
import tempfile

import pytest

from saddlering_ros.demo import story
from saddlering_ros.demo.story import tell
from saddlering_ros.ros.launcher import NodeGroup

KILLED = {
    'launcher': """
import os, signal
from saddlering_ros.ros.launcher import NodeGroup
with NodeGroup(domain_id=99) as group:
    (group.log_folder / 'ring_simulator.log').write_text('half')
    os.kill(os.getpid(), signal.SIGKILL)
""",
    'demo': """
import os, signal
from saddlering_ros.demo import story
class Killed:
    def __init__(self, plan, console, scratch):
        (scratch / 'measured.csv').write_text('half')
    def run(self):
        os.kill(os.getpid(), signal.SIGKILL)
story._Story = Killed
story.tell(None, None)
"""}


class Seen:
    """A demonstration that lists the temporary folders there are while it runs."""

    def __init__(self, plan: object, console: object, scratch: Path) -> None:
        self.scratch = scratch

    def run(self) -> list[Path]:
        return sorted(self.scratch.parent.iterdir())


def folders_during(kind: str, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    if kind == 'demo':
        monkeypatch.setattr(story, '_Story', Seen)
        return tell(None, None)
    with NodeGroup(domain_id=99) as group:
        assert group.log_folder is not None
        return sorted(group.log_folder.parent.iterdir())


@pytest.mark.parametrize('kind', list(KILLED))
def test_folders_of_the_killed_are_swept_and_those_of_the_living_are_kept(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    subprocess.run([sys.executable, '-c', KILLED[kind]], check=False,
                   env={**os.environ, 'TMPDIR': str(tmp_path)})
    dead, = tmp_path.iterdir()
    assert list(dead.iterdir())
    os.utime(dead, (0, 0))
    first = folders_during(kind, monkeypatch)
    assert dead not in first
    assert len(first) == 1
    with NodeGroup(domain_id=98) as living:
        assert living.log_folder is not None
        os.utime(living.log_folder, (0, 0))
        assert living.log_folder in folders_during(kind, monkeypatch)
    assert not list(tmp_path.iterdir())
