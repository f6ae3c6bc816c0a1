"""Cache between casts of the same scans: their rays, and what these hit.

A fit casts the same scans repeatedly, with one obstacle moved or one disc added. Rays with the same mount and
times are the same. If few walls have moved, only these are intersected again, and only the rays that had
stopped at one of them are cast again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from sensorgraph.types import Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.ray_intersection import nearest_after_moves

MAX_RAYS, MAX_HITS, MAX_BEAMS = 4, 8, 12
"""Number of cached sets of rays, of their hits, and of beams."""
MAX_MOVED_SHARE = 0.4
"""Share of moved walls above which all walls are cast again, which is then as fast."""

T = TypeVar("T")


@dataclass(eq=False)
class Recent(Generic[T]):
    """Results by the bytes that determine them; of more than `most`, the least recently used is dropped."""

    most: int
    kept: dict[bytes, T] = field(default_factory=dict)

    def get(self, key: bytes, make: Callable[[], T]) -> T:
        """Return the result for a key; compute it if it is not cached."""
        found = self.kept.pop(key) if key in self.kept else make()
        while len(self.kept) >= self.most:
            self.kept.pop(next(iter(self.kept)))
        self.kept[key] = found  # the most recently used is last
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class RayPaths:
    """Origins and directions of the rays of all scans."""

    ox: Floats
    """(n_scans, 1) or (n_scans, n_rays) [m, map]"""
    oy: Floats
    ux: Floats
    """(n_scans, n_rays) Unit direction."""
    uy: Floats
    lasers: Floats | None
    """(n_scans, 3) Pose of the laser if all rays of a scan start at once; None: each has its own."""
    bearings: Floats
    """(n_rays,) [rad] Bearings in the horizontal plane."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WallHits:
    """Hits of rays on walls."""

    walls: Floats
    """(n_walls, 2, 2) [m] Walls of the cast."""
    ranges: Floats
    """(n_scans, n_rays) [m]; inf without a hit."""
    wall: Ints
    """(n_scans, n_rays) Index of the wall; -1 without a hit."""


class CastMemory:
    """Cached rays, hits and beams of the scans of one run."""

    def __init__(self) -> None:
        self._rays: Recent[RayPaths] = Recent(MAX_RAYS)
        self._hits: Recent[Recent[WallHits]] = Recent(MAX_RAYS)
        self._beams: Recent[Beams] = Recent(MAX_BEAMS)

    def rays(self, key: bytes, make: Callable[[], RayPaths]) -> RayPaths:
        """Return the rays of a mount and of times."""
        return self._rays.get(key, make)

    def hits(
        self, key: bytes, rays: RayPaths, walls: Floats, cast: Callable[[], tuple[Floats, Ints]]
    ) -> WallHits:
        """Return the hits of the rays of a key; walls that have not moved since another cast are not cast again.

        Parameters
        ----------
        cast : Casts at all walls; returns ranges and walls (n_scans, n_rays).
        """
        earlier = self._hits.get(key, lambda: Recent(MAX_HITS))

        def make() -> WallHits:
            alike = [one for one in earlier.kept.values() if one.walls.shape == walls.shape]
            moved = [np.flatnonzero((walls != one.walls).any(axis=(1, 2))) for one in alike]
            fewest, before = min(
                zip(moved, alike, strict=True), key=lambda pair: len(pair[0]), default=(None, None)
            )
            if fewest is None or before is None or len(fewest) > MAX_MOVED_SHARE * len(walls):
                ranges, wall = cast()
            else:
                ranges, wall = nearest_after_moves(
                    walls, fewest, rays.ox, rays.oy, rays.ux, rays.uy, before.ranges, before.wall
                )
            return WallHits(walls=walls.copy(), ranges=ranges, wall=wall)

        return earlier.get(walls.tobytes(), make)

    def beams(self, key: bytes, make: Callable[[], Beams]) -> Beams:
        """Return the beams of a whole scene, without its surfaces."""
        return self._beams.get(key, make)
