"""Sensorgraph: transparent equations of what a range sensor perceives at every (x, y, phi) of an arena."""

__version__ = "0.1.0.dev0"
