"""Temporary folders of a killed launcher go with the next start, as those of the demonstration."""

import os
from pathlib import Path
import subprocess
import sys
import tempfile

from saddlering_ros.ros.launcher import NodeGroup

KILLED = """
import os, signal
from saddlering_ros.ros.launcher import NodeGroup
with NodeGroup(domain_id=99) as group:
    (group.log_folder / 'ring_simulator.log').write_text('half')
    os.kill(os.getpid(), signal.SIGKILL)
"""


def folders_during() -> list[Path]:
    with NodeGroup(domain_id=99) as group:
        assert group.log_folder is not None
        return sorted(group.log_folder.parent.iterdir())


def test_folders_of_the_killed_are_swept_and_those_of_the_living_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    subprocess.run([sys.executable, '-c', KILLED], check=False,
                   env={**os.environ, 'TMPDIR': str(tmp_path)})
    dead, = tmp_path.iterdir()
    assert list(dead.iterdir())
    os.utime(dead, (0, 0))
    first = folders_during()
    assert dead not in first
    assert len(first) == 1
    with NodeGroup(domain_id=98) as living:
        assert living.log_folder is not None
        os.utime(living.log_folder, (0, 0))
        assert living.log_folder in folders_during()
    assert not list(tmp_path.iterdir())
