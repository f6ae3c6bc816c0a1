"""Shipped arenas and robots."""
