"""How often does the alarm of a sound ring come, and how late that of a step or a drift?

    python benchmarks/alarm.py [--hours 2000] [--swinging 500] [--draws 200] [--rings 12]
                               [--records 8] [--seed 0]

1. False alarms of a sound ring: blocks of white noise, and of noise with a wander where the
   residual swings through the whole of materiality; many streams run side by side.
2. Delay after a step or a drift of 0.5, 1 and 3 standard deviations of a block, against theory:
   log(threshold) over the information a block, shift^2 / 2.
3. Whole tests of the virtual rig with parameters that are off within materiality (no alarm) and
   far beyond it (alarm), through `saddlering watch`'s own steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from pathlib import Path
import tempfile

from examiner import draw_truth
from frame import arguments, table
import numpy as np
from rigs import NO_SCATTER, RIG
from scipy.signal import lfilter

from saddlering_ros.bags import read_run
from saddlering_ros.monitoring.detector import (
    BlockNoise,
    ChannelInnovations,
    Detector,
    MAX_BEYOND,
    SINCE_ZERO,
    SIZES,
    threshold_of,
    wander_limit,
)
from saddlering_ros.monitoring.monitor import Monitor, MonitorSettings, Sample, watch
from saddlering_ros.monitoring.noise import assumed_noise, least_wander, materiality
from saddlering_ros.monitoring.stream import residual_samples
from saddlering_ros.record.residual import residual_stretches
from saddlering_ros.rig import ParameterSet
from saddlering_ros.virtual_rig.physics import PhysicalRig
from saddlering_ros.virtual_rig.recording import record_test, TestPlan, write_record
from saddlering_ros.virtual_rig.schedule import dynamic_schedule, static_schedule

BLOCK = 0.02
CHANNELS = 3
ALLOWED_HOURS = 1000.0
STREAMS = 500
"""Streams side by side, each of hours / STREAMS."""


class ManyStreams:
    """The evidence of many streams of C values at once: the steps of `Detector`, as one array.

    Only the evidence is followed, not the onset; float32 suffices for counting.
    """

    def __init__(self, streams: int, values: int, views: int = 1,
                 allowed_hours: float = ALLOWED_HOURS) -> None:
        """views: how many equal values stand behind each of these and share the threshold."""
        self._sizes = SIZES.astype(np.float32)[:, None, None]
        self._half = 0.5 * self._sizes**2
        self._evidence = np.zeros((SIZES.size, 2 * values, streams), np.float32)
        self._gain = np.empty_like(self._evidence)
        self._limit = threshold_of(allowed_hours, BLOCK) * 2 * values * views * SIZES.size

    def reset(self, which: np.ndarray) -> None:
        """Begin anew in these streams."""
        self._evidence[:, :, which] = 0.0

    def step(self, values: np.ndarray, bounds: np.ndarray | float) -> np.ndarray:
        """One block: values (C, streams), bounds (C, 1); which streams alarm."""
        beyond = np.concatenate([values - bounds, -values - bounds])
        np.minimum(beyond, MAX_BEYOND, out=beyond)
        gain = np.multiply(self._sizes, beyond.astype(np.float32), out=self._gain)
        gain -= self._half
        np.exp(gain, out=gain)
        self._evidence += 1.0
        self._evidence *= gain
        return np.asarray(self._evidence.sum(axis=0).max(axis=0) >= self._limit)


def false_alarms_white(hours: float, seed: int, allowed_hours: float = ALLOWED_HOURS) -> int:
    """Alarms of a sound ring in white noise, without materiality: both views are equal then."""
    streams = ManyStreams(STREAMS, CHANNELS, views=2, allowed_hours=allowed_hours)
    chance, alarms = np.random.default_rng(seed), 0
    for _ in range(round(hours * 3600.0 / BLOCK / STREAMS)):
        found = streams.step(chance.standard_normal((CHANNELS, STREAMS), np.float32), 0.0)
        if found.any():
            alarms += int(found.sum())
            streams.reset(found)
    return alarms


def false_alarms_swinging(hours: float, seed: int) -> int:
    """Alarms where the noise wanders and the residual jumps from end to end of materiality.

    Noise as of the virtual rig's probes: white 0.045 um a block, a wander of 0.064 um within 4 s,
    whose value at the start is taken for the zero; materiality 1 um. Innovations and levels as
    `BlockWatch` forms them, once they are steady, with the wander that is assumed of the rig.
    """
    memory, white, true_wander, allowed_size = math.exp(-BLOCK / 4.0), 0.045, 0.064, 1.0
    noise = assumed_noise(BlockNoise(white**2, 0.0, 0.0), 1e6 * least_wander(RIG)[0],
                          BLOCK)
    gain, scale, response = _steady(noise)
    wander_size = wander_limit(noise, BLOCK, ALLOWED_HOURS, CHANNELS)
    both = [((1.0 + response) * allowed_size + (1.0 - response) * wander_size) / scale,
            (allowed_size + SINCE_ZERO * wander_size) / white]
    bounds = np.repeat(both, CHANNELS)[:, None]
    streams, chance = ManyStreams(STREAMS, 2 * CHANNELS), np.random.default_rng(seed)
    shape = (CHANNELS, STREAMS)
    wander = true_wander * chance.standard_normal(shape)
    zero, predicted, alarms = wander.copy(), np.zeros(shape), 0
    kick = true_wander * math.sqrt(1.0 - memory**2)
    rates = chance.uniform(0.1, 3.0, shape)
    for block in range(round(hours * 3600.0 / BLOCK / STREAMS)):
        wander = memory * wander + kick * chance.standard_normal(shape)
        means = wander - zero + white * chance.standard_normal(shape)
        means += allowed_size * np.sign(np.sin(rates * BLOCK * block))
        surprise = means - predicted
        predicted = noise.memory * (predicted + gain * surprise)
        found = streams.step(np.concatenate([surprise / scale, means / white]), bounds)
        if found.any():
            alarms += int(found.sum())
            streams.reset(found)
    return alarms


def _steady(noise: BlockNoise) -> tuple[float, float, float]:
    """Gain, scale and response of the whitener when it is steady."""
    whitener, scale = ChannelInnovations(noise), 1.0
    for _ in range(2000):
        _, scale = whitener.step(0.0)
    return 1.0 - noise.white / scale**2, scale, whitener.response


def learnt_noise(rest: float, size: float, records: int, seed: int) -> tuple[float, int]:
    """Hours and false alarms of whole monitors whose noise is learnt from `rest` seconds.

    Two minutes at 1 kHz each, the probes' noise with its wander; the residual jumps between the
    ends of a materiality of `size` [m].
    """
    alarms, seconds = 0, 0.0
    for record in range(records):
        chance = np.random.default_rng([seed, record])
        time = np.arange(0.0, rest + 120.0, 1e-3)
        residual = np.stack([_probe_noise(time.size, chance) for _ in range(CHANNELS)])
        residual[2] *= 2.0 / RIG.probes.axial_span
        residual -= residual[:, :500].mean(axis=1, keepdims=True)
        moving = time > rest
        residual[:, moving] += size * np.sign(np.sin(1.3 * time[moving]))
        load = RIG.preload + 1e5 * np.abs(np.sin(np.maximum(time - rest, 0.0)))
        monitor = watch(
            Monitor(MonitorSettings(), RIG.limits.rest_band, lambda at: np.full(3, size),
                    least_wander(RIG)),
            (Sample(1 + round(1e9 * now), (x, y, gamma), force) for now, x, y, gamma, force in
             zip(time.tolist(), *residual.tolist(), load.tolist(), strict=True)))
        alarms += monitor.alarm is not None
        seconds += monitor.seconds
    return seconds / 3600.0, alarms


def _probe_noise(count: int, chance: np.random.Generator) -> np.ndarray:
    """Noise of half a difference of two probes of 0.3 um at 1 kHz, three tenths of it slow."""
    memory = math.exp(-1e-3 / 4.0)
    kicks = 0.064e-6 * math.sqrt(1.0 - memory**2) * chance.standard_normal(count)
    kicks[0] = 0.064e-6 * chance.standard_normal()
    white = 0.202e-6 * chance.standard_normal(count)
    return np.asarray(lfilter([1.0], [1.0, -memory], kicks) + white)


def delays(size: float, draws: int, seed: int, drift: float = 0.0) -> np.ndarray:
    """Delays [s] of the alarm after a step of `size`, or a drift to it within `drift` seconds.

    Each draw begins after 10 s without a change; white noise, no materiality.
    """
    chance = np.random.default_rng(seed)
    streams, found = ManyStreams(draws, CHANNELS, views=2), np.full(draws, np.nan)
    for block in range(-500, 60_000):
        drawn = chance.standard_normal((CHANNELS, draws))
        if block >= 0:
            drawn[0] += size * (min(1.0, BLOCK * block / drift) if drift else 1.0)
        alarmed = streams.step(drawn, 0.0) & np.isnan(found)
        found[alarmed] = BLOCK * (block + 1)
        if np.isfinite(found).all():
            break
    return found


def theory(size: float, drift: float = 0.0) -> float:
    """Time [s] in which the information about the change reaches the threshold."""
    needed = math.log(threshold_of(ALLOWED_HOURS, BLOCK) * 4 * CHANNELS)
    total, block = 0.0, 0
    while total < needed:
        share = min(1.0, BLOCK * block / drift) if drift else 1.0
        total += 0.5 * (size * share)**2
        block += 1
    return BLOCK * block


def check_streams() -> None:
    """Assert that the array of streams takes the steps of `Detector`."""
    chance = np.random.default_rng(9)
    one, many = Detector(4, threshold_of(ALLOWED_HOURS, BLOCK)), ManyStreams(1, 4)
    for block in range(2000):
        values = chance.standard_normal(4)
        values[1] += 0.6 * (block > 1000)
        first = one.step(values, np.full(4, 0.1)) is not None
        if first != bool(many.step(values[:, None], 0.1)[0]):
            raise AssertionError(f'block {block}: the streams differ from the detector')
        if first:
            return
    raise AssertionError('the step was not found')


@dataclass(frozen=True)
class Whole:
    """One test of the virtual rig as it was watched.

    share: largest mean over 1 s of the residual beyond its zero, over materiality.
    """

    seconds: float
    share: float
    alarmed: bool
    lapses: int


def whole_test(seed: int, *, dynamic: bool, scale: float) -> Whole:
    """A test of a drawn ring without fault or scatter; the model's stiffnesses are `scale` off."""
    chance = np.random.default_rng([seed, 17])
    truth = draw_truth(seed, 'clean')
    schedule = (dynamic_schedule(RIG, duration=30.0, cycles=2) if dynamic else
                static_schedule(RIG, hold=5.0))
    elevation = math.radians(float(chance.choice([30.0, 50.0, 70.0])))
    record = record_test(TestPlan(
        PhysicalRig(RIG, truth.contact, elevation, (), NO_SCATTER, seed), schedule,
        seed=seed, instruments=truth.instruments, rate=1000.0 if dynamic else 50.0))
    with tempfile.TemporaryDirectory() as folder:
        run = read_run(write_record(Path(folder) / 'bag', record, RIG), rig=RIG)
    contact = replace(truth.contact, K1=truth.contact.K1 * scale, K2=truth.contact.K2 * scale)
    stretches, _ = residual_stretches(RIG, run, ParameterSet(contact), [], lambda share: None)
    (samples,) = stretches  # the record is short
    monitor = watch(
        Monitor(MonitorSettings(), RIG.limits.rest_band,
                lambda at: materiality(RIG, contact, at), least_wander(RIG)),
        residual_samples(samples, run.load[np.searchsorted(run.stamps, samples.stamps)]))
    residual = samples.channels[:3]
    count = 1000 if dynamic else 50
    usable = residual.shape[1] // count * count
    means = residual[:, :usable].reshape(3, -1, count).mean(axis=2)
    shares = np.abs(means).max(axis=1) / monitor.materiality
    share = float(shares.max())
    return Whole(monitor.seconds, share, monitor.alarm is not None, len(monitor.lapses))


