"""Computations of the streaming nodes, batch by batch, without ROS."""
