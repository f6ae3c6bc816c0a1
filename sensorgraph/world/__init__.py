"""The arena as the robot meets it: robot files, ray casting, the embedded robot and its recordings."""
