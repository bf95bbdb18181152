"""Estimation for identification and diagnosis: rest, blocks, noise, whitening, least squares.

Nothing here knows the ring's mechanics, nor what a cause is.
"""
