"""The record of a test, and the computations from its samples to displacements and plateaus."""
