"""Contact parameters from test runs, with their uncertainty and their predictions.

A node that needs only the settings imports `settings`, without SciPy, in a third of the time.
"""
