"""Readings simulated from map, poses and a few parameters, for the two plain methods."""

from __future__ import annotations

import numpy as np

from benchmarks.hidden_effects.log import Floats, Ints
from benchmarks.hidden_effects.seen import Seen

N_SCANS, N_RAYS = 60, 45
"""Of a run that are looked at."""
MAX_RESIDUAL = 0.5
"""[m] a larger one is of another surface."""


class Scans:
    """Scans of a case, thinned, and the arena as mapped."""

    def __init__(self, seen: Seen) -> None:
        stamps, poses = seen.scan_stamps, seen.pose_stamps
        some = np.flatnonzero((stamps >= poses[0]) & (stamps <= poses[-1]))
        some = some[:: max(1, len(some) // N_SCANS)]
        rays = np.arange(0, seen.ranges.shape[1], max(1, seen.ranges.shape[1] // N_RAYS))
        self.z = seen.ranges[some][:, rays]
        self.stamps = stamps[some]
        self.bearings = seen.bearings[rays]
        self.poses, self.pose_stamps = seen.poses, seen.pose_stamps
        self.mount = np.array(seen.robot["sensor"]["mount"], dtype=np.float64)
        self.rings = seen.rings
        self.share = (self.stamps - self.stamps[0]) / (self.stamps[-1] - self.stamps[0])

    def expected(self, q: dict[str, float]) -> tuple[Floats, Ints]:
        """Return the readings (n, m) [m] that parameters make, and the walls that the rays meet."""
        heading = np.unwrap(self.poses[:, 2])
        at = self.stamps - q.get("latency", 0.0)
        x, y, phi = (np.interp(at, self.pose_stamps, c) for c in (*self.poses[:, :2].T, heading))
        dx, dy = self.mount[0] + q.get("dx", 0.0), self.mount[1] + q.get("dy", 0.0)
        origin = np.stack(
            [x + dx * np.cos(phi) - dy * np.sin(phi), y + dx * np.sin(phi) + dy * np.cos(phi)], 1
        )
        angle = phi[:, None] + self.mount[2] + q.get("mount_yaw", 0.0) + self.bearings
        outer = next(iter(self.rings.values()))
        middle, scale = (outer.min(axis=0) + outer.max(axis=0)) / 2, 1 + q.get("map_scale", 0.0)
        rings = {name: middle + scale * (ring - middle) for name, ring in self.rings.items()}
        r, wall = cast(list(rings.values()), np.repeat(origin, len(self.bearings), axis=0), angle.ravel())
        drift = q.get("range_drift", 0.0) * self.share[:, None]
        r = r.reshape(self.z.shape)
        return (1 + q.get("range_scale", 0.0)) * r + q.get("range_bias", 0.0) + drift, wall.reshape(r.shape)


def cast(rings: list[Floats], origins: Floats, angles: Floats) -> tuple[Floats, Ints]:
    """Return range [m] and wall of each ray; walls are counted ring by ring, -1: none.

    With a ray o + t d and a wall a + u e: t = (a - o) x e / d x e, u = (a - o) x d / d x e, and 0 <= u <= 1.
    """
    a = np.concatenate(rings)
    e = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings]) - a
    dx, dy = np.cos(angles), np.sin(angles)
    best, wall = np.full(len(angles), np.inf), np.full(len(angles), -1)
    for i, ((ax, ay), (ex, ey)) in enumerate(zip(a, e, strict=True)):
        px, py = ax - origins[:, 0], ay - origins[:, 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (px * ey - py * ex) / (dx * ey - dy * ex)
            u = (px * dy - py * dx) / (dx * ey - dy * ex)
            nearer = (t > 1e-7) & (t < best) & (u >= -1e-9) & (u <= 1 + 1e-9)
        best[nearer], wall[nearer] = t[nearer], i
    return best, wall
