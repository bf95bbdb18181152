"""Dry friction laws as exact updates over a short travel: z follows a coordinate, |z| <= 1.

The force is the limit times z. Sources: Jenkins: A. Jenkins 1962 (elastic-plastic spring); Dahl:
P. Dahl 1968, dz/dx = (1 - sgn(dx) z) / travel; LuGre: C. Canudas de Wit et al. 1995, with a
Stribeck level and viscous part; Bouc-Wen: Y.-K. Wen 1976 with n = 2 and beta = gamma = 1/2.
"""

from __future__ import annotations

import math

from saddlering_ros.virtual_rig.compilation import compiled

JENKINS, DAHL, LUGRE, BOUC_WEN = 0, 1, 2, 3

LAWS = {'jenkins': JENKINS, 'dahl': DAHL, 'lugre': LUGRE, 'bouc_wen': BOUC_WEN}
"""Number of each law by the name users give."""

STRIBECK_EXCESS = 0.25
"""LuGre: static friction over sliding friction, minus 1."""


@compiled()
def follow(law: int, z: float, travel: float, presliding: float, seconds: float,
           stribeck_speed: float) -> tuple[float, float]:
    """State z after moving by `travel` in `seconds`, and its derivative by travel.

    travel and presliding share one unit [m, rad or N]; stribeck_speed is that unit per second.
    """
    if law == JENKINS:
        moved = z + travel / presliding
        if moved > 1.0:
            return 1.0, 0.0
        if moved < -1.0:
            return -1.0, 0.0
        return moved, 1.0 / presliding
    if law == BOUC_WEN:
        after, slope = _bouc_wen(z, travel / presliding, presliding)
        return after, slope
    level = 1.0
    if law == LUGRE and seconds > 0.0:
        speed = travel / seconds / stribeck_speed
        level = 1.0 + STRIBECK_EXCESS * math.exp(-speed * speed)
    goal = level if travel >= 0.0 else -level
    fade = math.exp(-abs(travel) / (presliding * level))
    after = goal + (z - goal) * fade
    return after, abs(goal - z) * fade / (presliding * level)


@compiled()
def _bouc_wen(z: float, steps: float, presliding: float) -> tuple[float, float]:
    """dz/ds = 1 while |z| falls, 1 - z^2 while it grows, in closed form."""
    sign = 1.0 if steps >= 0.0 else -1.0
    start, left = z * sign, abs(steps)
    if start < 0.0:
        if start + left <= 0.0:
            return sign * (start + left), 1.0 / presliding
        left += start
        start = 0.0
    start = min(start, 1.0 - 1e-12)
    after = math.tanh(math.atanh(start) + left)
    return sign * after, (1.0 - after * after) / presliding
