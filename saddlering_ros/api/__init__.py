"""The public Python API: rigs and bags in, results with summary, plot, table and report out.

The exports of `saddlering_ros` itself are defined here; docs/python_api.md
states which names stay stable.
"""
