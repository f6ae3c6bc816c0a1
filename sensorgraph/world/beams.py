"""Beams: the distribution of the reading of every ray of a run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sensorgraph.types import Bools, Floats, Ints


@dataclass(eq=False)
class Beams:
    """Every ray of every scan; arrays are (n_scans, n_rays) unless stated otherwise."""

    ox: Floats
    """(n_scans, 1) or (n_scans, n_rays) [m] Origin in map."""
    oy: Floats
    ux: Floats
    """Unit direction in map."""
    uy: Floats
    ranges: Floats
    """[m] Length of the straight path to the hit; inf without a hit."""
    wall: Ints
    """Index in `Scene.walls`; -1 none, DISC_WALL a round obstacle, below it a mover."""
    nx: Floats
    """Unit normal of the surface hit, facing the ray (n . u <= 0); 0 without a hit."""
    ny: Floats
    reading: Floats
    """[m] Expected value of a return."""
    slope: Floats | float = 1.0
    """Derivative of the reading with respect to the range."""
    p_return: Floats | float = 1.0
    """Probability that the ray returns, apart from the limits of the sensor."""
    sigma: Floats | float = 0.01
    """[m] Standard deviation of a return."""
    straight: Bools | None = None
    """Whether the reading follows from `ranges` by `slope`; None: everywhere."""
    within: Bools | None = None
    """Whether the nearest surface is inside a cone, not at its edge, so that rotation changes nothing; None:
    nowhere."""

    @property
    def cosine(self) -> Floats:
        """Cosine of the incidence, 1 = head-on; 0 without a hit."""
        return np.asarray(-(self.nx * self.ux + self.ny * self.uy))

    @cached_property
    def incidence(self) -> Floats:
        """[rad] Angle between ray and normal, 0 = head-on; nan without a hit."""
        hit = np.isfinite(self.ranges)
        return np.where(hit, np.arccos(np.clip(self.cosine, -1.0, 1.0)), np.nan)

    def forget(self) -> None:
        """Discard values derived from rays that have changed."""
        self.__dict__.pop("incidence", None)

    def towards(self, x: Floats | float, y: Floats | float) -> tuple[Floats, Floats]:
        """Return the distances [m] of a point along each ray and to the right of it.

        Parameters
        ----------
        x, y : [m, map] One point, or arrays that broadcast with the rays.
        """
        dx, dy = x - self.ox, y - self.oy
        return dx * self.ux + dy * self.uy, dx * self.uy - dy * self.ux

    def along(self, walls: Floats, which: Bools | None = None) -> Floats:
        """Return the distance [m] of each hit from the first end of its wall; nan without a wall, and outside `which`."""
        on = self.wall >= 0 if which is None else which & (self.wall >= 0)
        out = np.full(self.wall.shape, np.nan)
        a, b = walls[self.wall[on]].transpose(1, 2, 0)
        r = self.ranges[on]
        r = np.where(np.isfinite(r), r, 0.0)
        ox, oy = (np.broadcast_to(o, on.shape)[on] for o in (self.ox, self.oy))
        dx, dy = b - a
        length = np.maximum(np.hypot(dx, dy), 1e-12)
        out[on] = ((ox + r * self.ux[on] - a[0]) * dx + (oy + r * self.uy[on] - a[1]) * dy) / length
        return out

    def bent(self) -> Bools:
        """Return `straight` as a separate, writable array."""
        if self.straight is None:
            self.straight = np.ones(self.ranges.shape, dtype=np.bool_)
        return self.straight
