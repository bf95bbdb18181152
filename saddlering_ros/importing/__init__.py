"""Measured files of a data logger as bags: readers of formats, maps, calibration, conversion."""
