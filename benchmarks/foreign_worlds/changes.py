"""What hidden effects change in a room before it is built."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.foreign_worlds.hidden import Hidden
from benchmarks.foreign_worlds.rooms import OUTER, Floats, Room


def changed_room(room: Room, hidden: Sequence[Hidden]) -> Room:
    """Return the room with the changes that effects make to it."""
    for one in hidden:
        if one.name == "missing_obstacle":
            room = room.with_ring(one.place, None)
        elif one.name == "moved_obstacle":
            room = room.with_ring(one.place, room.rings[one.place] + [one["dx"], one["dy"]])
        elif one.name == "unmapped_obstacle":
            angle = 2 * np.pi * np.arange(24) / 24
            ring = one["r"] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            room = room.with_ring("new", ring + [one["x"], one["y"]])
        elif one.name == "moved_wall":
            room = room.with_ring(OUTER, _shifted(room.rings[OUTER], int(one.place.split("_")[1]), one["d"]))
        elif one.name == "map_scale":
            middle = room.rings[OUTER].mean(axis=0)
            for name, ring in list(room.rings.items()):
                room = room.with_ring(name, middle + (ring - middle) * (1 + one["s"]))
    return room


def _shifted(ring: Floats, i: int, d: float) -> Floats:
    """Move edge i of a rectilinear ring outward by d [m]."""
    j = (i + 1) % len(ring)
    along = (ring[j] - ring[i]) / np.hypot(*(ring[j] - ring[i]))
    out = ring.copy()
    out[[i, j]] += d * np.array([along[1], -along[0]])
    return out
