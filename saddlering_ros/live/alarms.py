"""The alarm on the page, from the messages of its node: its state, and its verdict of a test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from saddlering_interfaces.msg import RingAlarm
from saddlering_ros.monitoring.monitor import FOLLOWS
from saddlering_ros.quantities import signed
from saddlering_ros.ros.messages import to_stamp

END = 1_000_000_000
"""An alarm that is blind from less than this before the end of a test [ns] has seen it all."""

STATES = {RingAlarm.WAITING: 'waiting', RingAlarm.LEARNING: 'learning',
          RingAlarm.WATCHING: 'watching', RingAlarm.ALARM: 'alarm', RingAlarm.BLIND: 'blind'}


def alarm_as_page(message: RingAlarm) -> dict[str, Any]:
    """State, words and lapses; of a blind watch the topics that are missing.

    Of an alarm its channel, size with unit, duration and guess too.

    allowed: the residual that is no alarm [um, um, urad]; None if it is not known yet.
    before [s]: how long before the alarm its cause began.
    """
    shown: dict[str, Any] = {
        'state': STATES.get(message.state, 'waiting'), 'words': str(message.message),
        'allowed': [1e6 * value for value in message.materiality]
        if any(value > 0.0 for value in message.materiality) else None,
        'lapses': [str(lapse).partition(' s: ')[2] or str(lapse) for lapse in message.lapses]}
    if message.state == RingAlarm.BLIND:
        return {**shown, 'missing': list(message.missing)}
    if message.state != RingAlarm.ALARM:
        return shown
    before = (to_stamp(message.raised) - to_stamp(message.since)) / 1e9
    unit = 'rad' if message.channel == 'gamma' else 'm'
    return {**shown, 'channel': str(message.channel), 'size': signed(message.size, unit),
            'since': to_stamp(message.since), 'before': round(before, 3),
            'why': FOLLOWS.get(message.follows, ''), 'guess': str(message.first_guess)}


def with_link(
    shown: dict[str, Any] | None, health: Sequence[dict[str, Any]]
) -> dict[str, Any] | None:
    """The same, with `offline`: whether the node of the alarm has reported, and no longer does."""
    if shown is None:
        return None
    levels = [item['level'] for item in health if 'ring_alarm: ' in item['name']]
    return {**shown, 'offline': bool(levels) and all(level == 'silent' for level in levels)}


@dataclass
class AlarmOfTest:
    """What the alarm stated during one test.

    taken_back: first guesses that later samples spoke against, with the seconds from the alarm
    to the next guess.
    """

    last: RingAlarm | None = None
    has_watched: bool = False
    taken_back: list[tuple[str, float]] = field(default_factory=list)

    def hear(self, message: RingAlarm) -> None:
        """Take a state."""
        before, self.last = self.last, message
        self.has_watched |= message.state in (RingAlarm.WATCHING, RingAlarm.ALARM)
        if message.state != RingAlarm.ALARM or before is None or not before.follows:
            return
        if before.raised != message.raised:
            self.taken_back = []
        elif before.follows != message.follows:
            seconds = (to_stamp(message.header.stamp) - to_stamp(message.raised)) / 1e9
            self.taken_back.append((str(before.first_guess), round(seconds, 1)))

    def verdict(self, origin: int, newest: int) -> dict[str, str]:
        """Level and words about a test from origin to newest [ns]."""
        last = self.last
        if last is None:
            return {'level': 'silent', 'words': 'not watched: ring_alarm did not run'}
        if last.state == RingAlarm.ALARM:
            if to_stamp(last.raised) < origin:
                return {'level': 'warning', 'words': 'not watched: an earlier alarm is latched'}
            shown = alarm_as_page(last)
            return {'level': 'error', 'words': f'ALARM {shown["channel"]} {shown["size"]}'}
        reason = ': '.join(last.message.split(': ')[:2])
        if not self.has_watched:
            return {'level': 'warning', 'words': f'not watched: {reason}'}
        if last.state == RingAlarm.BLIND and newest - to_stamp(last.header.stamp) > END:
            return {'level': 'warning',
                    'words': f'no alarm, but not watched to the end: {reason}'}
        return {'level': 'ok', 'words': 'no alarm'}
