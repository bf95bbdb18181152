"""For which contact laws the division of steps is too coarse, in words."""

from __future__ import annotations

from saddlering_ros.rig import ContactParameters

MIN_DAMPING = 3e4
"""Damping [N s/m] below which the ring rings faster than the smallest step follows: at 1e4 the
largest error after a jump of the load is 3 % of the motion, noise of the load included."""


def accuracy_notes(contact: ContactParameters) -> list[str]:
    """One line if motions after a jump of the load are simulated with an error of percents."""
    small = [f'{name} is {value:.3g}' for name, value in (('D1', contact.D1), ('D2', contact.D2))
             if value < MIN_DAMPING]
    if not small:
        return []
    return [f'{" and ".join(small)} N s/m: the smallest step of the solver is too long for such a '
            'damping; just after a jump of the load the simulation is up to 3 % of the motion off']
