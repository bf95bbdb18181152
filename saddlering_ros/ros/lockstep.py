"""Progress of a node in a replay: published on /replay/progress, judged by the clock."""

from __future__ import annotations

from builtin_interfaces.msg import Time

from saddlering_interfaces.msg import ReplayProgress
from saddlering_ros.bags.cdr import SECOND
from saddlering_ros.ros.raw_topics import RawPublisher, RawSubscription


def to_time(stamp: int) -> Time:
    """A time message from nanoseconds."""
    second, nanosecond = divmod(int(stamp), SECOND)
    return Time(sec=second, nanosec=nanosecond)


def to_stamp(time: Time) -> int:
    """Nanoseconds from a time message."""
    return int(time.sec) * SECOND + int(time.nanosec)


def progress_of(node: str, subscriptions: list[RawSubscription], publishers: list[RawPublisher],
                replayed_until: int = 0) -> ReplayProgress:
    """Report of a node with these flows."""
    message = ReplayProgress(node=node, replayed_until=to_time(replayed_until))
    message.inputs = [flow.topic for flow in subscriptions]
    message.input_stamps = [to_time(flow.last_stamp) for flow in subscriptions]
    message.received = [flow.received for flow in subscriptions]
    message.publishers = [flow.publishers() for flow in subscriptions]
    message.outputs = [flow.topic for flow in publishers]
    message.output_stamps = [to_time(flow.last_stamp) for flow in publishers]
    message.published = [flow.published for flow in publishers]
    message.subscriptions = [flow.subscriptions() for flow in publishers]
    return message


class LockstepGroup:
    """The nodes a replay waits for, and the last report of each.

    A node owes nothing on a topic until it has received its first message there, so that one
    that joins late does not stop the replay.
    """

    def __init__(self, names: list[str]) -> None:
        self.names = names
        self.malformed = 0
        self.said: dict[str, ReplayProgress] = {}
        self.heard: dict[str, float] = {}
        self.excused: set[str] = set()

    def hear(self, message: ReplayProgress, now: float) -> None:
        """Take a node's word at monotonic `now` [s].

        Reports of other nodes are not kept, nor messages whose lists differ in length.
        """
        if message.node not in self.names:
            return
        if not _is_whole(message):
            self.malformed += 1
            return
        self.said[message.node] = message
        self.heard[message.node] = now

    def absent(self) -> list[str]:
        """Participants that sent nothing yet, or are not matched with the others, in words."""
        reasons = [f'{name}: nothing received' for name in self.names if name not in self.said]
        if reasons:
            return reasons
        for name in self.names:
            reason = self._unmatched(self.said[name])
            if reason:
                reasons.append(f'{name}: {reason}')
        return reasons

    def _unmatched(self, said: ReplayProgress) -> str:
        others = [self.said[name] for name in self.names if name != said.node]
        writers = {topic for other in others for topic in other.outputs}
        for topic, count in zip(said.inputs, said.publishers, strict=True):
            if topic in writers and count == 0:
                return f'is not connected to the publisher of {topic}'
        for topic, count in zip(said.outputs, said.subscriptions, strict=True):
            readers = sum(topic in other.inputs for other in others)
            if count < readers:
                return f'{topic} is connected to {count} of {readers} readers'
        return ''

    def behind(self, until: int) -> list[str]:
        """Who has not caught up with the replay at `until` [ns], in words."""
        reasons = []
        present = [self.said[name] for name in self.names
                   if name in self.said and name not in self.excused]
        last = {}
        for said in present:
            for topic, time in zip(said.outputs, said.output_stamps, strict=True):
                if to_stamp(time):
                    last[topic] = to_stamp(time)
        for said in present:
            reason = self._lag(said, until, last)
            if reason:
                reasons.append(f'{said.node}: {reason}')
        return reasons

    def _lag(self, said: ReplayProgress, until: int, last: dict[str, int]) -> str:
        replayed = to_stamp(said.replayed_until)
        if replayed not in (0, until):
            return 'has not received the clock yet' if replayed == 1 else (
                f'has {(until - replayed) / 1e9:.3f} s left to publish')
        for topic, time in zip(said.inputs, said.input_stamps, strict=True):
            stamp = to_stamp(time)
            if stamp and topic in last and stamp != last[topic]:
                return f'is {(last[topic] - stamp) / 1e9:.3f} s behind on {topic}'
        return ''


def _is_whole(message: ReplayProgress) -> bool:
    """Whether every topic has its stamp and its counts."""
    taken, given = len(message.inputs), len(message.outputs)
    return (len(message.input_stamps) == len(message.received) == len(message.publishers) == taken
            and len(message.output_stamps) == len(message.published)
            == len(message.subscriptions) == given)
