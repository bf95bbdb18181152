"""Claims on terminals without Unicode: every command prints, and no number changes its meaning."""

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize('encoding', ['ascii', 'latin-1', 'utf-8'])
def test_a_stream_prints_every_text_and_no_power_becomes_a_digit(encoding: str) -> None:
    code = ('from saddlering_ros.cli.main import print_any_text; print_any_text(); '
            'print("1.5 × 10⁷ N", "b\\udcff")')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, check=True,
                          env={**os.environ, 'PYTHONIOENCODING': encoding})
    shown = done.stdout.decode(encoding).strip()
    assert shown.endswith('10⁷ N b\\udcff' if encoding == 'utf-8' else '10\\u2077 N b\\udcff')


def test_the_command_prints_on_such_a_stream() -> None:
    done = subprocess.run(
        [sys.executable, '-m', 'saddlering_ros.cli.main', 'info', 'bags/static_50'],
        capture_output=True, check=False, env={**os.environ, 'PYTHONIOENCODING': 'ascii'})
    assert done.returncode == 0, done.stderr
    assert '1085.54 \\xb5m' in done.stdout.decode('ascii')
