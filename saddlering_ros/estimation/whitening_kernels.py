"""Compiled Cholesky factorisation of a noise covariance and its two triangular products, in O(N).

The covariance of white noise plus T relaxations between samples in order of time is diagonal plus
semiseparable of rank T: covariance(n, m) = sum_k u_nk e^(-gap_nm / tau_k) v_mk for n > m, where
gap_nm runs from the end of m to the start of n. Its Cholesky factor L has the same form, so that
one pass over the samples gives it and each product with L or L^-1. The recursion is that of a
Kalman filter in covariance form; Foreman-Mackey et al., Astron. J. 154 (2017) 220, use it for
spectra of stars.
"""

from __future__ import annotations

import numpy as np

from saddlering_ros.compiled import Compiler

kernel = Compiler(__file__)


@kernel(nogil=True, error_model='numpy')
def factorise(own, ahead, behind, gaps, inside, present, pivots, gains):  # type: ignore[no-untyped-def]
    """Fill `pivots` (N,), squares of L's diagonal, and `gains` (N, T); 0 if all are positive.

    own (N,): variances; ahead, behind (N, T): u and v; gaps, inside (N, T): decay over the gap
    before a sample and over the sample itself; present (N,): 0 where a sample is missing. Returns
    1 + the place of a pivot that is not positive.
    """
    count, parts = ahead.shape
    state = np.zeros((parts, parts))
    reach = np.zeros(parts)
    for n in range(count):
        for i in range(parts):
            for j in range(parts):
                state[i, j] *= gaps[n, i] * gaps[n, j]
        pivot = own[n]
        for i in range(parts):
            total = 0.0
            for j in range(parts):
                total += state[i, j] * ahead[n, j]
            reach[i] = total
            pivot -= ahead[n, i] * total
        if present[n] and not pivot > 0.0:
            return n + 1
        if not present[n]:
            pivot = np.inf
        pivots[n] = pivot
        for i in range(parts):
            gains[n, i] = (behind[n, i] - inside[n, i] * reach[i]) / pivot
        for i in range(parts):
            for j in range(parts):
                state[i, j] *= inside[n, i] * inside[n, j]
                if present[n]:
                    state[i, j] += pivot * gains[n, i] * gains[n, j]
    return 0


@kernel(nogil=True, error_model='numpy')
def whiten(ahead, gaps, inside, pivots, gains, columns):  # type: ignore[no-untyped-def]
    """L^-1 times `columns` (N, B), in place; 0 where a sample is missing."""
    count, parts = ahead.shape
    width = columns.shape[1]
    state = np.zeros((parts, width))
    for n in range(count):
        for i in range(parts):
            decay = gaps[n, i]
            share = ahead[n, i]
            for b in range(width):
                state[i, b] *= decay
                columns[n, b] -= share * state[i, b]
        missing = pivots[n] == np.inf
        for i in range(parts):
            decay = inside[n, i]
            gain = gains[n, i]
            for b in range(width):
                state[i, b] *= decay
                if not missing:
                    state[i, b] += gain * columns[n, b]
        scale = 0.0 if missing else 1.0 / np.sqrt(pivots[n])
        for b in range(width):
            columns[n, b] = 0.0 if missing else scale * columns[n, b]


@kernel(nogil=True, error_model='numpy')
def colour(ahead, gaps, inside, pivots, gains, columns):  # type: ignore[no-untyped-def]
    """L times `columns` (N, B), in place; 0 where a sample is missing."""
    count, parts = ahead.shape
    width = columns.shape[1]
    state = np.zeros((parts, width))
    shock = np.zeros(width)
    for n in range(count):
        missing = pivots[n] == np.inf
        scale = 0.0 if missing else np.sqrt(pivots[n])
        for b in range(width):
            shock[b] = 0.0 if missing else scale * columns[n, b]
            columns[n, b] = shock[b]
        for i in range(parts):
            decay = gaps[n, i]
            onward = inside[n, i]
            gain = gains[n, i]
            share = 0.0 if missing else ahead[n, i]
            for b in range(width):
                reached = decay * state[i, b]
                columns[n, b] += share * reached
                state[i, b] = onward * reached + gain * shock[b]
