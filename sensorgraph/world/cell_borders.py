"""The borders of the cells of an occupancy-grid map as walls, as in a simulated world that is made from the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely

from planners.arena import Arena
from sensorgraph.world.pixel_walls import OUTLINE, pixel_of


def with_borders_as_walls(arena: Arena, straight: Arena) -> Arena:
    """Return an occupancy-grid arena whose walls are the borders of its cells, with the names of its objects.

    Parameters
    ----------
    straight : The same arena with straight walls (`straightened`). A border has the name of the nearest one within a
        cell; objects come last.
    """
    parts = np.array([name.split("/")[0] for name in straight.names])
    tree = shapely.STRtree([shapely.LineString(one) for one in straight.walls])
    middles = shapely.points(arena.walls.mean(axis=1))
    border, wall = tree.query_nearest(middles, max_distance=pixel_of(arena), all_matches=False)
    part = np.full(arena.n_walls, OUTLINE, dtype=parts.dtype)
    part[border] = parts[wall]
    order = np.argsort(part != OUTLINE, kind="stable")
    names = tuple(f"{one}/edge_{k}" for k, one in enumerate(part[order]))
    return replace(arena, walls=arena.walls[order], names=names)
