"""Node replay_clock: the time of a replay; in lockstep it waits for every node to catch up."""

from collections.abc import Iterable
import math
from pathlib import Path
import time

import numpy as np
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import ReplayProgress, ReplayState
from saddlering_interfaces.srv import Seek, SetRate, Step
from saddlering_ros.bags.wire import encode_clock
from saddlering_ros.record.batches import SECOND
from saddlering_ros.record.scratch import blocks
from saddlering_ros.ros import launcher, names
from saddlering_ros.ros.bag_replay import BagNode
from saddlering_ros.ros.diagnostics import ERROR, FunctionTask, OK, TaskStatus, WARN
from saddlering_ros.ros.messages import LockstepGroup, to_time
from saddlering_ros.ros.names import NodeError
from saddlering_ros.ros.parameters import NodeParameter
from saddlering_ros.ros.raw_topics import CLOCK_QOS, LATCHED, RawPublisher, RawSubscription
from saddlering_ros.ros.streaming_node import executable

MESSAGES_PER_STEP = 1000
"""Of one topic in lockstep, at most: the queues of its readers hold more."""

MAX_SPECTATOR_LAG = 2
"""Steps of so many messages that a live page may be behind in lockstep."""

MAX_SPECTATOR_JUMP = 60 * SECOND
"""A live page that is further behind [ns] than this still shows another replay."""

LONGEST_REST = 0.1
"""In lockstep with a limited rate, a step takes at most this long [s]: data flow evenly."""

REPEAT = 0.05
"""Period [s] at which a standing clock repeats its time, for late joiners and lost messages."""

LONGEST_STRIDE = SECOND // 2
"""In real time the clock never skips more than this; after a pause of the machine it is late."""

LONGEST_LINGER = 5.0
"""Longest time [s] at the end in which a reader may still get the last state."""

LINGER = 0.5
"""The same [s] if all readers say that they have it; one that has just come is still found."""

LONGEST_WATCHED = 60.0
"""Longest time [s] at the end in which a live page may still receive what was published."""

HEED, LONGEST_HEED = 0.1, 2.0
"""Shortest and longest time [s] that the clock stands after it has announced its bag, until every
reader has acknowledged the announcement. A killed reader never acknowledges."""

OF_EVERY_PROGRAM, UNNAMED = 'ros_discovery_info', '_NODE_NAME_UNKNOWN_'
"""A topic that every ROS program publishes once, and the name of a node until it is known."""

WORDS = {ReplayState.WAITING: 'waiting', ReplayState.PLAYING: 'playing',
         ReplayState.PAUSED: 'paused', ReplayState.FINISHED: 'at its end'}


