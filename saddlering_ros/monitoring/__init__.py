"""Whether a ring still behaves as its model while the test runs: innovations and an alarm."""

DEFAULT_PERCENT = 2.0
"""Share of the range from preload to full scale that a residual may have without an alarm [%]."""
