"""Raster of the walls of a map, and the motion or the scale that puts most points on them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.optimize import minimize

from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Floats

SETTINGS = SCAN.alignment
SCALES = np.geomspace(*SETTINGS.scale_range, SETTINGS.n_scales)
"""Scales of the map that are tried."""
SCALE_STEP = float(SCALES[1] / SCALES[0])
"""Ratio of two successive scales."""


def rotation(turn: float) -> Floats:
    """Return the matrix (2, 2) of a rotation by `turn` [rad]."""
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s], [s, c]])


class WallRaster:
    """Grid of the walls, with the distance to the nearest one."""

    def __init__(self, walls: Floats) -> None:
        low = walls.reshape(-1, 2).min(axis=0) - 1.0
        high = walls.reshape(-1, 2).max(axis=0) + 1.0
        self.cell = max(SETTINGS.cell, float((high - low).max()) / SETTINGS.max_cells)
        self.low = low
        shape = np.ceil((high - low) / self.cell).astype(int) + 1
        taken = np.zeros(shape, dtype=np.bool_)
        step = np.diff(walls, axis=1)[:, 0]
        n = (np.hypot(*step.T) / self.cell * 3).astype(int) + 2
        part = np.concatenate([np.linspace(0, 1, k) for k in n])
        at = np.repeat(walls[:, 0] - low, n, axis=0) + part[:, None] * np.repeat(step, n, axis=0)
        taken[tuple((at / self.cell).round().astype(int).T)] = True
        self.distance = distance_transform_edt(~taken) * self.cell
        self.near = (self.distance < SETTINGS.wall_distance).astype(np.float64)
        self.middle = (low + high) / 2

    def score(self, points: Floats) -> float:
        """Return the mean proximity of points to walls: 1 on a wall, decreasing over the wall distance."""
        at = (points - self.low) / self.cell
        distance = map_coordinates(self.distance, at.T, order=1, mode="nearest")
        return float(np.exp(-0.5 * (distance / (0.5 * SETTINGS.wall_distance)) ** 2).mean())

    def share(self, points: Floats) -> float:
        """Return the share of points at a wall."""
        at = ((points - self.low) / self.cell).round().astype(int)
        inside = ((at >= 0) & (at < self.near.shape)).all(axis=1)
        got = np.zeros(len(points))
        got[inside] = self.near[at[inside, 0], at[inside, 1]]
        return float(got.mean())

    def correlated(self, points: Floats) -> tuple[Floats, float]:
        """Return the shift [m] that puts most points on walls, and the number of these points."""
        from scipy.signal import (
            fftconvolve,
        )  # 0.3 s to import; needed only if a map fits badly

        low = points.min(axis=0)
        at = ((points - low) / self.cell).round().astype(int)
        shape = np.minimum(at.max(axis=0) + 1, 900)
        at = at[(at < shape).all(axis=1)]
        count = np.zeros(shape)
        np.add.at(count, (at[:, 0], at[:, 1]), 1.0)
        table = fftconvolve(self.near, count[::-1, ::-1])
        i, j = np.unravel_index(int(table.argmax()), table.shape)
        lag = np.array([i - (shape[0] - 1), j - (shape[1] - 1)])
        return self.low + lag * self.cell - low, float(table[i, j])


def improved(
    raster: WallRaster, points: Floats, turn: float, scale: float, shift: Floats, *, by_scale: bool = False
) -> tuple[float, float, float, Floats]:
    """Improve the similarity `scale R(turn) points + shift` by the simplex method (Nelder and Mead 1965).

    The centroid of the points moves, and they turn about it, or they are scaled about it. A scale stays within one step
    of its start, because all points on one spot of a wall would be a perfect fit.

    Returns
    -------
    score, turn, scale, shift
    """
    middle = points.mean(axis=0)
    off = points - middle
    reach = scale * float(np.sqrt(np.square(off).sum(axis=1).mean())) + raster.cell
    start = scale * rotation(turn) @ middle + shift

    def placement(x: Floats) -> tuple[float, float, Floats]:
        """Return turn, scale and centroid after a step (3,) [m]; the first is that of a point at the mean distance."""
        part = x[0] / reach
        turned, scaled = (turn, scale * np.exp(part)) if by_scale else (turn + part, scale)
        return turned, scaled, start + x[1:]

    def misfit(x: Floats) -> float:
        turned, scaled, centroid = placement(x)
        return -raster.score(scaled * off @ rotation(turned).T + centroid)

    most = reach * np.log(SCALE_STEP) if by_scale else np.inf
    found = minimize(
        misfit, np.zeros(3), method="Nelder-Mead", bounds=[(-most, most), (None, None), (None, None)],
        options={"initial_simplex": np.vstack([np.zeros(3), raster.cell * np.eye(3)]), "xatol": 1e-3, "fatol": 1e-5},
    )  # fmt: skip
    turned, scaled, centroid = placement(found.x)
    return -float(found.fun), turned, scaled, centroid - scaled * rotation(turned) @ middle
