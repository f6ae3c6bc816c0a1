"""What ROS messages mean: their byte layout, topics and the roles they play, transforms, and the run they make."""
