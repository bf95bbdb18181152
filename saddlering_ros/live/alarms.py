"""The alarm on the page, from the message of its node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from saddlering_interfaces.msg import RingAlarm
from saddlering_ros.quantities import signed
from saddlering_ros.ros.messages import to_stamp

STATES = {RingAlarm.WAITING: 'waiting', RingAlarm.LEARNING: 'learning',
          RingAlarm.WATCHING: 'watching', RingAlarm.ALARM: 'alarm', RingAlarm.BLIND: 'blind'}


def alarm_as_page(message: RingAlarm) -> dict[str, Any]:
    """State, words and lapses; of a blind watch the topics that are missing.

    Of an alarm its channel, size with unit, duration and guess too.

    before [s]: how long before the alarm its cause began.
    """
    shown: dict[str, Any] = {
        'state': STATES.get(message.state, 'waiting'), 'words': str(message.message),
        'lapses': [str(lapse).partition(' s: ')[2] or str(lapse) for lapse in message.lapses]}
    if message.state == RingAlarm.BLIND:
        return {**shown, 'missing': list(message.missing)}
    if message.state != RingAlarm.ALARM:
        return shown
    before = (to_stamp(message.raised) - to_stamp(message.since)) / 1e9
    unit = 'rad' if message.channel == 'gamma' else 'm'
    return {**shown, 'channel': str(message.channel), 'size': signed(message.size, unit),
            'since': to_stamp(message.since), 'before': round(before, 3),
            'follows': str(message.follows), 'guess': str(message.first_guess)}


def with_link(
    shown: dict[str, Any] | None, health: Sequence[dict[str, Any]]
) -> dict[str, Any] | None:
    """The same, with `offline`: whether the node of the alarm has reported, and no longer does."""
    if shown is None:
        return None
    levels = [item['level'] for item in health if 'ring_alarm: ' in item['name']]
    return {**shown, 'offline': bool(levels) and all(level == 'silent' for level in levels)}
