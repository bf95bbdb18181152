"""The format of bags: reading and writing.

A node that decodes topics imports `bags.wire` only, and no library of a file format.
"""
