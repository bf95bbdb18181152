"""The health of a node: small tasks, each of which watches one property."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
import time
from typing import Any, ClassVar, Protocol

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node

from saddlering_ros.doubts.driver import delay_of, shared_words
from saddlering_ros.doubts.readings import block_words
from saddlering_ros.doubts.units import AT_END, unit_outside
from saddlering_ros.errors import counted, counted_name
from saddlering_ros.record.batches import GAP_FLOOR_NS, GAP_PERIODS, SECOND
from saddlering_ros.record.quality import between_blocks
from saddlering_ros.ros.parameters import HARDWARE_ID

OK, WARN, ERROR, STALE = 0, 1, 2, 3

STATE_TASK, ACTIVE = 'state', 'active'
"""The status of every lifecycle node by which others know that it is active."""

ENOUGH_INTERVALS = 8
"""So many intervals of one period have a median of their own."""

MIN_BLOCKS = 3
"""So many equal blocks of one period show that stamps come in blocks."""


@dataclass(frozen=True)
class TaskStatus:
    """Status of a task: level (OK, WARN, ERROR, STALE), words, figures."""

    level: int
    words: str
    figures: dict[str, str] = field(default_factory=dict)


class Task(Protocol):
    """One thing watched; `report` is asked once a second and starts the next period."""

    name: str

    def report(self, elapsed: float) -> TaskStatus:
        """Status of the last `elapsed` seconds."""


class Kept:
    """Numbers of many small batches, judged once a period: to judge each batch costs as much."""

    NONE: ClassVar[NDArray[Any]] = np.empty(0)

    def __init__(self) -> None:
        self._batches: list[NDArray[Any]] = []

    def push(self, batch: NDArray[Any]) -> None:
        """Keep a batch (N, ...)."""
        if len(batch):
            self._batches.append(batch)

    def taken(self) -> NDArray[Any]:
        """All that was pushed since the last call, in order of arrival."""
        batches, self._batches = self._batches, []
        return np.concatenate([self.NONE, *batches])


class StreamTask(Kept):
    """Rate and gaps of one topic, by the stamps [ns] that are pushed; silence is STALE.

    A gap is an interval over GAP_FLOOR_NS and over GAP_PERIODS times the median interval: of the
    period if it has enough, else of those before. A step back is a message late, or a jump.
    Stamps that are not set are left out. delay: from stamp to arrival in the last period [s].
    last: the newest stamp, if any. source: the topic after a remapping or in a namespace.
    """

    NONE = np.empty(0, np.int64)

    def __init__(self, topic: str, *, lowest_rate: float = 0.0) -> None:
        super().__init__()
        self.topic, self.source, self.name = topic, topic, f'stream {topic}'
        self.lowest_rate = lowest_rate
        self.delay = math.nan
        self._arrivals: list[int] = []
        self.total = self.gaps = self.late = 0
        self._median = math.nan
        self.last = self.NONE

    def push(self, batch: NDArray[Any]) -> None:
        """Keep the stamps (N,) of a batch that arrives now."""
        if len(batch):
            self._batches.append(batch)
            self._arrivals.append(time.time_ns())

    def report(self, elapsed: float) -> TaskStatus:
        """Rate (by arrival), period (by stamps), gaps and late messages of the period."""
        arrivals = np.repeat(np.array(self._arrivals, np.int64), list(map(len, self._batches)))
        self._arrivals, stamps = [], self.taken()
        are_set = stamps > 0
        stamps = stamps[are_set]
        self.delay = delay_of(stamps, arrivals[are_set])
        steps = np.diff(np.append(self.last, stamps)) / 1e9
        self.last = np.append(self.last, stamps)[-1:]
        forward = steps[steps > 0.0]
        long, pause, are_blocks = forward[:0], 0.0, False
        if len(forward):
            middle = float(np.median(forward))
            are_enough = math.isnan(self._median) or len(forward) >= ENOUGH_INTERVALS
            limit = max(GAP_FLOOR_NS / SECOND,
                        GAP_PERIODS * (middle if are_enough else self._median))
            long = forward[forward > limit]
            pause, are_blocks = between_blocks(forward, middle, MIN_BLOCKS)
            self._median = middle if are_enough else 0.9 * self._median + 0.1 * middle
        late, longest = int((steps < 0.0).sum()), float(long.max(initial=0.0))
        rate = len(stamps) / elapsed if elapsed > 0.0 else 0.0
        self.total += len(stamps)
        self.gaps += len(long)
        self.late += late
        figures = {
            'rate [1/s]': f'{rate:.1f}', 'period by stamps [ms]': f'{self._median * 1e3:.4g}',
            'messages': str(self.total), 'gaps': str(self.gaps), 'late': str(self.late),
            'longest gap of this period [s]': f'{longest:.4g}'}
        level, words = WARN, f'{counted(round(rate), "message")} a second'
        if not len(stamps):
            level, words = STALE, 'no messages' if self.total else 'nothing received yet'
            words += '' if self.source == self.topic else f' on {self.source}'
        elif shared := shared_words(steps):
            words = shared
        elif are_blocks:
            words = f'stamps {block_words(pause)}'
        elif len(long):
            words = f'{counted(len(long), "gap")} in the stamps, longest {longest:.3g} s'
        elif late:
            words = f'{counted(late, "message")} out of order or stamps that jumped back'
        elif rate < self.lowest_rate:
            words = f'{rate:.1f} messages a second, and at least {self.lowest_rate:g} are required'
        else:
            level = OK
        return TaskStatus(level, words, figures)


SILENT_PERIODS = 2
"""Periods without a message after which a stream is silent: one begins or ends between two."""


class SilentStreams:
    """Logs once which stream falls silent while another one goes on, and its return."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._periods: dict[str, int] = {}

    def review(self, found: Iterable[tuple[Task, TaskStatus]]) -> None:
        """Log what the statuses of a period change."""
        silent = {task.source: status.level == STALE for task, status in found
                  if isinstance(task, StreamTask) and task.total}
        if all(silent.values()):  # The test is over, or not begun; a silence that was told stays.
            self._periods = {topic: periods for topic, periods in self._periods.items()
                             if periods >= SILENT_PERIODS}
            return
        for topic, is_silent in silent.items():
            before = self._periods.get(topic, 0)
            self._periods[topic] = before + 1 if is_silent else 0
            if self._periods[topic] == SILENT_PERIODS:
                self._node.get_logger().warning(
                    f'{topic}: no messages, while those of other topics come: see to its source')
            elif before >= SILENT_PERIODS and not is_silent:
                self._node.get_logger().info(f'{topic}: messages come again')


