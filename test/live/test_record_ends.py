"""A recording that is ended as launch and systemd end it is whole, and its status is 0."""

import signal
import subprocess
import sys

import pytest
from rosnet import ended, wait_until

from saddlering_ros.ros.launcher import NodeGroup

pytestmark = pytest.mark.ros
CODE = """
import builtins, signal, sys
number, out = sys.argv[1:]
say = print

def at_its_wait(frame, event, function):
    if event == 'c_call' and function.__name__ in ('acquire', 'sleep'):
        sys.setprofile(None)
        signal.raise_signal(int(number))

def recording(words, **options):
    say(words, **options)
    sys.setprofile(at_its_wait)

from saddlering_ros.cli.main import main
builtins.print = recording
sys.exit(main(['record', out]))
"""


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_recording_with_status_0(ros_domain, tmp_path, number) -> None:
    """The first one comes where the command waits: the lock of an Event would be taken there."""
    log = tmp_path / 'log'
    with log.open('w') as stream, subprocess.Popen(
            [sys.executable, '-c', CODE, str(int(number)), str(tmp_path / 'bag')],
            env=NodeGroup(ros_domain).environment, stdout=stream,
            stderr=subprocess.STDOUT) as process, ended(process):
        def is_ended() -> bool:
            process.send_signal(number)  # a launch and its terminal repeat it
            return process.poll() is not None

        wait_until(lambda: 'recording' in log.read_text() or process.poll() is not None, 120.0)
        wait_until(is_ended, what='it ends')
        assert process.poll() == 0, log.read_text()
    assert (tmp_path / 'bag' / 'metadata.yaml').is_file()
