"""The demo: live nodes in processes of their own, driven and watched by an ordinary ROS client."""
