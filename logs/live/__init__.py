"""Listen to a running ROS 2 robot over zenoh, as rmw_zenoh publishes, and write what it says; no ROS needed."""
