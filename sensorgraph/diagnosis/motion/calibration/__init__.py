"""Wheels and the laser's mount from driving alone: no map, no reference, only scans and odometry."""
