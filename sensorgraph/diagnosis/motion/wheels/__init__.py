"""Odometry against reference poses: errors of the wheels, slippery patches, and the clock between the two."""
