"""People: discs that walk between random places of the free space."""

from __future__ import annotations

import numpy as np

from planners.arena import Floats
from sensorgraph.world.scene import Scene

RADIUS = 0.18  # [m] of somebody at the height of the scan
SPEED = (0.4, 1.3)  # [m/s]
MOST = 12


def walkers(scene: Scene, share: float, rng: np.random.Generator) -> Floats:
    """Return (n_scans, n_people, 3) [m] x, y, radius so that about `share` of the rays end at somebody."""
    x0, y0, x1, y1 = scene.arena.bounds
    typical = 0.35 * float(np.hypot(x1 - x0, y1 - y0))
    one = 2 * np.arctan(RADIUS / max(typical, 0.5)) / (2 * np.pi)  # of a full turn of rays
    n_people = int(np.clip(round(share / one), 1, MOST))
    busy = min(1.0, share / (one * n_people))
    tracks = [_walk(scene, busy, rng) for _ in range(n_people)]
    return np.stack(tracks, axis=1)


def _walk(scene: Scene, busy: float, rng: np.random.Generator) -> Floats:
    """Walk from place to place; out of sight for the rest of the time."""
    x0, y0, x1, y1 = scene.arena.bounds
    times, places = [0.0], [rng.uniform([x0, y0], [x1, y1])]
    while times[-1] < scene.span:
        place = rng.uniform([x0, y0], [x1, y1])
        if scene.arena.contains(place):
            way = float(np.hypot(*(place - places[-1])))
            times.append(times[-1] + max(way / rng.uniform(*SPEED), 0.1))
            places.append(place)
    path = np.array(places)
    xy = np.stack([np.interp(scene.stamps, times, column) for column in path.T], axis=1)
    start = rng.uniform(0, scene.span * (1 - busy)) if busy < 1 else 0.0
    seen = (scene.stamps >= start) & (scene.stamps <= start + busy * scene.span)
    return np.column_stack([xy, np.where(seen, RADIUS, 0.0)])
