"""Fields of the messages that are read and written as bytes, after their std_msgs/Header.

Every such message begins with a Header and continues with numbers only, so that all messages with
the same frame id have one size. The name of a field is its path in the message. Kinds are those of
NumPy.
"""

from __future__ import annotations

from saddlering_ros.record.topics import RANGE_TYPE, VECTOR_TYPE, WRENCH_TYPE

DISPLACEMENT_TYPE = 'saddlering_interfaces/msg/RingDisplacement'

Fields = tuple[tuple[str, str], ...]


def _vector(path: str) -> Fields:
    return tuple((f'{path}.{axis}', 'f8') for axis in 'xyz')


LAYOUTS: dict[str, Fields] = {
    WRENCH_TYPE: (*_vector('wrench.force'), *_vector('wrench.torque')),
    VECTOR_TYPE: _vector('vector'),
    RANGE_TYPE: (
        ('radiation_type', 'u1'), ('field_of_view', 'f4'), ('min_range', 'f4'),
        ('max_range', 'f4'), ('range', 'f4'), ('variance', 'f4')),
    DISPLACEMENT_TYPE: (
        ('delta_x', 'f8'), ('delta_y', 'f8'), ('gamma', 'f8'), ('parity', 'f8'),
        ('zero_stamp.sec', 'i4'), ('zero_stamp.nanosec', 'u4'), ('zero_load', 'f8'),
        ('elevation', 'f8'), ('validity', 'u1'), ('zero_duration', 'f8')),
}
"""Fields by message type, in the order of the message's definition."""

INFRARED = 1
"""Radiation type of sensor_msgs/Range. Of its two values, the other (ultrasound) fits less."""

DEFAULTS: dict[str, dict[str, float]] = {RANGE_TYPE: {'radiation_type': INFRARED}}
"""Fields whose default is not 0."""

_WORDS = {'f8': 'float64', 'f4': 'float32', 'u1': 'uint8', 'i4': 'int32', 'u4': 'uint32'}


def definition_lines(message_type: str, last: str) -> tuple[str, ...]:
    """The lines of a message's definition up to the field `last`, without packages.

    A nested message is one line: 'Wrench wrench' for wrench.force.x.
    """
    lines = ['Header header']
    for path, kind in LAYOUTS[message_type]:
        name, dot, _ = path.partition('.')
        line = f'{_NESTED[message_type, name]} {name}' if dot else f'{_WORDS[kind]} {name}'
        if lines[-1] != line:
            lines.append(line)
        if path == last:
            break
    return tuple(lines)


_NESTED = {(WRENCH_TYPE, 'wrench'): 'Wrench', (VECTOR_TYPE, 'vector'): 'Vector3',
           (DISPLACEMENT_TYPE, 'zero_stamp'): 'Time'}
"""Types of the fields that are messages themselves."""