class SaturationTask(Kept):
    """Gaps [m] of a probe at or beyond the ends of its range; others than numbers do not count."""

    def __init__(self, topic: str, low: float, high: float) -> None:
        super().__init__()
        self.name = f'saturation {topic}'
        self.low, self.high = low, high
        self.total = 0

    def report(self, elapsed: float) -> TaskStatus:
        """How many readings of the period were saturated, and how near the ends they came."""
        values = self.taken()
        values = values[np.isfinite(values)]
        edge = AT_END * (self.high - self.low)
        margins = np.minimum(values - self.low, self.high - values)
        count = int((margins <= edge).sum())
        self.total += count
        figures = {'saturated': str(self.total),
                   'nearest to an end [mm]': f'{np.min(margins, initial=math.inf) * 1e3:.4g}'}
        if count:
            hint = unit_outside(values, self.low, self.high)
            return TaskStatus(ERROR, counted(count, 'reading is|readings are')
                              + f" at an end of the probe's range{hint}: check position and "
                              'unit of the probe', figures)
        return TaskStatus(OK, 'inside its range', figures)


@dataclass
class FunctionTask:
    """A task whose status a function gives."""

    name: str
    find: Callable[[], TaskStatus]

    def report(self, elapsed: float) -> TaskStatus:
        return self.find()


