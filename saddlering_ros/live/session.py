"""The tests that the page has seen: names, messages, the alarm during each and its verdict."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import heapq
from pathlib import Path
import tempfile
from typing import Any

from saddlering_interfaces.msg import RingAlarm
from saddlering_ros.bags.wire import decode_time
from saddlering_ros.bags.write import BagWriter
from saddlering_ros.errors import LiveError
from saddlering_ros.live.traces import CurvesOfTest
from saddlering_ros.monitoring.monitor import FOLLOWS
from saddlering_ros.quantities import signed
from saddlering_ros.record.batches import SECOND
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.topics import TOPICS
from saddlering_ros.ros.messages import to_stamp

MAX_BYTES = 256 * 2**20
"""Messages of the rig kept for saving: three quarters of an hour at 1 kHz."""

EDGE = SECOND // 10
"""Messages so long before and after the curves of a test [ns] belong to it: other clocks."""

Stamped = tuple[int, bytes]
"""A message after its stamp [ns]."""

END = SECOND
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
            'why': FOLLOWS.get(message.follows, ('', ''))[0], 'guess': str(message.first_guess)}


def with_link(shown: dict[str, Any] | None,
              health: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """The same, with `offline`: why the node of the alarm reports no longer, in words, or ''."""
    statuses = [status for status in health if 'ring_alarm: ' in status['name']]
    is_gone = all(status['level'] == 'silent' for status in statuses)
    words = statuses[0]['words'] if statuses and is_gone else ''
    return None if shown is None else {**shown, 'offline': words}


@dataclass
class AlarmOfTest:
    """What the alarm stated during one test.

    taken_back: first guesses that later samples refuted, and the seconds from alarm to next guess.
    """

    last: RingAlarm | None = None
    has_watched: bool = False
    taken_back: list[tuple[str, float]] = field(default_factory=list)

    def hear(self, message: RingAlarm) -> None:
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
            return {'level': 'warning', 'words': f'no alarm, but not watched to the end: {reason}'}
        return {'level': 'ok', 'words': 'no alarm'}


@dataclass
class SeenTest:
    """One test: name, alarm, messages by topic and their size; is_cut: some were not kept."""

    name: str = ''
    alarm: AlarmOfTest = field(default_factory=AlarmOfTest)
    messages: dict[str, list[bytes]] = field(default_factory=dict)
    size: int = 0
    is_cut: bool = False


class Session:
    """The tests by their numbers; from any thread that holds the page's lock."""

    def __init__(self) -> None:
        self.number = 1
        self._tests = {1: SeenTest()}
        self._alarm: RingAlarm | None = None

    @property
    def current(self) -> SeenTest:
        """The test that runs, or the last one."""
        return self._tests[self.number]

    def follow(self, number: int, name: str) -> None:
        """The test of that number runs; its name, '' where it is not known."""
        if number != self.number:
            self.number = number
            self._tests[number] = SeenTest()
            if self._alarm is not None:
                self.current.alarm.hear(self._alarm)
        self.current.name = name or self.current.name

    def hear(self, message: RingAlarm, tests: Iterable[CurvesOfTest]) -> None:
        """Take a state of the alarm: of the newest of `tests` that its stamp is in, or of now."""
        self._alarm = message
        stamp = to_stamp(message.header.stamp)
        numbers = [curves.number for curves in tests
                   if curves.origin <= stamp <= curves.newest + SECOND]
        self._tests[numbers[-1] if numbers else self.number].alarm.hear(message)

    def keep(self, topic: str, messages: list[bytes]) -> None:
        """Keep messages of the rig; the oldest tests give way to them."""
        test = self.current
        test.messages.setdefault(topic, []).extend(messages)
        test.size += sum(map(len, messages))
        surplus = sum(one.size for one in self._tests.values()) - MAX_BYTES
        for one in self._tests.values():
            if surplus <= 0:
                return
            surplus -= one.size
            one.messages, one.size, one.is_cut = {}, 0, True

    def as_page(self, curves: CurvesOfTest, scales: Mapping[str, float]) -> dict[str, Any]:
        """A test as the page lists it: times [ms], peaks in the units of the page, the verdict."""
        test = self._tests[curves.number]
        return {
            'number': curves.number, 'name': test.name, 'began': curves.origin / 1e6,
            'seconds': (curves.newest - curves.origin) / 1e9, 'has_bag': not test.is_cut,
            'peaks': {name: [[None if value != value else round(value, 3) for value in row]
                             for row in (scales[name] * peaks).tolist()]
                      for name, peaks in curves.peaks.items() if name != 'residual'},
            'verdict': test.alarm.verdict(curves.origin, curves.newest)}

    def beside(self, number: int) -> list[SeenTest]:
        """This test and those beside it, as they are now; LiveError if some were not kept."""
        if self._tests[number].is_cut:
            raise LiveError('the messages of this test were too many to keep: record the next '
                            'one with ros2 bag record, or saddlering replay --record')
        tests = [self._tests[one] for one in (number, number - 1, number + 1)
                 if one in self._tests]
        return [replace(test, messages=dict(test.messages)) for test in tests]


def messages_of(tests: Sequence[SeenTest], curves: CurvesOfTest) -> dict[str, list[Stamped]]:
    """By topic the messages of the first of `tests`, with their stamps.

    They came during it, or just beside it: topics are drained one after another. It takes seconds
    for a long test, in which no lock should be held: its reader's queues would overflow.
    """
    first, last = curves.origin - EDGE, curves.newest + EDGE
    by_topic: dict[str, list[Stamped]] = {}
    for topic in TOPICS:
        mine: dict[int, bytes] = {}
        for test in tests:  # the other ones may hold another replay of the same bag
            here = [(stamp, message) for message in test.messages.get(topic, ())
                    if first <= (stamp := decode_time(message)) <= last and stamp not in mine]
            by_topic.setdefault(topic, []).extend(here)
            mine.update(here)
        by_topic[topic].sort()
    return by_topic


def mcap_of(flows: Mapping[str, list[Stamped]], facts: TestMetadata) -> bytes:
    """The messages of a test, by topic, as one MCAP file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'test')
        kinds = {topic: TOPICS[topic].type for topic, flow in flows.items() if flow}
        with BagWriter(path, kinds, facts.as_text()) as bag:
            for stamp, topic, message in heapq.merge(*(
                    [(stamp, topic, message) for stamp, message in flow]
                    for topic, flow in flows.items())):
                bag.write_message(topic, stamp, message)
        return next(path.glob('*.mcap')).read_bytes()
