"""How often does the alarm of a sound ring come, and how late that of a step or a drift?

    python benchmarks/alarm.py [--hours 2000] [--swinging 500] [--draws 200] [--seed 0]

1. False alarms of a sound ring: blocks of white noise, and of noise with a wander where the
   residual swings through the whole of materiality; many streams run side by side.
2. Delay after a step or a drift of 0.5, 1 and 3 standard deviations of a block, against theory:
   log(threshold) over the information a block, shift^2 / 2.
"""

import math

from frame import arguments, table
import numpy as np
from rigs import RIG

from saddlering_ros.monitoring import detector

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
        self._sizes = detector.SIZES.astype(np.float32)[:, None, None]
        self._half = 0.5 * self._sizes**2
        self._evidence = np.zeros((detector.SIZES.size, 2 * values, streams), np.float32)
        self._gain = np.empty_like(self._evidence)
        self._limit = 3600.0 * allowed_hours / BLOCK * 2 * values * views * detector.SIZES.size

    def count(self, values: np.ndarray, bounds: np.ndarray | float) -> int:
        """How many streams alarm at one block; they begin anew."""
        found = self.step(values, bounds)
        self._evidence[:, :, found] = 0.0
        return int(found.sum())

    def step(self, values: np.ndarray, bounds: np.ndarray | float) -> np.ndarray:
        """One block: values (C, streams), bounds (C, 1); which streams alarm."""
        beyond = np.concatenate([values - bounds, -values - bounds])
        np.minimum(beyond, detector.MAX_BEYOND, out=beyond)
        gain = np.multiply(self._sizes, beyond.astype(np.float32), out=self._gain)
        gain -= self._half
        np.exp(gain, out=gain)
        self._evidence += 1.0
        self._evidence *= gain
        return np.asarray(self._evidence.sum(axis=0).max(axis=0) >= self._limit)


def false_alarms_white(hours: float, seed: int, allowed_hours: float = ALLOWED_HOURS) -> int:
    """Alarms of a sound ring in white noise, without materiality: both views are equal then."""
    streams = ManyStreams(STREAMS, CHANNELS, views=2, allowed_hours=allowed_hours)
    chance = np.random.default_rng(seed)
    return sum(streams.count(chance.standard_normal((CHANNELS, STREAMS), np.float32), 0.0)
               for _ in range(round(hours * 3600.0 / BLOCK / STREAMS)))


def false_alarms_swinging(hours: float, seed: int) -> int:
    """Alarms where the noise wanders and the residual jumps from end to end of materiality.

    Noise as of the virtual rig's probes: white 0.045 um a block, a wander of 0.064 um within 4 s,
    whose value at the start is taken for the zero; materiality 1 um. Innovations and levels as
    `BlockWatch` forms them, once they are steady, with the wander that is assumed of the rig.
    """
    memory, white, true_wander, allowed_size = math.exp(-BLOCK / 4.0), 0.045, 0.064, 1.0
    noise = detector.assumed_noise(detector.BlockNoise(white**2, 0.0, 0.0),
                                   1e6 * detector.least_wander(RIG)[0], BLOCK)
    whitener = detector.Innovations([noise])
    for _ in range(2000):  # until it is steady
        _, (scale,) = whitener.step(np.zeros(1))
    gain, response = 1.0 - noise.white / scale**2, float(whitener.response[0])
    wander_size = detector.wander_limit(noise, BLOCK, ALLOWED_HOURS, CHANNELS)
    both = [((1.0 + response) * allowed_size + (1.0 - response) * wander_size) / scale,
            (allowed_size + detector.SINCE_ZERO * wander_size) / white]
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
        alarms += streams.count(np.concatenate([surprise / scale, means / white]), bounds)
    return alarms


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
    needed = math.log(3600.0 * ALLOWED_HOURS / BLOCK * 4 * CHANNELS)
    total, block = 0.0, 0
    while total < needed:
        share = min(1.0, BLOCK * block / drift) if drift else 1.0
        total += 0.5 * (size * share)**2
        block += 1
    return BLOCK * block


def check_streams() -> None:
    """Assert that the array of streams takes the steps of `Detector`."""
    chance = np.random.default_rng(9)
    one, many = detector.Detector(4, 3600.0 * ALLOWED_HOURS / BLOCK), ManyStreams(1, 4)
    for block in range(2000):
        values = chance.standard_normal(4)
        values[1] += 0.6 * (block > 1000)
        first = one.step(values, np.full(4, 0.1)) is not None
        if first != bool(many.step(values[:, None], 0.1)[0]):
            raise AssertionError(f'block {block}: the streams differ from the detector')
        if first:
            return
    raise AssertionError('the step was not found')


def main() -> None:
    args = arguments(
        __doc__, {'hours': 200.0, 'swinging': 50.0, 'draws': 20},
        hours=2000.0, swinging=500.0, draws=200, seed=0)
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


if __name__ == '__main__':
    main()
