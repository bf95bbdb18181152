"""The state of a monitor, as a message."""

from __future__ import annotations

from saddlering_interfaces.msg import RingAlarm
from saddlering_ros.monitoring import Monitor
from saddlering_ros.ros.lockstep import to_time


def alarm_message(monitor: Monitor, words: str, frame_id: str) -> RingAlarm:
    """The message of ring/alarm for a monitor whose state is `words`."""
    message = RingAlarm(
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
