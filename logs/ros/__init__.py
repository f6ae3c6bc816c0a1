"""Interpret ROS messages: byte layout, topics and their roles, transforms, and the resulting run."""
