"""Settings common to several effects."""

from __future__ import annotations

from sensorgraph.effects.effect import Telltale

LOSS_LEFTOVERS = dict.fromkeys(
    ("glass", "mirror", "black_surface", "incidence_dropout", "people", "random_outliers"), 0.03
)
"""Remainders at the rim of effects that lose or bend groups of rays, as shares of their gain."""
LOST_BY_DIRECTION = Telltale(
    least=3,
    statement="returns are missing or long on many walls, so they may depend on the direction and not on the wall",
)
STRETCHED = Telltale(
    least=2,
    statement="map and readings both appear stretched, so the scale of the poses may be wrong",
    distinct=True,
)
