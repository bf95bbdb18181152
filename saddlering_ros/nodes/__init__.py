"""ROS 2 nodes: one module per executable, thin over the core; beside them what all nodes share."""
