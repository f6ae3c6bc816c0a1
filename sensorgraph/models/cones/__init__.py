"""Faces from sensors that measure the nearest surface in a cone: sonars and infrared."""
