"""Worlds in simulators of others: contact physics and lasers of MuJoCo, people and lidar of ir-sim."""
