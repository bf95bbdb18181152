"""The finding of a node on its zero reading."""

from __future__ import annotations

from saddlering_ros.rig import Rig
from saddlering_ros.rig.zeroing import ZeroReading
from saddlering_ros.ros.diagnostics import Finding, OK, WARN


def zero_finding(
    rig: Rig, zero: ZeroReading | None, zero_stamp: int, newest_stamp: int, load: float,
) -> Finding:
    """Whether the zero is taken; if not, the load [N] at which the node waits.

    Stamps are in ns; `newest_stamp` is 0 before the first sample.
    """
    if zero is not None:
        return Finding(OK, f'zero at {rig.force_words(zero.load, 3)}',
                       {'zero stamp': str(zero_stamp), 'zero load [N]': f'{zero.load:.1f}'})
    if not newest_stamp:
        return Finding(OK, 'waiting for samples')
    return Finding(WARN, f'waiting for preload (load is {rig.force_words(load, 2)}): '
                         'go to preload, or call ~/zero')
