"""Plumbing between ROS and the nodes: raw topics, lockstep, parameters, diagnostics, processes."""
