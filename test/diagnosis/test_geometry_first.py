"""Claims about advice with an unknown cause: the rig file is suspected before the hardware."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from saddlering_ros.diagnosis.diagnose import _geometry_first
from saddlering_ros.rig import default_rig

RIG = default_rig()
SWAP = 'Swap probes 2 and 4.'


@pytest.mark.parametrize(('verdict', 'rig_hash', 'is_first'), [
    ('unknown', '', True), ('unknown', 'f' * 64, True), ('unknown', RIG.digest, False),
    ('named', '', False), ('none', '', False),
])
def test_the_rig_file_comes_before_the_probes_unless_a_hash_vouches_for_it(
        verdict: str, rig_hash: str, is_first: bool) -> None:
    found: Any = SimpleNamespace(verdict=verdict)
    run: Any = SimpleNamespace(rig_hash=rig_hash)
    sentence = _geometry_first(SWAP, found, [run], RIG)
    assert sentence is not None
    assert sentence.endswith(SWAP)
    assert sentence.startswith('First compare the rig file') == is_first
