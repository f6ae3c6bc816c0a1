"""Rooms: an outline with piers and furniture, and their two map formats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from benchmarks.hidden_effects.log import Floats

OUTLINE = "floor"
"""Name of the ring around the free space."""
PIER = "pier"
"""Names of things that belong to the building begin so."""
RESOLUTION = 0.05
"""[m] of a raster map."""
MARGIN = 0.3
"""[m] of unknown cells around a raster map."""
FREE, OCCUPIED, UNKNOWN = 254, 0, 205


@dataclass(frozen=True, kw_only=True, eq=False)
class Room:
    """Rings of walls; the rays of a laser are stopped at each."""

    name: str
    """Of the floor that it was cut from."""
    rings: dict[str, Floats]
    """(n, 2) [m] of each, counter-clockwise; the first is the outline of the free space."""

    def copy(self) -> Room:
        """Return a room whose rings may be changed."""
        return Room(name=self.name, rings={name: ring.copy() for name, ring in self.rings.items()})

    @property
    def furniture(self) -> list[str]:
        """Names of what may be moved."""
        return [name for name in self.rings if name != OUTLINE and not name.startswith(PIER)]

    def free(self) -> BaseGeometry:
        """Return the free space."""
        free: BaseGeometry = Polygon(self.rings[OUTLINE])
        for name, ring in self.rings.items():
            if name != OUTLINE:
                free = free.difference(Polygon(ring).buffer(0))
        return free

    def walls(self) -> tuple[Floats, list[tuple[str, int]]]:
        """Return all walls (n, 4) [m] by their ends, and of each its ring and its index there."""
        walls: list[Floats] = []
        names: list[tuple[str, int]] = []
        for name, ring in self.rings.items():
            walls.append(np.hstack([ring, np.roll(ring, -1, axis=0)]))
            names += [(name, i) for i in range(len(ring))]
        return np.ascontiguousarray(np.vstack(walls)), names


def raster(room: Room) -> dict[str, str | bytes]:
    """Return the files of a map as map_server does: arena.pgm and arena.yaml; unknown outside and inside of things."""
    outline = room.rings[OUTLINE]
    x0, y0 = np.floor((outline.min(0) - MARGIN) / RESOLUTION) * RESOLUTION
    nx, ny = np.ceil((outline.max(0) + MARGIN - (x0, y0)) / RESOLUTION).astype(int)
    free = room.free()
    shapely.prepare(free)
    x, y = np.meshgrid(x0 + (np.arange(nx) + 0.5) * RESOLUTION, y0 + (np.arange(ny) + 0.5) * RESOLUTION)
    image = np.where(shapely.contains_xy(free, x, y), FREE, UNKNOWN).astype(np.uint8)
    for wall in room.walls()[0]:
        length = np.hypot(wall[2] - wall[0], wall[3] - wall[1])
        share = np.linspace(0, 1, int(length / (RESOLUTION / 10)) + 2)
        column = ((wall[0] + share * (wall[2] - wall[0]) - x0) / RESOLUTION).astype(int)
        row = ((wall[1] + share * (wall[3] - wall[1]) - y0) / RESOLUTION).astype(int)
        image[row, column] = OCCUPIED
    return {
        "arena.pgm": b"P5\n%d %d\n255\n" % (nx, ny) + image[::-1].tobytes(),
        "arena.yaml": f"image: arena.pgm\nresolution: {RESOLUTION}\norigin: [{x0:.4f}, {y0:.4f}, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n",
    }
