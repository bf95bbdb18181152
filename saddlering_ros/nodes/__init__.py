"""The executables: one module per node, thin over `record`, `jobs` and `ros`."""

from saddlering_ros.ros.launcher import check_ros, end_at_once, is_node_program

if is_node_program():
    check_ros()
    end_at_once()
