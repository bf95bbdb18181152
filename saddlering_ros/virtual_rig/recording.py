"""The rig's recorder: when samples are taken, noise, quantisation, and the bag that comes out."""

from dataclasses import dataclass, field, replace
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags import write_bag
from saddlering_ros.errors import VirtualRigError
from saddlering_ros.record import TestMetadata
from saddlering_ros.rig import FULL_SCALE_LOAD, Rig
from saddlering_ros.virtual_rig.effects_probes import Recording
from saddlering_ros.virtual_rig.numerics import slow_noise
from saddlering_ros.virtual_rig.physics import PhysicalRig, PhysicalRun, run_test
from saddlering_ros.virtual_rig.schedule import controlled_load, Schedule

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

LEVELS = 2**16
CELL_SPAN = 3e5 / FULL_SCALE_LOAD
"""Span of the load cell to both sides over the full scale, in 2^16 levels."""

EPOCH = 1_760_000_000
"""Time of the first test [s since 1970]."""

RATES = {'static': 50.0, 'dynamic': 1000.0}
STEPS = {'static': 0.01, 'dynamic': 0.001}
"""Default sample rates [Hz] and integration steps [s]."""


@dataclass(frozen=True)
class Instruments:
    """How good the instruments are.

    noise: rms of a probe's total noise [m], of which `slow_share` (rms) wanders within
    `slow_time` [s]; load_noise: rms of the cell's white noise [N], its slow part is a third of it;
    jitter: rms of stamps as a share of the sampling period; gap: at zero [m]; gap_scatter: rms
    difference of the probes' gaps [m].
    """

    noise: float = 0.3e-6
    slow_share: float = 0.3
    slow_time: float = 4.0
    load_noise: float = 50.0
    jitter: float = 0.02
    gap: float = 1e-3
    gap_scatter: float = 30e-6
    quantised: bool = True


@dataclass(frozen=True)
class TestPlan:
    """A test to be generated: the rig, its schedule, its recording, the seed of chance.

    begin: when it starts [whole s since 1970]; None leaves it to chance.
    """

    __test__ = False

    physical: PhysicalRig
    schedule: Schedule
    seed: int = 0
    instruments: Instruments = field(default_factory=Instruments)
    rate: float | None = None
    probe_rate: float | None = None
    step: float | None = None
    rig_name: str = 'virtual rig'
    run_name: str = ''
    begin: int | None = None

    def __post_init__(self) -> None:
        for name in ('rate', 'probe_rate'):
            value = getattr(self, name)
            if value is not None and not 1.0 <= value <= 100e3:
                raise VirtualRigError(f'{name} is {value:g} Hz: give 1 to 100000')
        if self.samples > 20e6:
            raise VirtualRigError(f'the test would have {self.samples:.3g} samples: give a lower '
                                  'rate or a shorter test (20 million at most)')
        if self.seed < 0:
            raise VirtualRigError(f'seed is {self.seed}: give a whole number from 0 up')

    @property
    def load_rate(self) -> float:
        return self.rate if self.rate is not None else RATES[self.schedule.test]

    @property
    def samples(self) -> float:
        """Messages in the bag, about."""
        probes = self.probe_rate if self.probe_rate is not None else self.load_rate
        return self.schedule.duration * (self.load_rate + 4.0 * probes)


@dataclass(frozen=True)
class TestRecord:
    """Recorded samples: stamps int64 [ns], readings of the load [N] and of the gaps [m]."""

    __test__ = False

    facts: TestMetadata
    load_stamps: Stamps
    load: Floats
    probe_stamps: tuple[Stamps, ...]
    gaps: tuple[Floats, ...]
    log_delay: int
    truth: PhysicalRun


def record_test(plan: TestPlan) -> TestRecord:
    """Carry out the test and record it; the same plan gives the same record, bit for bit."""
    schedule, physical = plan.schedule, plan.physical
    chance = [np.random.default_rng([plan.seed, stream]) for stream in range(12)]
    step = plan.step if plan.step is not None else STEPS[schedule.test]
    steps = math.ceil(schedule.duration / step)
    load = controlled_load(schedule, step / 3.0, 3 * steps + 1, chance[0])
    run = run_test(physical, load, step, plan.seed)
    recording = Recording()
    for request in physical.requests('recording'):
        request.effect.act(recording, request.values, request.form)
    begin = EPOCH + 3600 * int(chance[1].integers(0, 20_000))
    if plan.begin is not None:
        begin = plan.begin
    probe_rate = plan.probe_rate if plan.probe_rate is not None else plan.load_rate
    margin, jitter = 2.0 / min(plan.load_rate, probe_rate), plan.instruments.jitter
    time = _instants(margin, run.time[-1] - margin, plan.load_rate, jitter, chance[2])
    probe_times = [_instants(0.0, run.time[-1], probe_rate, jitter, chance[3 + probe])
                   for probe in range(4)]
    gaps = tuple(_gaps(plan, run, recording, probe, times, chance[7 + probe])
                 for probe, times in enumerate(probe_times))
    probe_stamps = tuple(
        _stamps(begin, times + recording.clock_offset + recording.clock_skew * times)
        for times in probe_times)
    facts = TestMetadata(schedule.test, math.degrees(physical.elevation), plan.rig_name,
                         plan.run_name)
    return TestRecord(
        facts, _stamps(begin, time), _load_reading(plan, run, recording, time, chance[11]),
        probe_stamps, gaps, int(chance[1].integers(1_500, 9_000)) * 1000, run)


