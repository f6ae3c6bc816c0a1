"""The direction away from free space follows from the whole wall, also where something covers its middle."""

from __future__ import annotations

import json

import numpy as np

from planners.maps import geojson
from sensorgraph.world.wall_sides import outward

ROOM = [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0], [0.0, 0.0]]


def test_wall_points_away_from_its_free_part_where_a_cupboard_covers_its_middle() -> None:
    # the cupboard reaches through the lower wall, as drawn ones do, so that neither side of the middle is free
    cupboard = [[1.5, -0.1], [2.5, -0.1], [2.5, 0.6], [1.5, 0.6], [1.5, -0.1]]
    features = [
        {
            "type": "Feature",
            "properties": {"name": name, "kind": kind},
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        }
        for name, kind, ring in (("room", "arena", ROOM[::-1]), ("cupboard", "obstacle", cupboard))
    ]
    arena = geojson.loads(json.dumps({"type": "FeatureCollection", "features": features}))
    middles = arena.walls[:4].mean(axis=1)
    away = outward(arena, np.arange(4))
    assert (np.einsum("ni,ni->n", away, middles - [2.0, 1.5]) > 0).all()