class ReplayClockNode(BagNode):
    """Publishes /clock over the time of a bag; it reports no progress, which it would receive."""

    TELLS_PROGRESS = False

    PARAMETERS = (
        *BagNode.PARAMETERS,
        NodeParameter('rate', 1.0, 'speed: 1 is real time; 0 is as fast as the nodes follow (in '
                      'lockstep only)', low=0.0, high=100.0),
        NodeParameter('lockstep', False, 'advance the clock only when all participants have '
                      'processed all earlier messages'),
        NodeParameter('participants', list(names.names(names.REPLAY, names.RING)),
                      'nodes for which the clock waits, before the first message and in lockstep; '
                      'nodes of your own, too, so that no name is refused as unknown'),
        NodeParameter('window', 0.2, 'longest bag time per step in lockstep [s]', low=0.001,
                      high=1.8, changeable=True),
        NodeParameter('clock_rate', 100.0, 'steps a second in real time', low=1.0, high=1000.0),
        NodeParameter('timeout', 5.0, 'a node that does not catch up within this time [s] is '
                      'reported; the clock does not wait for this node until it has caught up',
                      low=0.1, high=3600.0),
        NodeParameter('start_paused', False, 'wait for ~/play'),
        NodeParameter('elevation_deg', math.nan, 'elevation of the test [deg], in place of that '
                      'of the bag; nan: that of the bag', low=-10.0, high=90.0, nan_allowed=True),
        NodeParameter('exit_at_end', False, 'exit at the end of the bag'),
    )

    def __init__(self) -> None:
        super().__init__('replay_clock')
        self.offer(Trigger, '~/play', self._on_play)
        self.offer(Trigger, '~/pause', self._on_pause)
        self.offer(SetRate, '~/set_rate', self._on_set_rate)
        self.offer(Seek, '~/seek', self._on_seek)
        self.offer(Step, '~/step', self._on_step)
        self._state_publisher = self.create_publisher(ReplayState, names.STATE, LATCHED)

    def configure(self) -> None:
        record = self.read_record()
        self._start, self._end = record.start - 1, record.stop
        self._limit = shortest_time_of(MESSAGES_PER_STEP, [record[name].stamps for name in record])
        self._bag = str(record.path)
        given, stated = self.settings['elevation_deg'], record.facts.elevation_deg
        self._elevation = math.radians(
            stated if math.isnan(given) and stated is not None else given)
        self._time = self._start
        self._rate = self.settings['rate']
        self._lockstep = self.settings['lockstep']
        if self._rate == 0.0 and not self._lockstep:
            raise NodeError('replay_clock: rate is 0 (as fast as the nodes follow), which needs '
                            'lockstep: give lockstep:=true too, or a rate above 0')
        self._group = LockstepGroup([name for name in self.settings['participants'] if name])
        self._state = ReplayState.WAITING
        self._after_waiting = (ReplayState.PAUSED if self.settings['start_paused']
                               else ReplayState.PLAYING)
        self._stop_at: int | None = None
        self._waiting_for: list[str] = []
        self._began = self._advanced = self._said = time.monotonic()
        self._said_state = 0.0
        self._timeouts, self._speed = 0, 0.0
        self._speed_from = (time.monotonic(), self._time)
        self.tasks = [FunctionTask('replay', self._task_status), self._agreement]

    def connect(self) -> None:
        self._heard = RawSubscription(self, names.PROGRESS, ReplayProgress, reliability='reliable',
                                      depth=1000)
        self.inputs = [self._heard]
        self.outputs = [RawPublisher(self, names.CLOCK, Clock, CLOCK_QOS)]
        self._began = time.monotonic()
        self._say_state(self._began)

    def process_batch(self) -> None:
        """Take reports of the participants, and advance the time at once if they allow it."""
        now = time.monotonic()
        for report in self._heard.take_each(lambda raw: deserialize_message(raw, ReplayProgress)):
            self._group.hear(report, now)
        self.at_intervals(now)

    def at_intervals(self, now: float) -> float:
        if self._state == ReplayState.WAITING:
            self._wait(now)
        elif self._state == ReplayState.PLAYING and self._lockstep:
            self._play_in_step(now)
        elif self._state == ReplayState.PLAYING \
                and now - self._advanced >= 0.99 / self.settings['clock_rate']:
            stride = round((now - self._advanced) * self._rate * SECOND)
            self._advance(min(stride, LONGEST_STRIDE), now)
        if now - self._said >= REPEAT:
            self._say_time(now)
        if now - self._said_state >= 1.0:
            self._say_state(now)
        if self._state == ReplayState.FINISHED and self.settings['exit_at_end']:
            # Leave when all have the last state, after the clock has stood at its end for a while.
            stood = now - self._advanced
            if stood >= LONGEST_WATCHED or self._group.spectators_lag(time.monotonic()) <= 0:
                self.done = stood > LONGEST_LINGER or (stood > LINGER and bool(
                    self._state_publisher.wait_for_all_acked(Duration(seconds=0))))
        if self._state != ReplayState.PLAYING:
            return REPEAT
        return 0.002 if self._lockstep else 1.0 / self.settings['clock_rate']

    # --- time ---

    def _window(self) -> int:
        """Bag time per step in lockstep [ns]; may be set while the node runs."""
        seconds = self.settings['window']
        if self._rate:
            seconds = min(seconds, self._rate * LONGEST_REST)
        return min(max(1, round(seconds * SECOND)), self._limit)

    def _wait(self, now: float) -> None:
        self._waiting_for = absent = self._group.absent()
        stood = now - self._began
        if stood < HEED or (stood < LONGEST_HEED and not (
                self._state_publisher.wait_for_all_acked(Duration(seconds=0)))):
            return  # so that every node has received the bag and its elevation
        if not absent:
            # Readers besides the participants that would miss the first messages. A clock that
            # has just started finds a page that was there before within 0.03 s, or within 0.6 s.
            # Until then it knows nothing of it, but the machine knows how many programs it has.
            found = len(self.get_publishers_info_by_topic(OF_EVERY_PROGRAM, no_mangle=True))
            hidden = launcher.participants(self.context.get_domain_id()) - found
            pages = sum(one.node_name in (names.LIVE_PAGE, UNNAMED)
                        for one in self.get_publishers_info_by_topic(self._heard.topic))
            self._waiting_for = (
                [f'other programs of its domain: {hidden} not found yet'] if hidden > 0 else []
            ) + self._group.unmatched_readers(self.count_subscribers, pages, now)
        if not self._waiting_for:
            self._group.begin(self._start)
            self._enter(self._after_waiting, now)
        elif now - self._began > self.settings['timeout']:
            words = '; '.join(self._waiting_for)
            if absent and self._lockstep:
                self._began = now
                self.get_logger().warning(f'still waits for {words}')
            else:
                self.get_logger().warning(f'starts without {words}')
                self._enter(self._after_waiting, now)

    def _play_in_step(self, now: float) -> None:
        group = self._group
        behind = self._waiting_for = group.behind(self._time)
        if behind:
            if now - self._advanced > self.settings['timeout']:
                self._timeouts += 1
                self.get_logger().error(f'no longer waits for {"; ".join(behind)} '
                                        f'(after {self.settings["timeout"]:g} s)')
                group.excused |= {reason.partition(':')[0] for reason in behind}
            return
        lag = group.spectators_lag(now)
        if MAX_SPECTATOR_LAG * self._limit < lag < MAX_SPECTATOR_JUMP:
            self._waiting_for = [f'the live page: is {lag / 1e9:.3f} s behind']
            return
        if group.excused:  # Wait again for nodes that had fallen behind and are in step.
            excused, group.excused = group.excused, set()
            late = {reason.partition(':')[0] for reason in group.behind(self._time)}
            group.excused = {name for name in excused
                             if name in late or now - group.heard.get(name, 0.0) > 1.0}
        window = self._window()
        if not self._rate or now - self._advanced >= window / (self._rate * SECOND):
            self._advance(window, now)

    def _advance(self, stride: int, now: float) -> None:
        if self._time >= self._end:
            self._enter(ReplayState.FINISHED, now)
            return
        self._time = min(self._time + stride, self._end)
        if self._stop_at is not None and self._time >= self._stop_at:
            self._time = min(self._stop_at, self._end)
            self._stop_at = None
            self._enter(ReplayState.PAUSED, now)
        self._advanced = now
        self._say_time(now)

    def _enter(self, state: int, now: float) -> None:
        self._state = state
        self._advanced = now
        if state != ReplayState.WAITING:
            self._waiting_for = []
        left = sorted(self._group.excused) if state == ReplayState.FINISHED else []
        self.get_logger().info(f'replay is {WORDS[state]}, at '
                               f'{(self._time - self._start) / 1e9:.3f} s'
                               + (f', without {", ".join(left)}' if left else ''))
        self._say_state(now)

    def _say_time(self, now: float) -> None:
        self._said = now
        if self.outputs:
            self.outputs[0].send([encode_clock(self._time)], self._time)

    def _say_state(self, now: float) -> None:
        before, place = self._speed_from
        if now - before > 0.5:
            self._speed = (self._time - place) / 1e9 / (now - before)
            self._speed_from = (now, self._time)
        self._said_state = now
        self._state_publisher.publish(ReplayState(
            state=self._state, now=to_time(self._time), start=to_time(self._start),
            end=to_time(self._end), rate=self._rate, speed=max(0.0, self._speed),
            waiting_for=self._waiting_for, bag=self._bag, elevation=self._elevation))

    # --- services ---

    def _on_play(self, _: Trigger.Request) -> str:
        self._stop_at = None
        if self._state == ReplayState.PAUSED and self._time == self._start:
            self._began = time.monotonic() - HEED  # A live page may have come meanwhile.
            self._enter(ReplayState.WAITING, time.monotonic())
        if self._state == ReplayState.WAITING:
            self._after_waiting = ReplayState.PLAYING
            return 'plays when everyone is there'
        if self._time >= self._end:
            raise NodeError('the bag is at its end: seek first')
        self._enter(ReplayState.PLAYING, time.monotonic())
        return 'plays'

    def _on_pause(self, _: Trigger.Request) -> str:
        if self._state == ReplayState.WAITING:
            self._after_waiting = ReplayState.PAUSED
        elif self._state == ReplayState.PLAYING:
            self._enter(ReplayState.PAUSED, time.monotonic())
        return f'{WORDS[self._state]}, at {(self._time - self._start) / 1e9:.3f} s'

    def _on_set_rate(self, request: SetRate.Request) -> str:
        if not 0.0 <= request.rate <= 100.0 or (request.rate == 0.0 and not self._lockstep):
            raise NodeError(f'rate is {request.rate:g}: give a number above 0 and up to 100'
                            + (', or 0 for no limit' if self._lockstep else ''))
        self._rate = request.rate
        return f'rate is {request.rate:g}'

    def _on_seek(self, request: Seek.Request) -> str:
        length = (self._end - self._start) / 1e9
        if not 0.0 <= request.offset <= length:
            raise NodeError(f'offset is {request.offset:g} s: give 0 to {length:.3f}')
        self._time = self._start + round(request.offset * SECOND)
        now = time.monotonic()
        if self._state == ReplayState.FINISHED:
            self._enter(ReplayState.PAUSED, now)
        self._advanced = now
        self._speed_from = (now, self._time)
        self._say_time(now)
        return f'{WORDS[self._state]}, at {request.offset:.3f} s'

    def _on_step(self, request: Step.Request) -> str:
        if self._state != ReplayState.PAUSED or self._time >= self._end:
            raise NodeError(f'the replay is {WORDS[self._state]}: pause first')
        if not 0.0 <= request.duration < 1e6:
            raise NodeError(f'duration is {request.duration:g} s: give 0 or more')
        self._stop_at = self._time + (round(request.duration * SECOND) or self._window())
        self._enter(ReplayState.PLAYING, time.monotonic())
        return f'goes on to {(self._stop_at - self._start) / 1e9:.3f} s'

    def _task_status(self) -> TaskStatus:
        figures = {'time [s]': f'{(self._time - self._start) / 1e9:.3f}',
                   'length [s]': f'{(self._end - self._start) / 1e9:.3f}',
                   'rate': f'{self._rate:g}', 'speed': f'{max(0.0, self._speed):.2f}',
                   'malformed progress': str(
                       self._group.malformed + sum(flow.malformed for flow in self.inputs)),
                   'time-outs': str(self._timeouts),
                   'bag': Path(self._bag).name}
        if self._group.excused and self._lockstep:
            left = ', '.join(sorted(self._group.excused))
            return TaskStatus(ERROR, f'continues without {left}, which fell behind', figures)
        late = time.monotonic() - self._advanced > 1.0
        if self._waiting_for and (late or self._state == ReplayState.WAITING):
            return TaskStatus(WARN, f'waits for {"; ".join(self._waiting_for)}', figures)
        return TaskStatus(OK, WORDS[self._state], figures)


def shortest_time_of(count: int, topics: Iterable[np.ndarray]) -> int:
    """Shortest time [ns], at least 1 ms, of `count` messages; topics: stamps (N,) [ns] of each."""
    spans = [int((stamps[rows.start + count:rows.stop + count] - stamps[rows]).min())
             for stamps in topics for rows in blocks(len(stamps) - count, stamps)]
    return max(SECOND // 1000, min(spans, default=3600 * SECOND))


main = executable(ReplayClockNode)

if __name__ == '__main__':
    main()
