"""The public Python API: rigs and bags in, results with summary, plot, table and report out.

What `saddlering_ros` itself exports is defined here; docs/python_api.md states what stays stable.
"""
