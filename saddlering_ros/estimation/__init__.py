"""Estimation for identification and diagnosis: rest, blocks, noise, whitening, least squares.

No module here depends on the mechanics of the ring or on causes.
"""
