"""Coordinates with a memory: play operators, relaxations and the direction of a drive.

Each is causal: its value at a sample follows from that sample and those before, so that a law in
such a coordinate can be simulated live. Rate-free hysteresis as a sum of plays with non-negative
weights is the Prandtl-Ishlinskii model; Krasnosel'skii and Pokrovskii, Systems with Hysteresis
(1989).
"""

from __future__ import annotations

import numpy as np

from saddlering_ros.discrepancy.system import Array


def stop_operators(drive: Array, reaches: Array) -> Array:
    """(N, R): what each play of half width `reaches` (R,) leaves of the drive (N,), from -r to r.

    The first sample finds every play in the middle of its width.
    """
    reach = np.asarray(reaches, dtype=np.float64)
    play = np.full(reach.size, drive[0])
    out = np.empty((drive.size, reach.size))
    for number, value in enumerate(drive):
        np.clip(play, value - reach, value + reach, out=play)
        out[number] = value - play
    return out


def relaxations(time: Array, drive: Array, constants: Array) -> Array:
    """(N, T): the drive less what first-order lags of `constants` (T,) [s] follow of it.

    The first sample finds every lag at rest. The drive is straight between samples.
    """
    tau = np.asarray(constants, dtype=np.float64)
    left = np.zeros(tau.size)
    out = np.empty((drive.size, tau.size))
    out[0] = 0.0
    steps, changes = np.diff(time), np.diff(drive)
    for number in range(1, drive.size):
        ratio = steps[number - 1] / tau
        kept = np.exp(-ratio)
        left = kept * left + changes[number - 1] * -np.expm1(-ratio) / ratio
        out[number] = left
    return out


def direction_of(drive: Array, band: float) -> Array:
    """+1 (N,) while the drive rises and -1 while it falls, the last of them while it rests.

    A reversal counts once it exceeds `band`.
    """
    direction = np.empty(drive.size)
    sign, extreme = 1.0, drive[0]
    for number, value in enumerate(drive):
        if sign * (value - extreme) > 0.0:
            extreme = value
        elif sign * (extreme - value) > band:
            sign, extreme = -sign, value
        direction[number] = sign
    return direction
