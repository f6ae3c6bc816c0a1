"""A truncated signed distance field (Curless & Levoy 1996) in 5 cm cells, cast with bilinear interpolation.

Each cell near a ray's end keeps the mean of its distance to that end, positive on the near side; a ray stops where
the field changes sign. The threshold is the weight below which a cell counts as unknown. As for the grid, a ray
that meets no surface is given the place where the field is least.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from planners.types import Bools, Floats

TSDF_CELL = 0.05  # [m]
TSDF_STEP = 0.025  # [m]
TSDF_MAX_HIT = 10.0  # [m]
TRUNCATION = 0.15  # [m]


class Tsdf:
    """Mean signed distance and weight of each cell."""

    name: ClassVar[str] = "tsdf"
    thresholds: ClassVar[tuple[float, ...]] = (0.2, 0.5, 1.0, 2.0, 4.0)

    def __init__(self, poses: Floats, ranges: Floats, bearings: Floats) -> None:
        self.bearings = bearings
        self.low = poses[:, :2].min(axis=0) - TSDF_MAX_HIT - 3 * TSDF_CELL
        high = poses[:, :2].max(axis=0) + TSDF_MAX_HIT + 3 * TSDF_CELL
        self.shape = np.ceil((high - self.low) / TSDF_CELL).astype(np.int64)
        n_cells = int(self.shape.prod())
        total, weight = np.zeros(n_cells), np.zeros(n_cells)
        steps = np.arange(TSDF_STEP / 2, TSDF_MAX_HIT + TRUNCATION, TSDF_STEP)
        for start in range(0, len(poses), 16):
            p, r = poses[start : start + 16], ranges[start : start + 16]
            angle = p[:, 2:3] + bearings
            c, s = np.cos(angle)[:, :, None], np.sin(angle)[:, :, None]
            x, y = p[:, 0, None, None] + steps * c, p[:, 1, None, None] + steps * s
            i = ((x - self.low[0]) / TSDF_CELL).astype(np.int64)
            j = ((y - self.low[1]) / TSDF_CELL).astype(np.int64)
            hit = (np.isfinite(r) & (r > 0.1) & (r < TSDF_MAX_HIT))[:, :, None]
            beyond = np.where(r >= TSDF_MAX_HIT, TSDF_MAX_HIT, 0.0)[:, :, None]
            end = np.where(hit, np.nan_to_num(r, posinf=TSDF_MAX_HIT, neginf=0.0)[:, :, None], beyond)
            along = ((i + 0.5) * TSDF_CELL + self.low[0] - p[:, 0, None, None]) * c  # of the cell's middle
            along = along + ((j + 0.5) * TSDF_CELL + self.low[1] - p[:, 1, None, None]) * s
            distance = np.where(hit, np.clip((end - along) / TRUNCATION, -1, 1), 1.0)
            use = (steps < np.where(hit, end + TRUNCATION, end)) & (i < self.shape[0]) & (j < self.shape[1])
            cell = (i * self.shape[1] + j)[use]
            total += np.bincount(cell, weights=distance[use], minlength=n_cells) * (TSDF_STEP / TSDF_CELL)
            weight += np.bincount(cell, minlength=n_cells) * (TSDF_STEP / TSDF_CELL)
        self.weight = weight.reshape(self.shape)
        self.mean = (total / np.maximum(weight, 1e-9)).reshape(self.shape)

    def cast(self, poses: Floats, threshold: float) -> tuple[Floats, Bools]:
        """March each ray; return ranges (n, n_rays) [m] and whether the field changes sign."""
        steps = np.arange(TSDF_STEP / 2, TSDF_MAX_HIT, TSDF_STEP)
        ranges = np.empty((len(poses), len(self.bearings)))
        found = np.empty(ranges.shape, dtype=np.bool_)
        for start in range(0, len(poses), 16):
            p = poses[start : start + 16]
            angle = (p[:, 2:3] + self.bearings)[:, :, None]
            field, known = self._at(
                p[:, 0, None, None] + steps * np.cos(angle),
                p[:, 1, None, None] + steps * np.sin(angle),
                threshold,
            )
            change = (field[..., :-1] > 0) & (field[..., 1:] <= 0) & known[..., :-1] & known[..., 1:]
            hit = change.any(axis=2)
            first = np.where(hit, change.argmax(axis=2), 0)[..., None]
            before, after = (np.take_along_axis(field, k, axis=2)[..., 0] for k in (first, first + 1))
            crossing = steps[first[..., 0]] + TSDF_STEP * before / np.where(hit, before - after, 1.0)
            guess = steps[np.where(known, field, np.inf).argmin(axis=2)]
            ranges[start : start + 16] = np.where(
                hit, crossing, np.where(known.any(axis=2), guess, TSDF_MAX_HIT)
            )
            found[start : start + 16] = hit
        return ranges, found

    def _at(self, x: Floats, y: Floats, threshold: float) -> tuple[Floats, Bools]:
        """Interpolate the field at places between the middles of four cells; all four must be known."""
        u, v = (x - self.low[0]) / TSDF_CELL - 0.5, (y - self.low[1]) / TSDF_CELL - 0.5
        u, v = np.clip(u, 0, self.shape[0] - 2), np.clip(v, 0, self.shape[1] - 2)
        i, j = u.astype(np.int64), v.astype(np.int64)
        value, known = np.zeros(x.shape), np.ones(x.shape, dtype=np.bool_)
        for di in (0, 1):
            for dj in (0, 1):
                share = (u - i if di else 1 - u + i) * (v - j if dj else 1 - v + j)
                value += share * self.mean[i + di, j + dj]
                known &= self.weight[i + di, j + dj] >= threshold
        return value, known
