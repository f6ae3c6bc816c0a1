"""Calibrate wheels and laser mount from driving alone: scans and odometry, without map or reference poses."""
