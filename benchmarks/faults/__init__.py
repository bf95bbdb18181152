"""Faults put into running nodes, and whether the nodes keep their promises."""