def write_record(path: Path | str, record: TestRecord, rig: Rig, *,
                 overwrite: bool = False) -> Path:
    """Write the record as a bag, complete or not at all; the hash of `rig` goes into it."""
    facts = replace(record.facts, details={**record.facts.details, 'rig_hash': rig.digest})
    return write_bag(path, facts, record.load_stamps, record.load, record.probe_stamps,
                     record.gaps, rig.probes, log_delay=record.log_delay, overwrite=overwrite)


def _instants(first: float, last: float, rate: float, jitter: float,
              random: np.random.Generator) -> Floats:
    """When samples are taken [s]: a random phase, then `rate` with jitter, in microseconds."""
    period = 1.0 / rate
    phase = random.uniform(0.05, 0.95) * period
    count = max(int((last - first - phase) * rate), 2)
    wander = np.clip(jitter * random.normal(size=count), -0.3, 0.3) * period
    instants = first + phase + period * np.arange(count) + wander
    return np.asarray(np.clip(np.round(instants, 6), first, last))


def _stamps(begin: int, seconds: Floats) -> Stamps:
    return np.asarray(begin * 1_000_000_000 + np.rint(seconds * 1e9).astype(np.int64))


def _wander(times: Floats, rms: float, time_constant: float,
            random: np.random.Generator) -> Floats:
    """Slow noise (N,) at nearly equal times [s]."""
    spacing = (times[-1] - times[0]) / max(len(times) - 1, 1)
    kicks = random.normal(size=len(times))
    kicks[0] = random.normal()
    return slow_noise(kicks, spacing, rms, time_constant)


def _gaps(plan: TestPlan, run: PhysicalRun, recording: Recording, probe: int, times: Floats,
          random: np.random.Generator) -> Floats:
    """Readings of one probe [m]: its motion, its noise, its amplifier, its converter."""
    instruments, probes = plan.instruments, plan.physical.rig.probes
    slow = instruments.noise * instruments.slow_share
    white = instruments.noise * math.sqrt(max(1.0 - instruments.slow_share**2, 0.0))
    offset = instruments.gap_scatter * random.normal()
    noise = white * random.normal(size=len(times))
    noise += _wander(times, slow, instruments.slow_time, random)
    increment = _between(run.time, run.increments[probe], times) + noise
    increment = recording.disturb(probe + 1, times, increment)
    gap = instruments.gap + offset + probes.polarity[probe] * increment
    level = (probes.max_range - probes.min_range) / LEVELS
    if instruments.quantised:
        gap = probes.min_range + level * np.rint((gap - probes.min_range) / level)
    return np.asarray(np.clip(gap, probes.min_range, probes.max_range))


def _load_reading(plan: TestPlan, run: PhysicalRun, recording: Recording, times: Floats,
                  random: np.random.Generator) -> Floats:
    """Readings of the load cell [N]."""
    noise = plan.instruments.load_noise
    reading = _between(run.time, run.load, times) + noise * random.normal(size=len(times))
    reading += _wander(times, noise / 3.0, plan.instruments.slow_time, random)
    reading = np.minimum(reading, recording.load_limit)
    if plan.instruments.quantised:
        level = 2.0 * CELL_SPAN * plan.physical.rig.full_scale_load / LEVELS
        reading = level * np.rint(reading / level)
    return np.asarray(reading)


def _between(grid: Floats, values: Floats, times: Floats) -> Floats:
    """Values at `times` by cubic interpolation on an even grid (Catmull and Rom)."""
    step = grid[1] - grid[0]
    place = np.clip((times / step).astype(np.int64), 0, len(grid) - 2)
    u = times / step - place
    before = values[np.maximum(place - 1, 0)]
    here, there = values[place], values[place + 1]
    after = values[np.minimum(place + 2, len(grid) - 1)]
    return np.asarray(here + 0.5 * u * (
        there - before + u * (2.0 * before - 5.0 * here + 4.0 * there - after
                              + u * (3.0 * (here - there) + after - before))))
