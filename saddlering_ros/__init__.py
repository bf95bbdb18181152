"""saddlering_ros: a test rig for saddle bearings, its simulator and its diagnosis, on ROS 2."""

__version__ = '0.1.0'
