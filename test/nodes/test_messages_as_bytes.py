"""Batches of CDR bytes say what the message classes say."""

from dataclasses import fields
import subprocess
import sys

from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Range

from saddlering_interfaces.msg import RingDisplacement
from saddlering_ros.bags import wire
from saddlering_ros.bags.wire import decode_displacements, decode_samples, encode_samples
from saddlering_ros.record.batches import Displacements, join, Samples
from saddlering_ros.record.topics import LOAD, PROBES

STAMPS = np.array([1_700_000_000_123_456_789, 1_700_000_001_999_999_999, -5], dtype=np.int64)
VALUES = np.array([1.25e5, -3.5, 0.1])
FRAMES = ['', 'a', 'hydraulic_cylinder', 'eddy_current_1', 'x' * 97]


def stamp_of(time: Time) -> int:
    return time.sec * 10**9 + time.nanosec


@pytest.mark.parametrize('frame', FRAMES)
def test_loads_are_read_by_ros_as_written(frame: str) -> None:
    for raw, stamp, value in zip(encode_samples(Samples(STAMPS, VALUES), LOAD, frame), STAMPS,
                                 VALUES, strict=True):
        message = deserialize_message(raw, WrenchStamped)
        assert message.header.frame_id == frame
        assert stamp_of(message.header.stamp) == stamp
        assert message.wrench.force.x == value
        assert (message.wrench.force.y, message.wrench.torque.z) == (0.0, 0.0)


@pytest.mark.parametrize('frame', FRAMES)
def test_gaps_are_read_by_ros_as_written_and_back(frame: str) -> None:
    samples = Samples(STAMPS, VALUES.astype(np.float32).astype(float), 0.0, 2.0)
    messages = encode_samples(samples, PROBES[0], frame)
    for raw, stamp, value in zip(messages, STAMPS, samples.values, strict=True):
        message = deserialize_message(raw, Range)
        assert (message.header.frame_id, message.range) == (frame, value)
        assert stamp_of(message.header.stamp) == stamp
        assert (message.min_range, message.max_range) == (0.0, 2.0)
    again = decode_samples(messages, PROBES[0])
    assert np.array_equal(again.stamps, STAMPS)
    assert np.array_equal(again.values, samples.values)
    assert (again.low, again.high) == (0.0, 2.0)


@pytest.mark.parametrize('frame', FRAMES)
def test_displacements_are_the_same_bytes_a_message_has(frame: str) -> None:
    batch = Displacements(STAMPS, np.arange(12.0).reshape(4, 3) / 7.0, STAMPS[::-1], VALUES,
                          np.array([0.5, -0.1, 1.0]), np.array([0, 3, 16], np.uint8),
                          np.zeros(3))
    messages = wire.encode_displacements(batch, frame)
    for index, raw in enumerate(messages):
        message = deserialize_message(raw, RingDisplacement)
        assert message.header.frame_id == frame
        assert stamp_of(message.zero_stamp) == batch.zero_stamps[index]
        assert message.zero_load == batch.zero_loads[index]
        assert (message.elevation, message.validity) == (
            batch.elevations[index], batch.validity[index])
        given = (message.delta_x, message.delta_y, message.gamma, message.parity)
        assert given == tuple(batch.channels[:, index])
    again = decode_displacements([
        serialize_message(deserialize_message(raw, RingDisplacement)) for raw in messages])
    assert np.array_equal(again.channels, batch.channels)
    assert np.array_equal(again.zero_stamps, batch.zero_stamps)
    assert np.array_equal(again.elevations, batch.elevations)
    assert np.array_equal(again.validity, batch.validity)


def test_few_messages_are_read_and_written_as_many_are() -> None:
    count = 24
    values = np.random.default_rng(0).normal(size=(6, count))
    batch = Displacements(STAMPS[0] + np.arange(count), values[:4], STAMPS[1] + np.arange(count),
                          values[4], values[5], np.arange(count, dtype=np.uint8),
                          np.zeros(count))
    many = wire.encode_displacements(batch, 'ring')
    few = [wire.encode_displacements(batch.pick(np.array([row])), 'ring')[0]
           for row in range(count)]
    assert many == few
    swapped = [swap(message) for message in many]
    for messages in (many, swapped):
        whole = decode_displacements(messages)
        parts = join([decode_displacements(messages[row:row + 2]) for row in range(0, count, 2)])
        for one in (whole, parts):
            for field in fields(Displacements):
                assert np.array_equal(getattr(one, field.name), getattr(batch, field.name))
    gaps = Samples(batch.stamps, np.float64(np.float32(values[0])), -1.0, 0.1)
    messages = encode_samples(gaps, PROBES[0])
    assert messages[:2] == encode_samples(
        Samples(gaps.stamps[:2], gaps.values[:2], -1.0, 0.1), PROBES[0])
    assert np.array_equal(decode_samples(messages[:2], PROBES[0]).values, gaps.values[:2])
    assert decode_samples(messages[:2], PROBES[0]).high == decode_samples(messages, PROBES[0]).high
    absurd = Samples(STAMPS[:1], np.array([1e300]), 0.0, 1.0)
    with np.errstate(over='ignore'):
        assert decode_samples(encode_samples(absurd, PROBES[0]), PROBES[0]).values == np.inf


def swap(message: bytes) -> bytes:
    """A displacement in the frame `ring`, in the other byte order."""
    names = tuple(name for name, _ in wire.LAYOUTS[wire.DISPLACEMENT_TYPE])
    layout, other = (wire._layout(wire.DISPLACEMENT_TYPE, order, len('ring') + 1, names)
                     for order in (1, 0))
    found = np.frombuffer(message, layout)[0]
    raw = bytearray(message)
    turned = np.ndarray((1,), other, raw)
    for name in layout.names:
        turned[name] = found[name]
    turned['kind'] = 0
    return bytes(raw)


def test_messages_of_different_frames_are_read_in_their_order() -> None:
    messages = []
    for index in range(30):
        one = WrenchStamped()
        one.header.frame_id = FRAMES[index % 5]
        one.header.stamp.nanosec = index
        one.wrench.force.x = float(index)
        messages.append(serialize_message(one))
    samples = decode_samples(messages, LOAD)
    assert samples.stamps.tolist() == list(range(30))
    assert samples.values.tolist() == list(range(30))


@pytest.mark.parametrize('raw', [b'', b'\x00\x01\x00\x00', b'\x00\x01\x00\x00' + b'\xff' * 40,
                                 b'\x00\x02\x00\x00' + bytes(60),
                                 b'\x00\x01\x00\x00' + bytes(4) + b'\xff' * 4 + bytes(60)])
def test_bytes_of_something_else_are_refused(raw: bytes) -> None:
    with pytest.raises(wire.CdrError):
        decode_samples([raw], LOAD)


def test_a_node_that_decodes_a_topic_imports_no_library_of_a_file_format() -> None:
    nodes = ('ring_displacement', 'ring_simulator', 'ring_residual', 'ring_alarm')
    code = (f'import importlib, sys\nfor node in {nodes}:\n'
            '    importlib.import_module(f"saddlering_ros.nodes.{node}")\n'
            'print(*sys.modules)')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    modules = set(done.stdout.split())
    assert 'saddlering_ros.bags.wire' in modules
    assert not modules & {'mcap', 'lz4', 'zstandard', 'rosbags', 'saddlering_ros.bags.mcap_read',
                          'saddlering_ros.bags.scan'}
