"""Faces fitted to sensors that measure the nearest surface in a cone: sonar and infrared sensors."""
