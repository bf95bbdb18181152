"""What the streaming nodes compute, batch by batch, without ROS."""
