"""Small tests as data, and bags of them written in every way a recorder might."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
import struct

from mcap.writer import CompressionType, IndexType, Writer
import numpy as np
import pytest
from raw_messages import cdr

from saddlering_ros.bags.write import write_bag
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, TOPICS
from saddlering_ros.rig import default_rig, Displacement, TONNE
from saddlering_ros.rig.geometry import displacement_to_probes

EPOCH = 1_700_000_000_000_000_000
PERIOD = 2_000_000


@dataclass(frozen=True)
class Recording:
    """Stamps [ns] and readings (SI) by topic, and facts: all that a bag of a test holds."""

    stamps: dict[str, np.ndarray]
    values: dict[str, np.ndarray]
    facts: dict[str, str] = field(default_factory=lambda: {
        'test': 'dynamic', 'elevation_deg': '50', 'rig': 'a rig', 'run': 'a run'})

    def changed(self, topic: str, stamps=None, values=None) -> Recording:
        """The same with other stamps or readings of one topic."""
        return replace(
            self,
            stamps=self.stamps | ({} if stamps is None else {topic: stamps}),
            values=self.values | ({} if values is None else {topic: values}))

    def without(self, topic: str) -> Recording:
        return replace(self, stamps={name: v for name, v in self.stamps.items() if name != topic})

    def write(self, path: Path, **options) -> Path:
        """As the package itself writes it."""
        facts = TestMetadata(
            self.facts['test'], float(self.facts['elevation_deg']), self.facts['rig'],
            self.facts['run'])
        return write_bag(
            path, facts, self.stamps[LOAD_TOPIC], self.values[LOAD_TOPIC],
            [self.stamps[topic] for topic in PROBE_TOPICS],
            [self.values[topic] for topic in PROBE_TOPICS], default_rig().probes, **options)


def dynamic_recording(count: int = 1000, seed: int = 0) -> Recording:
    """A ramp up and down at 500 Hz; probes with stamps of their own."""
    random = np.random.default_rng(seed)
    time = np.arange(count) * PERIOD
    shape = np.clip(1.2 - np.abs(np.linspace(-1.4, 1.4, count)), 0.0, 1.0)
    load = 0.5 * TONNE + 24.0 * TONNE * shape
    stamps = {LOAD_TOPIC: EPOCH + time}
    values = {LOAD_TOPIC: load + random.normal(0.0, 50.0, count)}
    for number, topic in enumerate(PROBE_TOPICS):
        stamps[topic] = EPOCH + time - 700_000 + 300_000 * number
        gap = 1e-3 + (-1) ** number * 4e-10 * load + random.normal(0.0, 3e-7, count)
        values[topic] = gap.astype(np.float32).astype(np.float64)
    return Recording(stamps, values)


def write_raw(path: Path, recording: Recording, *, compression=CompressionType.ZSTD, chunked=True,
              chunk_size=16_384, index_types=IndexType.ALL, log_time=None, order=None, types=None,
              encoding='ros2msg', message_encoding='cdr', extra=0, extra_size=2, facts=True,
              message=cdr, crcs=True, data_crcs=False) -> Path:
    """A bare MCAP file by the mcap package, in the order and with the log times given.

    order: sort key of (topic, stamp, index); log_time: function of (topic, stamp, index).
    """
    types = types or {name: topic.type for name, topic in TOPICS.items()}
    with path.open('wb') as file:
        writer = Writer(
            file, chunk_size=chunk_size, compression=compression, use_chunking=chunked,
            index_types=index_types, enable_crcs=crcs, enable_data_crcs=data_crcs)
        writer.start(profile='ros2')
        channels = {}
        for topic in recording.stamps:
            schema = writer.register_schema(types[topic], encoding, b'# a definition')
            channels[topic] = writer.register_channel(topic, message_encoding, schema)
        if extra:
            schema = writer.register_schema('std_msgs/msg/String', encoding, b'string data')
            channels['/chatter'] = writer.register_channel('/chatter', 'cdr', schema)
        samples = [
            (topic, int(stamp), index) for topic, stamps in recording.stamps.items()
            for index, stamp in enumerate(stamps)]
        samples.sort(key=order or (lambda sample: sample[1]))
        for number, (topic, stamp, index) in enumerate(samples):
            time = stamp if log_time is None else log_time(topic, stamp, index)
            data = message(topic, stamp, float(recording.values[topic][index]))
            writer.add_message(channels[topic], time, data, time, number)
            if extra and number % extra == 0:
                text = struct.pack('<4sI', b'\0\1\0\0', extra_size) + bytes(extra_size)
                writer.add_message(channels['/chatter'], time, text, time)
        if facts:
            writer.add_metadata('saddlering.test', recording.facts)
        writer.finish()
    return path


@pytest.fixture
def recording() -> Recording:
    return dynamic_recording()


@pytest.fixture
def moved(recording) -> tuple[Recording, Displacement]:
    """A recording whose probes follow a known motion without noise, stamped with the load."""
    load = recording.values[LOAD_TOPIC]
    motion = Displacement(5e-10 * load, -1e-10 * load, 1e-9 * load, np.zeros_like(load))
    increments = displacement_to_probes(default_rig().probes, motion)
    for topic, increment in zip(PROBE_TOPICS, increments, strict=True):
        recording = recording.changed(topic, recording.stamps[LOAD_TOPIC], 1e-3 + increment)
    return recording, motion


@pytest.fixture
def short() -> Recording:
    """As `recording`, a third as long."""
    return dynamic_recording(300)


@pytest.fixture
def brief() -> Recording:
    """As `recording`, a tenth as long: for tests that read a bag of it hundreds of times."""
    return dynamic_recording(100)


@pytest.fixture
def raw():
    """The function that writes a bare MCAP file in a way of your own."""
    return write_raw


@pytest.fixture
def message():
    """The function that makes one CDR message."""
    return cdr


@pytest.fixture
def long_recording() -> Recording:
    """One of six seconds: longer than a probe may be silent."""
    return dynamic_recording(3000)
