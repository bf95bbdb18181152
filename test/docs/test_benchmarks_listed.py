"""The index of the logs lists every benchmark with its question."""

from pathlib import Path
import subprocess
import sys

ROOT = Path(__file__).resolve().parents[2]


def test_every_benchmark_is_listed_with_its_question() -> None:
    listed = subprocess.run([sys.executable, 'benchmarks/run.py', '--list'], cwd=ROOT, check=True,
                            capture_output=True, text=True).stdout.splitlines()
    index = (ROOT / 'docs' / 'benchmarks' / 'figures.md').read_text()
    rows = [f'| {name} | {question} |' for name, _, question in
            (line.partition(': ') for line in listed)]
    assert len(rows) > 10
    assert [row for row in rows if row not in index] == []