class Namesakes:
    """Notices nodes that have the full name of this one; logs a warning when one comes.

    They are counted by a service that every node has, because the middleware's list of names can
    keep a node that has left. One thread of the middleware reads the descriptions of nodes, and
    another one their departures. It never removes a description that it reads after the departure.
    """

    def __init__(self, node: Node) -> None:
        self._node, self._is_told = node, False

    def words(self) -> str:
        """A warning for /diagnostics while there is one; else ''."""
        own = self._node.get_fully_qualified_name()
        if self._node.count_services(f'{own}/get_parameters') < 2:
            self._is_told = False
            return ''
        words = (f'runs twice: another node named {own} is in '
                 'this ROS domain, and what they publish and serve is mixed: end one of them, or '
                 'give one a namespace (a node that was killed is forgotten within 20 s)')
        if not self._is_told:
            self._node.get_logger().warning(words)
        self._is_told = True
        return words


def sources_status(publishers: Mapping[str, int], unheard: Sequence[str] = (),
                   unmixed: Collection[str] = ()) -> TaskStatus:
    """One source of each topic that is read: two mixed sources cannot be separated.

    unheard: why nothing comes of other publishers, in words. unmixed: topics on which no two of
    the publishers send.
    """
    figures = {topic: str(count) for topic, count in publishers.items()}
    several = {topic: f'{count} publishers on {topic}' for topic, count in publishers.items()
               if count > 1}
    mixed = [words for topic, words in several.items() if topic not in unmixed]
    if mixed:
        return TaskStatus(WARN, f'{", ".join(mixed)}: their samples are mixed; '
                          'end all but one', figures)
    if unheard:
        return TaskStatus(WARN, '; '.join(unheard), figures)
    if several:
        return TaskStatus(OK, f'{", ".join(several.values())}, of which one at most sends: the '
                          'other is silent, or was killed and is forgotten within 20 s', figures)
    return TaskStatus(OK, 'one at most', figures)


class Events:
    """Counted mishaps by name; a count that grew during the period is a warning.

    places: parts of counts by name and place, a topic with the limit that was passed.
    """

    name = 'events'

    def __init__(self, source: Callable[[], dict[str, int]], harmless: Iterable[str] = (),
                 places: Callable[[], dict[tuple[str, str], int]] = dict) -> None:
        self._source, self._places = source, places
        self._harmless = frozenset(harmless)
        self._before: dict[Any, int] = {}

    def report(self, elapsed: float) -> TaskStatus:
        counts, places = self._source(), self._places()

        def grown_since(before: Mapping[Any, int]) -> str:
            where = {name: '; '.join(place for (event, place), count in places.items()
                                     if event == name and count > before.get((event, place), 0))
                     for name in counts}
            return ', '.join(
                counted_name(count - before.get(name, 0), name)
                + (f' ({where[name]})' if where[name] else '')
                for name, count in counts.items()
                if count > before.get(name, 0) and name not in self._harmless)

        grown, in_all = grown_since(self._before), grown_since({})
        self._before = {**counts, **places}
        figures = {name: str(count) for name, count in counts.items()} | {
            f'{name} on {place}': str(count) for (name, place), count in places.items() if count}
        if grown:
            return TaskStatus(WARN, grown, figures)
        earlier = f' since the last report; before, {in_all}' if in_all else ''
        return TaskStatus(OK, f'nothing lost, late or dropped{earlier}', figures)


def to_message(node: Node, statuses: Iterable[tuple[str, TaskStatus]]) -> DiagnosticArray:
    """The statuses of a node's tasks as /diagnostics wants them.

    They carry the node's full name, at the root without slash; no hardware_id: the namespace's.
    """
    namespace, given = node.get_namespace().rstrip('/'), node.get_parameter(HARDWARE_ID.name).value
    message = DiagnosticArray(status=[
        DiagnosticStatus(
            level=bytes([status.level]), message=status.words,
            name=f'{f"{namespace}/" if namespace else ""}{node.get_name()}: {name}',
            hardware_id=given.strip() or f'saddlering{namespace}',
            values=[KeyValue(key=key, value=value) for key, value in status.figures.items()])
        for name, status in statuses])
    message.header.stamp = node.get_clock().now().to_msg()
    return message
