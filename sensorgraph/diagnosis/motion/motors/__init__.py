"""Commands against odometry: lag, dead time and saturation of the motors."""
