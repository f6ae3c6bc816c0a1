"""Shipped arenas, robots and scripts."""
