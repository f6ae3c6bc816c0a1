"""Record a running ROS 2 robot over zenoh, as published by rmw_zenoh; ROS is not required."""
