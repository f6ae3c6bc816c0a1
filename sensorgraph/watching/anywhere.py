"""Readings from anywhere in a place, and in space that no training ray crossed.

With the density p_0 of a reading from anywhere and its survival function S_0, obstacles stop a ray at the rate p_0 / S_0 per
metre. Nothing else is known of unseen space, so that it has this rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from planners.kernel import outer_kernel
from sensorgraph.models.cells.grid import CellIndices, max_cells_met, traverse
from sensorgraph.models.seen_space import SeenSpace
from sensorgraph.types import Bools, Floats

N_BINS = 30
LEAST_NONE = 0.02
"""Least share of readings without a return."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AnyReading:
    """Distribution of readings at poses anywhere in a place."""

    edges: Floats
    """(n_bins + 1,) [m] of the bins of returns."""
    density: Floats
    """(n_bins,) [1/m]"""
    p_none: float
    """Probability of no return."""

    @classmethod
    def of(cls, ranges: Floats, n_none: float, range_max: float) -> Self:
        """Return the distribution of ranges (n,) [m] and of a number of missing returns; each bin has one reading in addition."""
        edges = np.concatenate([[0.0], np.geomspace(0.3, max(range_max, 1.0), N_BINS)])
        counts = np.histogram(ranges[ranges < range_max], edges)[0] + 1.0
        p_none = max((n_none + 1.0) / (counts.sum() + n_none + 1.0), LEAST_NONE)
        return cls(
            edges=edges, density=(1.0 - p_none) * counts / counts.sum() / np.diff(edges), p_none=p_none
        )

    def log_density(self, z: Floats) -> Floats:
        """Return log p_0 of readings [m]; +inf: no return."""
        index = np.searchsorted(self.edges, np.nan_to_num(z, posinf=0.0)) - 1
        density = self.density[np.clip(index, 0, len(self.density) - 1)]
        return np.asarray(np.log(np.where(np.isposinf(z), self.p_none, density)))

    def log_survival(self, r: Floats) -> Floats:
        """Return log S_0 of ranges [m], the probability that a reading is longer."""
        below = np.concatenate([[0.0], np.cumsum(self.density * np.diff(self.edges))])
        return np.asarray(np.log(np.maximum(1.0 - np.interp(r, self.edges, below), self.p_none)))


@dataclass(frozen=True, kw_only=True, eq=False)
class UnseenSpace:
    """Space that no training ray crossed."""

    seen: SeenSpace
    """The rest of the space."""
    log_survival: Floats
    """(n,) log S_0 at multiples of half a side."""

    @classmethod
    def of(cls, seen: SeenSpace, anywhere: AnyReading) -> Self:
        """Return the space outside the cells that are seen."""
        steps = np.arange(math.ceil(2.0 * anywhere.edges[-1] / seen.resolution) + 2)
        return cls(seen=seen, log_survival=anywhere.log_survival(0.5 * seen.resolution * steps))

    def contains(self, points: Floats) -> Bools:
        """Tell which points (..., 2) [m, map] are in it."""
        return ~self.seen.contains(points)

    def log_passed(self, starts: Floats, headings: Floats, lengths: Floats) -> Floats:
        """Return the logarithm (n_poses, n_rays) of the probability that it lets rays pass.

        Parameters
        ----------
        starts : (n_poses, n_rays or 1, 2) [m, map]
        headings : (n_poses, n_rays) [rad]
        lengths : (n_rays,) [m] finite.
        """
        out, side = np.empty(headings.shape), self.seen.resolution
        starts = np.broadcast_to(starts, (*headings.shape, 2)) - self.seen.origin
        n_cells = max_cells_met(float(lengths.max(initial=0.0)), side)
        at, ends = np.empty((n_cells, 2), dtype=np.int64), np.empty(n_cells)
        _follow(starts, headings, lengths, side, self.seen.cells, self.log_survival, at, ends, out)
        return out


@outer_kernel
def _follow(
    starts: Floats, headings: Floats, lengths: Floats, side: float, seen: Bools, log_survival: Floats,
    at: CellIndices, ends: Floats, out: Floats,
) -> None:  # fmt: skip
    """Fill out (n_poses, n_rays) with the sum of the changes of log S_0 over the unseen cells of each ray."""
    for k in range(headings.shape[0]):
        for b in range(headings.shape[1]):
            c, s = math.cos(headings[k, b]), math.sin(headings[k, b])
            n = traverse(starts[k, b, 0], starts[k, b, 1], c, s, lengths[b], side, at, ends)
            before, passed = 0.0, 0.0
            for m in range(n):
                i, j = at[m]
                step = min(2.0 * ends[m] / side, len(log_survival) - 1.0)
                low = min(int(step), len(log_survival) - 2)
                after = log_survival[low] + (step - low) * (log_survival[low + 1] - log_survival[low])
                if not (0 <= i < seen.shape[0] and 0 <= j < seen.shape[1] and seen[i, j]):
                    passed += after - before
                before = after
            out[k, b] = passed