def whole_tests(rings: int, seed: int) -> list[tuple[object, ...]]:
    """Rows of whole tests with stiffnesses that are off by at most 0.5 %, and by 10 %."""
    rows: list[tuple[object, ...]] = []
    for dynamic in (False, True):
        count = max(1, rings // 3) if dynamic else rings
        chance = np.random.default_rng([seed, dynamic])
        near = [whole_test(seed + ring, dynamic=dynamic, scale=1.0 + chance.uniform(-5e-3, 5e-3))
                for ring in range(count)]
        far = [whole_test(seed + ring, dynamic=dynamic, scale=1.1)
               for ring in range(max(1, count // 4))]
        within = [one for one in near if one.share < 1.0]
        beyond = [one for one in near if one.share >= 1.0]
        for words, tests in (('off by up to 0.5 %, within', within),
                             ('the same, beyond', beyond), ('off by 10 %', far)):
            rows.append((
                'dynamic' if dynamic else 'static', words, len(tests),
                max((one.share for one in tests), default=math.nan),
                sum(one.seconds for one in tests) / 3600.0, sum(one.alarmed for one in tests),
                sum(one.lapses > 0 for one in tests)))
    return rows


def main() -> None:
    args = arguments(
        __doc__, {'hours': 200.0, 'swinging': 50.0, 'draws': 20, 'rings': 2, 'records': 1},
        hours=2000.0, swinging=500.0, draws=200, rings=12, records=8, seed=0)
    check_streams()
    late = {(size, drift): delays(size, args.draws, 1 + round(drift), drift)
            for size in (0.5, 1.0, 3.0) for drift in (0.0, 10.0)}
    table('Delay [s] of a change by so many standard deviations of a block',
          ('change', 'drift within [s]', 'median', 'nine in ten', 'theory'),
          [(size, drift, np.median(found), np.quantile(found, 0.9), theory(size, drift))
           for (size, drift), found in late.items()])
    table('False alarms of a sound ring', ('residual', 'hours', 'false alarms', 'allowed'), [
        ('white noise, no materiality', args.hours, false_alarms_white(args.hours, args.seed),
         args.hours / ALLOWED_HOURS),
        ('the same, one an hour allowed', args.hours / 10.0,
         false_alarms_white(args.hours / 10.0, args.seed + 1, 1.0), args.hours / 10.0),
        ('noise that wanders, jumps from end to end of materiality', args.swinging,
         false_alarms_swinging(args.swinging, args.seed), args.swinging / ALLOWED_HOURS)])
    table('Whole records with noise learnt from their rest',
          ('rest [s]', 'materiality [um]', 'hours', 'false alarms'),
          [(rest, 1e6 * size, *learnt_noise(rest, size, args.records, args.seed))
           for rest in (2.0, 10.0) for size in (0.0, 0.3e-6, 1e-6)])
    table('Whole tests of the virtual rig; share: largest residual over materiality',
          ('test', 'stiffnesses', 'tests', 'share', 'hours', 'alarms', 'with a lapse'),
          whole_tests(args.rings, args.seed))


if __name__ == '__main__':
    main()
