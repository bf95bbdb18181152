"""Whether a ring still behaves as its model while the test runs: innovations and an alarm."""
