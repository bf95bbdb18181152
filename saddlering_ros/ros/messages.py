"""Messages of the suite made from values, and read: parameters, causes, alarm, progress, time."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
import math
from typing import Any, TYPE_CHECKING

from builtin_interfaces.msg import Time
import numpy as np

from saddlering_interfaces import msg
from saddlering_ros.errors import did_you_mean
from saddlering_ros.record.batches import SECOND
from saddlering_ros.rig import ContactParameters, PARAMETER_NAMES, ParameterSet, ParameterSource
from saddlering_ros.rig.parameter_file import Effects
from saddlering_ros.ros import names
from saddlering_ros.ros.names import LIVE_PAGE, NodeError
from saddlering_ros.ros.raw_topics import RawPublisher, RawSubscription

if TYPE_CHECKING:  # Their modules import SciPy and Numba, which half of the nodes do not need.
    from saddlering_ros.monitoring.expected import Expected
    from saddlering_ros.monitoring.monitor import Monitor

FIELDS = ('k1', 'n1', 'd1', 'k2', 'n2', 'd2')
"""Fields of RingParameters in the order of ContactParameters."""


def parameters_to_message(parameters: ParameterSet, stamp: Time) -> msg.RingParameters:
    """A RingParameters message of `parameters`."""
    source = parameters.source
    words = f'{source.method} from {", ".join(source.bags)}' if source.bags else source.method
    message = msg.RingParameters(
        source=f'{words} ({source.note})' if source.note else words, rig_hash=source.rig_hash)
    message.header.stamp = stamp
    for name, value in zip(FIELDS, parameters.contact.to_array().tolist(), strict=True):
        setattr(message, name, value)
    if source.bags or source.undetermined:
        message.determined = [name not in source.undetermined for name in PARAMETER_NAMES]
    if source.covariance is not None:
        message.covariance = [float(value) for value in np.ravel(source.covariance)]
    for effect, values in parameters.effects.items():
        for name, value in values.items():
            message.effect_parameter_names.append(f'{effect}.{name}')
            message.effect_parameter_values.append(float(value))
    return message


def parameters_from_message(message: msg.RingParameters) -> ParameterSet:
    """The ParameterSet of a message; SaddleringError for an entry that cannot be used."""
    values = [float(getattr(message, name)) for name in FIELDS]
    if not np.isfinite(values).all():
        raise NodeError('/ring/parameters: a contact parameter is not finite: publish six numbers')
    covariance = np.array(message.covariance, dtype=np.float64)
    if covariance.size not in (0, 36):
        raise NodeError(f'/ring/parameters: covariance has {covariance.size} numbers: '
                        'give 36 or none')
    undetermined = [name for name, is_determined in zip(
        PARAMETER_NAMES, message.determined, strict=True) if not is_determined]
    if len(undetermined) == len(PARAMETER_NAMES):  # The field was not filled.
        undetermined = []
    source = ParameterSource(method='message', note=str(message.source),
                             undetermined=dict.fromkeys(undetermined, 'by its identification'),
                             covariance=covariance.reshape(6, 6) if covariance.size else None,
                             rig_hash=str(message.rig_hash))
    names, numbers = message.effect_parameter_names, message.effect_parameter_values
    if len(names) != len(numbers):
        raise NodeError(f'/ring/parameters: {len(names)} effect parameters have {len(numbers)} '
                        'values: give one each')
    effects: Effects = {}
    for name, value in zip(names, numbers, strict=True):
        effect, dot, parameter = name.partition('.')
        if not dot or not np.isfinite(value):
            raise NodeError(f'/ring/parameters: effect parameter {name!r} = {value}: give '
                            'effect.parameter and a finite number')
        effects.setdefault(effect, {})[parameter] = float(value)
    return ParameterSet(ContactParameters(*values), effects, source)


def fill_diagnosis(result: Any, document: Mapping[str, Any]) -> None:
    """Put a verdict document into the fields of a DiagnoseRing result; NaN for null."""
    result.verdict = document['verdict']
    for cause in document['causes']:
        if 'effect' not in cause:
            continue
        parameters, gain = cause['parameters'].values(), _numbers(cause['gain'], 'fit', 'held_out')
        ends = [item['interval'] or [item['value']] * 2 for item in parameters]
        result.causes.append(msg.DiagnosedCause(
            effect=cause['effect'], group=list(cause['group']),
            parameter_names=list(cause['parameters']), units=[item['unit'] for item in parameters],
            values=[item['value'] for item in parameters],
            stds=[_numbers(item, 'std')['std'] for item in parameters],
            lower=[low for low, _ in ends], upper=[high for _, high in ends],
            **_numbers(cause['evidence'], 'p_value', 'delta_bic'),
            misfit_reduction_fit=gain['fit'], misfit_reduction_held_out=gain['held_out']))
    result.next_test = document.get('next_test') or ''
    result.headline = document.get('headline') or ''
    result.complete = bool(document.get('complete'))
    result.stability = _numbers(document, 'stability')['stability']
    probabilities = document.get('probabilities') or {}
    result.outcomes = list(probabilities)
    result.probabilities = list(_numbers(probabilities, *probabilities).values())
    result.near_limit = list(document.get('near_limit') or ())
    for name, kind in _LISTED.items():
        setattr(result, name, [_filled(kind, entry) for entry in document.get(name) or ()])


_LISTED = {
    'remainder': msg.DiagnosisRemainder, 'detection_limits': msg.DetectionLimit,
    'candidates': msg.DiagnosisCandidate, 'refits': msg.DiagnosisRefit,
    'influence': msg.DiagnosisInfluence, 'held_out_evidence': msg.DiagnosisHeldOut}
"""Lists of the document whose entries have the fields of these messages."""


def _filled(kind: Any, values: Mapping[str, Any]) -> Any:
    """A message of `kind` with these values; null: NaN, or else nothing."""
    message = kind()
    for name in message.get_fields_and_field_types():
        value, make = values.get(name), type(getattr(message, name))
        if value is not None or make is float:
            setattr(message, name, make(math.nan if value is None else value))
    return message


def _numbers(values: Mapping[str, float | None], *names: str) -> dict[str, float]:
    """Some of these values; NaN for null."""
    given = {name: values.get(name) for name in names}
    return {name: math.nan if value is None else float(value) for name, value in given.items()}


def alarm_message(monitor: 'Monitor', words: str, frame_id: str) -> msg.RingAlarm:
    """The message of ring/alarm for a monitor whose state is `words`."""
    message = msg.RingAlarm(
        state=monitor.state, message=words, log_threshold=monitor.log_threshold,
        log_evidence=monitor.log_evidence, materiality=monitor.materiality,
        false_alarm_hours=monitor.settings.false_alarm_hours,
        lapses=[f'{1e-9 * lapse.stamp:.3f} s: {lapse.reason}' for lapse in monitor.lapses])
    message.header.stamp, message.header.frame_id = to_time(monitor.stamp), frame_id
    alarm = monitor.alarm
    if alarm is not None:
        message.channel, message.size, message.follows = alarm.channel, alarm.size, alarm.follows
        message.since, message.raised = to_time(alarm.since), to_time(alarm.stamp)
        message.first_guess, message.log_evidence = alarm.first_guess, alarm.evidence
    return message


def expected_message(expected: 'Expected', stamp: int, load: float, parameters: msg.RingParameters,
                     frame_id: str) -> msg.RingExpected:
    """The message of ring/expected at the stamp [ns] of a load [N]."""
    x, y, gamma = expected.motion.tolist()
    x_by_load, y_by_load, gamma_by_load = expected.by_load.tolist()
    message = msg.RingExpected(
        load=load, delta_x=x, delta_y=y, gamma=gamma, delta_x_by_load=x_by_load,
        delta_y_by_load=y_by_load, gamma_by_load=gamma_by_load, parameters=parameters,
        covariance=expected.covariance.ravel(), validity=expected.validity)
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    return message


def to_time(stamp: int) -> Time:
    """A time message from nanoseconds."""
    second, nanosecond = divmod(int(stamp), SECOND)
    return Time(sec=second, nanosec=nanosecond)


def to_stamp(time: Time) -> int:
    """Nanoseconds from a time message."""
    return int(time.sec) * SECOND + int(time.nanosec)


def progress_of(node: str, subscriptions: list[RawSubscription], publishers: list[RawPublisher],
                replayed_until: int = 0) -> msg.ReplayProgress:
    """Report of a node with these flows."""
    return msg.ReplayProgress(node=node, replayed_until=to_time(replayed_until),
                              inputs=[flow.topic for flow in subscriptions],
                              input_stamps=[to_time(flow.last_stamp) for flow in subscriptions],
                              received=[flow.received for flow in subscriptions],
                              publishers=[flow.publishers() for flow in subscriptions],
                              outputs=[flow.topic for flow in publishers],
                              output_stamps=[to_time(flow.last_stamp) for flow in publishers],
                              published=[flow.published for flow in publishers],
                              subscriptions=[flow.subscriptions() for flow in publishers])


MAX_SPECTATORS = 8
"""Live pages that are waited for at once; strangers cannot make the list grow."""
SPECTATOR_LEASE = 10.0
"""A spectator that has not reported for so long [s] is gone; one that leaves says so. A busy
machine has kept a page from reporting for several seconds while a browser loaded it."""

REPORTING_NODES = names.names(names.REPLAY, names.RING, names.ALARM)
SILENT_NODES = names.names(names.TIME, names.ACTION)
"""Nodes of the suite that report their progress, and that do not."""


class LockstepGroup:
    """The nodes a replay waits for, and the last report of each.

    A node owes nothing on a topic until it has received its first message there, so that one
    that joins late does not stop the replay; who was matched with all at the start owes all from
    there on (`begin`). Spectators are live pages: the replay waits for them a while at its start,
    lets them catch up before the queues lose messages, and at its end.
    """

    def __init__(self, participants: list[str]) -> None:
        for name in participants:
            if '/' in name or name in SILENT_NODES:
                raise NodeError(f'replay_clock: parameter participants has {name!r}, which never '
                                'reports progress: give names of nodes without namespace, such '
                                f'as {", ".join(REPORTING_NODES)}')
        self.names = participants
        self.malformed = 0
        self.said: dict[str, msg.ReplayProgress] = {}
        self.heard: dict[str, float] = {}
        self.excused: set[str] = set()
        self._owing: set[str] = set()
        self._start = 0

    def begin(self, start: int) -> None:
        """All are matched, and the replay begins behind `start` [ns]."""
        self._owing, self._start = set(self.said), start

    def hear(self, message: msg.ReplayProgress, now: float) -> None:
        """Take a node's word at `now` [s, monotonic], unless it is malformed or another node's."""
        before = self.said.get(message.node)
        if before is None and message.node not in self.names and not (
                message.node.startswith(LIVE_PAGE)
                and len(self.said.keys() - set(self.names)) < MAX_SPECTATORS):
            return
        taken = {len(values) for values in (
            message.inputs, message.input_stamps, message.received, message.publishers)}
        given = {len(values) for values in (
            message.outputs, message.output_stamps, message.published, message.subscriptions)}
        if len(taken) > 1 or len(given) > 1:
            self.malformed += 1
            return
        if before is not None and sum(message.received) < sum(before.received):
            self._owing.discard(message.node)  # It was started anew.
        self.said[message.node], self.heard[message.node] = message, now

    def absent(self) -> list[str]:
        """Participants that sent nothing yet, or are not matched with the others, in words."""
        reasons = [
            f'{name}: nothing received'
            + ('' if name in REPORTING_NODES else did_you_mean(name, REPORTING_NODES))
            for name in self.names if name not in self.said]
        if reasons:
            return reasons
        nodes = [self.said[name] for name in self.names]
        readers = Counter(topic for said in nodes for topic in said.inputs)
        return [reason for said in nodes
                for reason in self._unmatched(said, readers.__getitem__)[:1]]

    def unmatched_readers(self, readers: Callable[[str], int], pages: int, now: float,
                          ) -> list[str]:
        """Readers besides those waited for that would miss the first messages, in words.

        readers: how many readers a topic has; pages: how many live pages there are.
        """
        watching = self._watching(now)
        nodes = [self.said[name] for name in self.names if name in self.said]
        absent = ['the live page: nothing received'] if pages > len(watching) else []
        known = Counter(topic for said in (*nodes, *watching) for topic in said.inputs)
        return absent + [reason for said in (*nodes, *watching) for reason in self._unmatched(
            said, lambda topic: max(readers(topic), known[topic]))]

    def _unmatched(self, said: msg.ReplayProgress, readers: Callable[[str], int]) -> list[str]:
        """Topics on which a node is not connected with all others, in words."""
        who = said.node if said.node in self.names else 'the live page'
        writers = {topic for other in self.said.values() for topic in other.outputs}
        return [
            *(f'{who}: is not connected to the publisher of {topic}'
              for topic, count in zip(said.inputs, said.publishers, strict=True)
              if topic in writers and not count),
            *(f'{who}: {topic} is connected to {count} of {readers(topic)} readers'
              for topic, count in zip(said.outputs, said.subscriptions, strict=True)
              if count < readers(topic))]

    def behind(self, until: int) -> list[str]:
        """Who has not caught up with the replay at `until` [ns], in words."""
        present = [self.said[name] for name in self.names
                   if name in self.said and name not in self.excused]
        last, reasons = _last_stamps(present), []
        for said in present:
            replayed = to_stamp(said.replayed_until)
            if replayed not in (0, until):
                reasons.append(f'{said.node}: ' + (
                    'has not received the clock yet' if replayed == 1 else
                    f'has {(until - replayed) / 1e9:.3f} s left to publish'))
                continue
            for topic, lag, _ in self._lags(said, last)[:1]:
                reasons.append(f'{said.node}: is {lag / 1e9:.3f} s behind on {topic}')
        return reasons

    def spectators_lag(self, now: float) -> int:
        """How far [ns] the spectator that is furthest behind is behind what was published."""
        last = _last_stamps(self.said.values())
        return max((lag for said in self._watching(now)
                    for _, lag, publishers in self._lags(said, last) if publishers), default=0)

    def _watching(self, now: float) -> list[msg.ReplayProgress]:
        """The last reports of the live pages that are there."""
        return [said for name, said in self.said.items() if name not in self.names
                and said.inputs and now - self.heard[name] < SPECTATOR_LEASE]

    def _lags(self, said: msg.ReplayProgress, last: Mapping[str, int],
              ) -> list[tuple[str, int, int]]:
        """Topics on which a node is behind, by how much [ns], and how many publishers it knows."""
        lags = []
        for topic, time, publishers in zip(
                said.inputs, said.input_stamps, said.publishers, strict=True):
            stamp = to_stamp(time)
            if stamp != last.get(topic, stamp) and (stamp or said.node in self._owing):
                lags.append((topic, last[topic] - (stamp or self._start), publishers))
        return lags


def _last_stamps(writers: Iterable[msg.ReplayProgress]) -> dict[str, int]:
    """By topic the stamp [ns] of the last message that one of them published."""
    return {topic: stamp for said in writers
            for topic, time in zip(said.outputs, said.output_stamps, strict=True)
            if (stamp := to_stamp(time))}
