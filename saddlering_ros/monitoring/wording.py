"""The finding of a monitor in one line: for the command and the node."""

from __future__ import annotations

from saddlering_ros.monitoring.monitor import LEARNING, Monitor, Raised, WAITING
from saddlering_ros.quantities import quantity, signed

_FOLLOWS = {
    'load': 'the difference follows the load', 'time': 'the difference follows time',
    'rate': 'the difference follows the rate of the load',
    'direction': 'the difference follows the direction of the load',
    'offset': 'the difference is an offset',
    'one direction': 'the difference is an offset while the load moves in one direction',
    'unclear': 'the difference follows neither load, rate, direction nor time',
}


def size_words(alarm: Raised) -> str:
    """The size with its unit."""
    return signed(alarm.size, 'rad' if alarm.channel == 'gamma' else 'm')


def alarm_words(alarm: Raised, origin: int | None = None) -> str:
    """An alarm in one line; with seconds since `origin` [ns] where it is given."""
    delay = quantity(1e-9 * (alarm.stamp - alarm.since), 's')
    found = f'ALARM {delay} after the onset'
    if origin is not None:
        found = (f'ALARM at {1e-9 * (alarm.stamp - origin):.2f} s, onset at '
                 f'{1e-9 * (alarm.since - origin):.2f} s')
    words = (f'{found}: {alarm.channel} has differed from its model by {size_words(alarm)} in the '
             'mean since then')
    if alarm.follows:
        words += f'; {_FOLLOWS[alarm.follows]}; first guess: {alarm.first_guess}'
    return words


def state_words(monitor: Monitor) -> str:
    """The state of a monitor in one line."""
    if monitor.alarm is not None:
        return alarm_words(monitor.alarm)
    if monitor.state == WAITING:
        return 'waiting for samples'
    if monitor.state == LEARNING:
        return 'reading the noise while the load rests'
    return 'no alarm'
