"""Machines simulated by other people's programs, each with a catalogue of what may be hidden.

The records are made by the program named in `Machine.source`; the model that is diagnosed is
written here, with an integrator and laws of its own.
"""
