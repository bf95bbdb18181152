"""Claims on SECURITY.md: every promise names a test, and that test exists."""

from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROW = re.compile(r'^\| (?P<promise>[^|]+) \| (?P<tests>[^|]+) \|$', re.M)
TEST = re.compile(r'`(test/[\w/]+\.py)::(test_\w+)`')

PROMISES = [(row['promise'], row['tests'])
            for row in ROW.finditer((ROOT / 'SECURITY.md').read_text(encoding='utf-8'))
            if row['promise'] != 'promise' and not row['promise'].startswith('--')]


def test_there_are_promises() -> None:
    assert len(PROMISES) > 30


@pytest.mark.parametrize(('promise', 'tests'), PROMISES, ids=[row[0][:40] for row in PROMISES])
def test_a_promise_stands_beside_a_test_that_exists(promise: str, tests: str) -> None:
    named = TEST.findall(tests)
    assert named, promise
    for file, name in named:
        assert f'def {name}(' in (ROOT / file).read_text(encoding='utf-8'), f'{file}::{name}'
