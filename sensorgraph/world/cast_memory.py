"""What is kept between casts of the same scans: their rays, and what these met.

A fit casts the same scans again and again with one obstacle moved, or one disc more. Rays whose mount and times are
the same are the same rays; where few walls have moved, only these are met anew, and only the rays that had stopped at
one of them look for another.
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
"""So many sets of rays, of what they meet, and of what a sensor so sees are kept."""
MAX_MOVED_SHARE = 0.4
"""Of the walls; if more have moved, all are cast anew, which takes as long."""

T = TypeVar("T")


@dataclass(eq=False)
class Recent(Generic[T]):
    """Results by the bytes that they follow from; of more than `most` the one unused longest is forgotten."""

    most: int
    kept: dict[bytes, T] = field(default_factory=dict)

    def get(self, key: bytes, make: Callable[[], T]) -> T:
        """Return what is kept under a key, made where there is nothing."""
        found = self.kept.pop(key) if key in self.kept else make()
        while len(self.kept) >= self.most:
            self.kept.pop(next(iter(self.kept)))
        self.kept[key] = found  # the one used last stands last
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class RayPaths:
    """Where the rays of all scans begin and go."""

    ox: Floats
    """(n_scans, 1) or (n_scans, n_rays) [m, map]"""
    oy: Floats
    ux: Floats
    """(n_scans, n_rays) unit direction."""
    uy: Floats
    lasers: Floats | None
    """(n_scans, 3) pose of the laser where all rays of a scan begin at once; None: each has its own."""
    bearings: Floats
    """(n_rays,) [rad] as seen from above."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WallHits:
    """What rays met."""

    walls: Floats
    """(n_walls, 2, 2) [m] that they were cast at."""
    ranges: Floats
    """(n_scans, n_rays) [m]; inf nothing."""
    wall: Ints
    """(n_scans, n_rays) index of the wall; -1 nothing."""


class CastMemory:
    """Rays, hits and beams of one run's scans."""

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
        """Return what the rays of a key meet; only walls that have moved since another cast are met anew.

        Parameters
        ----------
        cast : meet all walls, and return ranges and walls (n_scans, n_rays)
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
        """Return the beams of a whole scene without its surfaces."""
        return self._beams.get(key, make)
