"""Claims on terminals without Unicode: every command prints, and no number changes its meaning."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from saddlering_ros.cli._plain_text import in_ascii
from saddlering_ros.quantities import probability, quantity


@pytest.mark.parametrize(('shown', 'plain'), [
    (quantity(7.96e7, 'N/m^n', 5.6e6), '(7.96 +/- 0.56) x 10^7 N/m^n'),
    (quantity(2.5e-6, 'm'), '2.50 um'),
    (probability(1e-30), '< 10^-12'),
    ('δx → 0.35 rad', 'delta_x -> 0.35 rad'),
    ('Prüfstand', 'Pr?fstand'),
])
def test_ascii_keeps_the_meaning_of_a_number(shown: str, plain: str) -> None:
    assert in_ascii(shown) == plain


@pytest.mark.parametrize('encoding', ['ascii', 'latin-1', 'cp1252'])
def test_a_stream_without_unicode_gets_ascii(encoding: str) -> None:
    code = ('from saddlering_ros.cli._plain_text import use_ascii_where_needed as use; use(); '
            'print("1.5 × 10⁷ µm ± 2"); print("1.5 × 10⁻¹² µm")')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, check=True,
                          env={**os.environ, 'PYTHONIOENCODING': encoding})
    assert done.stdout.decode('ascii').splitlines() == ['1.5 x 10^7 um +/- 2', '1.5 x 10^-12 um']


def test_the_command_prints_on_such_a_stream() -> None:
    done = subprocess.run(
        [sys.executable, '-m', 'saddlering_ros.cli.main', 'info', 'bags/static_50'],
        capture_output=True, check=False, env={**os.environ, 'PYTHONIOENCODING': 'ascii'})
    assert done.returncode == 0, done.stderr
    assert '1085.54 um' in done.stdout.decode('ascii')
