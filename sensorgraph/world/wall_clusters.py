"""Walls in clusters with bounding circles, so that a ray caster can skip walls hidden behind nearer ones."""

from __future__ import annotations

import numpy as np

from sensorgraph.types import Bools, Floats, Ints

WALLS_PER_CLUSTER = 10  # neighbouring walls under one bounding circle
SECTORS = 64  # sectors of the full turn (a power of two) with the maximum range of their rays
LEVELS = 5  # runs of 1, 2, 4, 8 and 16 sectors
LEVEL_OF = np.minimum(np.frexp(np.maximum(np.arange(SECTORS + 1), 1).astype(np.float64))[1] - 1, LEVELS - 1)


class WallClusters:
    """Groups of neighbouring walls, each with a bounding circle."""

    def __init__(self, walls: Floats) -> None:
        length = np.hypot(*(walls[:, 1] - walls[:, 0]).T)
        is_long = length > 8 * np.median(length)  # a long wall would enlarge the circle of its neighbours
        order = morton_order(walls.mean(axis=1))
        short, long = order[~is_long[order]], order[is_long[order]]
        n_short = -(-len(short) // WALLS_PER_CLUSTER)
        self.members = np.full((n_short + len(long), WALLS_PER_CLUSTER), -1, dtype=np.intp)  # walls; -1: none
        self.members[:n_short].reshape(-1)[: len(short)] = short
        self.members[n_short:, 0] = long
        filler = (self.members < 0)[..., None, None]
        corners = walls[self.members]  # (n_clusters, PER_CLUSTER, 2, 2)
        lower = np.where(filler, np.inf, corners).min(axis=(1, 2))
        upper = np.where(filler, -np.inf, corners).max(axis=(1, 2))
        self.centre = (lower + upper) / 2  # (n_clusters, 2) [m]
        self.radius = np.hypot(*(upper - lower).T) / 2 + 1e-9  # (n_clusters,) [m]

    def pairs(self, chosen: Bools) -> tuple[Ints, Ints]:
        """Return (pose, wall) for the chosen clusters (n_poses, n_clusters)."""
        pose, cluster = np.nonzero(chosen)
        member = self.members[cluster]
        is_wall = member >= 0
        return np.repeat(pose, WALLS_PER_CLUSTER)[is_wall.ravel()], member[is_wall]


class ClusterView:
    """Distance and sectors of the clusters, seen from a batch of poses."""

    def __init__(self, clusters: WallClusters, poses: Floats, bearings: Floats) -> None:
        x, y = clusters.centre[:, 0] - poses[:, :1], clusters.centre[:, 1] - poses[:, 1:2]
        far = np.sqrt(x * x + y * y)
        self.distance: Floats = (
            far - clusters.radius
        )  # (n_poses, n_clusters) [m] minimum distance; negative inside the circle
        per_radian = SECTORS / (2 * np.pi)
        middle = (np.arctan2(y, x) - (poses[:, 2:] + bearings[0])) * per_radian
        half = np.arcsin(np.minimum(clusters.radius / np.maximum(far, 1e-12), 1.0)) * per_radian + 1e-6
        first = np.floor(middle - half).astype(np.intp)
        last = np.floor(middle + half).astype(np.intp)
        self.first, self.last = first, last
        self.row = np.arange(len(poses))[:, None]

    def hidden(self, reach: SectorReach) -> Bools:
        """Tell which clusters are beyond every ray in their sectors, (n_poses, n_clusters)."""
        return np.asarray(
            (self.distance > 0) & (self.distance > reach(self.row, self.first, self.last) + 1e-9)
        )


class SectorReach:
    """Maximum range of the rays of a batch, by sector of the full turn counted from ray 0; -inf without a ray."""

    def __init__(self, ranges: Floats, sectors: Ints, starts: Ints) -> None:
        reach = np.full((len(ranges), SECTORS), -np.inf)
        reach[:, sectors] = np.maximum.reduceat(ranges, starts, axis=1)
        table = [reach]
        for level in range(LEVELS - 1):  # maximum over 1, 2, 4, ... sectors, modulo a full turn
            table.append(np.maximum(table[-1], np.roll(table[-1], -(1 << level), axis=1)))
        self.table = np.stack(table).reshape(-1)
        self.stride = reach.size

    def __call__(self, row: Ints, first: Ints, last: Ints) -> Floats:
        """Return the maximum reach over sectors first..last, modulo a full turn; +inf for more than a quarter turn."""
        count = last - first + 1
        level = LEVEL_OF[np.minimum(count, SECTORS)]
        start = level * self.stride + row * SECTORS
        width = np.left_shift(1, level)
        farthest = self.table[start + (first & (SECTORS - 1))]
        np.maximum(farthest, self.table[start + ((last + 1 - width) & (SECTORS - 1))], out=farthest)
        return np.where(count <= 2 * width, farthest, np.inf)

    def between(self, row: Ints, low: Floats, high: Floats) -> Floats:
        """Return the maximum reach between two angles counted from ray 0."""
        per_radian = SECTORS / (2 * np.pi)
        first = (low * per_radian - 1e-6).astype(np.intp)
        return self(row, first, (high * per_radian + 1e-6).astype(np.intp))


def morton_order(points: Floats) -> Ints:
    """Order points (n, 2) so that neighbours in the list are neighbours in the plane."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.intp)
    scale = max(float(np.ptp(points, axis=0).max()), 1e-9)
    cell = ((points - points.min(axis=0)) / scale * 1023).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for bit in range(10):
        for axis in (0, 1):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(2 * bit + axis)
    return np.argsort(code, kind="stable")
