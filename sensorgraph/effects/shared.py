"""Settings common to several effects."""

from __future__ import annotations

LOSS_LEFTOVERS = dict.fromkeys(
    ("glass", "mirror", "black_surface", "incidence_dropout", "people", "random_outliers"), 0.03
)
"""Remainders at the rim of effects that lose or bend groups of rays, as shares of their gain."""
