"""Inputs of a diagnosis: the system, its runs, and their stacked vectors, metrics and fits."""
