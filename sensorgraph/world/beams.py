"""Beams: what every ray of a run would read, as a distribution."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sensorgraph.types import Bools, Floats, Ints


@dataclass(eq=False)
class Beams:
    """Every ray of every scan; arrays (n_scans, n_rays) unless said otherwise."""

    ox: Floats
    """(n_scans, 1) or (n_scans, n_rays) [m] origin in map."""
    oy: Floats
    ux: Floats
    """Unit direction in map."""
    uy: Floats
    ranges: Floats
    """[m] length of the straight path to what is hit; inf where nothing is."""
    wall: Ints
    """Index in `Scene.walls`; -1 nothing, DISC a round obstacle, below it a mover."""
    nx: Floats
    """Unit normal of what is hit, facing the ray (n . u <= 0); 0 where nothing is hit."""
    ny: Floats
    reading: Floats
    """[m] expected value of a return."""
    slope: Floats | float = 1.0
    """d reading / d range."""
    p_return: Floats | float = 1.0
    """Chance that the ray returns at all, the sensor's limits aside."""
    sigma: Floats | float = 0.01
    """[m] standard deviation of a return."""
    straight: Bools | None = None
    """Where the reading follows from `ranges` by `slope`; None: everywhere."""
    within: Bools | None = None
    """Where the nearest surface lies inside a cone, not at its edge, so that turning changes nothing; None: nowhere."""

    @property
    def cosine(self) -> Floats:
        """Cosine of the incidence, 1 = head-on; 0 where nothing is hit."""
        return np.asarray(-(self.nx * self.ux + self.ny * self.uy))

    @cached_property
    def incidence(self) -> Floats:
        """[rad] between ray and normal, 0 = head-on; nan where nothing is hit."""
        hit = np.isfinite(self.ranges)
        return np.where(hit, np.arccos(np.clip(self.cosine, -1.0, 1.0)), np.nan)

    def forget(self) -> None:
        """Forget what was derived from rays that have changed since."""
        self.__dict__.pop("incidence", None)

    def towards(self, x: Floats | float, y: Floats | float) -> tuple[Floats, Floats]:
        """Return how far ahead on each ray a place lies, and how far it lies to the right of it [m].

        Parameters
        ----------
        x, y : [m, map] one place, or as the rays broadcast
        """
        dx, dy = x - self.ox, y - self.oy
        return dx * self.ux + dy * self.uy, dx * self.uy - dy * self.ux

    def along(self, walls: Floats, which: Bools | None = None) -> Floats:
        """Return how far [m] from the first end of its wall each ray hits; nan off the walls, and for rays not asked for."""
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
        """Return `straight`, made an array of its own to write in."""
        if self.straight is None:
            self.straight = np.ones(self.ranges.shape, dtype=np.bool_)
        return self.straight
