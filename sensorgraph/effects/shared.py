"""Facts that several effects share."""

from __future__ import annotations

from sensorgraph.effects.effect import Telltale

LOSS_LEFTOVERS = dict.fromkeys(
    ("glass", "mirror", "black_surface", "incidence_dropout", "people", "random_outliers"), 0.03
)
"""What effects that lose or bend whole groups of rays leave at their rim, as shares of their gain."""
LOST_BY_DIRECTION = Telltale(
    least=3, statement="rays are lost or long on many walls, as if by direction, not by wall"
)
STRETCHED = Telltale(
    least=2,
    statement="map and readings both seem stretched: the poses' own scale may be wrong",
    distinct=True,
)
