"""How far colours are apart for people who see no red, no green or no blue."""

import numpy as np

SEEN = {
    'all colours': np.eye(3),
    'no red': [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
               [-0.003882, -0.048116, 1.051998]],
    'no green': [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                 [-0.011820, 0.042940, 0.968881]],
    'no blue': [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                [0.004733, 0.691367, 0.303900]]}
"""Linear RGB as it is seen: Machado, Oliveira and Fernandes (2009), severity 1."""

APART = 20.0
"""Difference of two lines that are told apart at a glance, in CIE 1976 units; 2.3 is just seen."""

TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = np.array([0.9505, 1.0, 1.089])


def linear(colour):
    """Linear RGB of '#rrggbb'."""
    parts = np.array([int(colour[place:place + 2], 16) for place in (1, 3, 5)]) / 255
    return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055)**2.4)


def lab(rgb):
    """CIE L*a*b* of linear RGB."""
    share = TO_XYZ @ np.clip(rgb, 0.0, 1.0) / WHITE
    x, y, z = np.where(share > 0.008856, np.cbrt(share), 7.787 * share + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def smallest_difference(one, other):
    """Difference of two colours, of the eyes that see the least of it."""
    return min(float(np.linalg.norm(lab(seen @ linear(one)) - lab(seen @ linear(other))))
               for seen in map(np.asarray, SEEN.values()))
