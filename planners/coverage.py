"""Coverage: the (x, y, phi) bins that a robot can reach, and those that it has visited."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from planners.arena import wrap
from planners.types import Bools, Floats, Ints

CELL, HEADINGS = 0.25, 16
"""[m] Default side of a position cell; default number of heading bins."""
DWELL_PERIODS = 1.25
"""Minimum stay in a heading bin, in log periods. One period suffices for a log of any phase; the extra quarter
covers the sampling error of entry and exit times (`python -m benchmarks.coverage_planners`)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Coverage:
    """Counts of logged poses in even bins; heading bin k is centred on k 2π/headings."""

    origin: Floats
    """(2,) [m] lower left corner."""
    cell: float
    """[m] side of a position cell."""
    reachable: Bools
    """(nx, ny, n_phi) reachable bins; only these count."""
    counts: Ints
    """(nx, ny, n_phi) number of logged poses; filled by `add`."""
    core: Ints
    """(nx, ny, n_phi) number of logged poses in the inner half of the bin, along x, y and phi."""

    @classmethod
    def empty(cls, *, origin: Floats, cell: float, cells: Bools, headings: int) -> Coverage:
        """Return a grid without poses, in which every heading of `cells` (nx, ny) is reachable."""
        shape = (*cells.shape, headings)
        reachable = np.repeat(cells[:, :, None], headings, axis=2)
        zeros = np.zeros(shape, dtype=np.int64)
        return cls(origin=origin, cell=cell, reachable=reachable, counts=zeros, core=zeros.copy())

    @property
    def headings(self) -> int:
        """Number of heading bins."""
        return int(self.counts.shape[2])

    @property
    def edges(self) -> tuple[Floats, Floats, Floats]:
        """Bin edges: x (nx + 1,) [m], y (ny + 1,) [m], phi (n_phi + 1,) [rad] from minus half a bin."""
        nx, ny, n_phi = self.counts.shape
        x, y = (low + self.cell * np.arange(n + 1) for low, n in zip(self.origin, (nx, ny), strict=True))
        return x, y, (np.arange(n_phi + 1) - 0.5) * (2 * np.pi / n_phi)

    def bins(self, poses: Floats) -> tuple[Ints, Bools]:
        """Return the bins (n, 3) of poses (n, 3) [m, m, rad], and whether each (n,) is within the grid."""
        nx, ny, n_phi = self.counts.shape
        cells = np.floor((poses[:, :2] - self.origin) / self.cell).astype(np.int64)
        heading = np.floor(poses[:, 2] / (2 * np.pi / n_phi) + 0.5).astype(np.int64) % n_phi
        inside = np.asarray(((cells >= 0) & (cells < (nx, ny))).all(axis=1), dtype=np.bool_)
        return np.column_stack([cells, heading]), inside

    def add(self, poses: Floats) -> None:
        """Count logged poses (n, 3) [m, m, rad]; skip those that are not finite or outside the grid."""
        poses = poses[np.isfinite(poses).all(axis=1)]
        bins, inside = self.bins(poses)
        poses, bins = poses[inside], bins[inside]
        flat = np.ravel_multi_index(tuple(bins.T), self.counts.shape)
        place = (poses[:, :2] - self.origin) / self.cell - bins[:, :2] - 0.5
        width = 2 * np.pi / self.headings
        turn = wrap(np.subtract(poses[:, 2], bins[:, 2] * width, dtype=np.float64)) / width
        is_core = (abs(place) <= 0.25).all(axis=1) & (abs(turn) <= 0.25)
        self.counts.ravel()[:] += np.bincount(flat, minlength=self.counts.size)
        self.core.ravel()[:] += np.bincount(flat[is_core], minlength=self.counts.size)

    def growth(self, stamps: Floats, poses: Floats, n: int = 400) -> tuple[Floats, Floats]:
        """Return times (n,) [s] and the share (n,) of reachable bins visited by poses (m, 3) up to each time."""
        finite = np.isfinite(poses).all(axis=1)
        bins, inside = self.bins(poses[finite])
        flat = np.ravel_multi_index(tuple(bins[inside].T), self.counts.shape)
        _, first = np.unique(flat, return_index=True)
        first = first[self.reachable.ravel()[flat[first]]]
        when = np.sort(stamps[finite][inside][first])
        times = np.linspace(stamps[0], stamps[-1], n)
        return times, np.searchsorted(when, times, side="right") / max(int(self.reachable.sum()), 1)

    @property
    def covered(self) -> Bools:
        """(nx, ny, n_phi) reachable bins with at least one pose."""
        return np.asarray((self.counts > 0) & self.reachable)

    @property
    def fraction(self) -> float:
        """Share of the reachable bins with at least one pose."""
        return float(self.covered.sum() / max(self.reachable.sum(), 1))

    @property
    def core_fraction(self) -> float:
        """Share of the reachable bins with a pose in their inner half."""
        return float(((self.core > 0) & self.reachable).sum() / max(self.reachable.sum(), 1))

    def holes(self) -> Floats:
        """Return the centres (n, 3) [m, m, rad] of reachable bins without a pose."""
        return self.centres(np.asarray(self.reachable & (self.counts == 0)))

    def centres(self, where: Bools) -> Floats:
        """Return the centres (n, 3) [m, m, rad] of the bins `where` (nx, ny, n_phi)."""
        bins = np.argwhere(where)
        places = self.origin + (bins[:, :2] + 0.5) * self.cell
        return np.column_stack(
            [places, wrap(np.multiply(bins[:, 2], 2 * np.pi / self.headings, dtype=np.float64))]
        )

    def dispersion(self) -> tuple[float, float]:
        """Return the largest distances from a reachable bin to a covered one.

        The first is over the floor at the same heading [m], the second by turning on the spot [rad]. Each is
        inf if a heading, or a position, has no covered bin.
        """
        covered = self.covered
        if not self.reachable.any():
            return 0.0, 0.0
        away = np.full(covered.shape, np.inf)
        for k in np.flatnonzero(covered.any(axis=(0, 1))).tolist():
            away[:, :, k] = ndimage.distance_transform_edt(~covered[:, :, k], sampling=self.cell)
        n_phi = self.headings
        turn = np.full(covered.shape, np.inf)
        for k in range(n_phi):
            steps = min(k, n_phi - k)
            turn = np.minimum(turn, np.where(np.roll(covered, k, axis=2), steps, np.inf))
        return float(away[self.reachable].max()), float(turn[self.reachable].max() * 2 * np.pi / n_phi)
