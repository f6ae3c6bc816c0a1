"""Does the arena fit the run at all? If not, the rigid motion of the map that would make it fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.signal import fftconvolve

from planners.arena import Floats
from sensorgraph.diagnose.evidence import Evidence
from sensorgraph.world.raycast import laser_poses

CELL = 0.1  # [m] of the raster
NEAR = 0.15  # [m] from a wall: the ray ends at it
POORLY = 0.45  # share of rays that end at walls, below which a better place is looked for
CLEARLY = 0.25  # by which another place must be better
N_POINTS = 3000
N_TURNS = 90


@dataclass(frozen=True, kw_only=True)
class Placement:
    """How many rays end at walls, as the map lies and as it would have to lie."""

    share: float
    """Of the returns that end within NEAR of a wall."""
    best_share: float
    """The same after the motion below."""
    dx: float = 0.0
    """[m] to be added to the poses, after turning them about their middle."""
    dy: float = 0.0
    dphi: float = 0.0
    """[rad] by which the poses are to be turned about their middle."""

    @property
    def fits(self) -> bool:
        """Tell whether the map may stay where it is."""
        return self.best_share < max(self.share + CLEARLY, POORLY)


def placement(evidence: Evidence, rng: np.random.Generator) -> Placement:
    """Lay the ends of the measured rays over the walls; where few meet, look for a better place."""
    points = _ends(evidence, rng)
    if len(points) < 100:
        return Placement(share=1.0, best_share=1.0)
    raster = _Raster(evidence)
    share = raster.share(points)
    if share > POORLY:
        return Placement(share=share, best_share=share)
    middle = evidence.poses[:, :2].mean(axis=0)
    points = points - middle
    best = (share, 0.0, middle)
    for turn in np.linspace(-np.pi, np.pi, N_TURNS, endpoint=False):
        turned = points @ _rotation(turn).T
        shift, count = raster.correlated(turned)
        if count / len(points) > best[0] - 0.1:
            got = _refined(raster, points, turn, shift)
            if got[0] > best[0]:
                best = got
    shift = best[2] - middle
    return Placement(
        share=share, best_share=best[0], dx=float(shift[0]), dy=float(shift[1]), dphi=float(best[1])
    )


def _ends(evidence: Evidence, rng: np.random.Generator) -> Floats:
    """Return where some of the measured rays end, (n, 2) [m, map]."""
    lasers = laser_poses(evidence.poses, evidence.sensor.mount)
    scan, ray = np.nonzero(evidence.returned)
    if len(scan) > N_POINTS:
        some = rng.choice(len(scan), N_POINTS, replace=False)
        scan, ray = scan[some], ray[some]
    phi = lasers[scan, 2] + evidence.sensor.bearings[ray]
    r = evidence.ranges[scan, ray]
    return np.stack([lasers[scan, 0] + r * np.cos(phi), lasers[scan, 1] + r * np.sin(phi)], axis=1)


def _rotation(turn: float) -> Floats:
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s], [s, c]])


class _Raster:
    """Walls in a grid, with the distance to the nearest."""

    def __init__(self, evidence: Evidence) -> None:
        walls = evidence.arena.walls
        low = walls.reshape(-1, 2).min(axis=0) - 1.0
        high = walls.reshape(-1, 2).max(axis=0) + 1.0
        self.cell = max(CELL, float((high - low).max()) / 600)
        self.low = low
        shape = np.ceil((high - low) / self.cell).astype(int) + 1
        taken = np.zeros(shape, dtype=np.bool_)
        for a, b in walls:
            n = int(np.hypot(*(b - a)) / self.cell * 3) + 2
            at = ((a + np.linspace(0, 1, n)[:, None] * (b - a) - low) / self.cell).round().astype(int)
            taken[at[:, 0], at[:, 1]] = True
        self.distance = distance_transform_edt(~taken) * self.cell
        self.near = (self.distance < NEAR).astype(np.float64)
        self.middle = (low + high) / 2

    def score(self, points: Floats) -> float:
        """Return how near the points are to walls: 1 on them, falling over NEAR."""
        at = (points - self.low) / self.cell
        distance = map_coordinates(self.distance, at.T, order=1, mode="nearest")
        return float(np.exp(-0.5 * (distance / (0.5 * NEAR)) ** 2).mean())

    def share(self, points: Floats) -> float:
        """Return the share of points within NEAR of a wall."""
        at = ((points - self.low) / self.cell).round().astype(int)
        inside = ((at >= 0) & (at < self.near.shape)).all(axis=1)
        got = np.zeros(len(points))
        got[inside] = self.near[at[inside, 0], at[inside, 1]]
        return float(got.mean())

    def correlated(self, points: Floats) -> tuple[Floats, float]:
        """Return the shift [m] that lays most points on walls, and how many."""
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


def _refined(raster: _Raster, points: Floats, turn: float, shift: Floats) -> tuple[float, float, Floats]:
    """Improve a placement by small steps; return share, turn, shift."""
    best = (raster.score(points @ _rotation(turn).T + shift), turn, shift)
    step, size = np.radians(2.0), 0.1
    for _ in range(40):
        before = best[0]
        for dt, dx, dy in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)):
            t, s = best[1] + dt * step, best[2] + np.array([dx, dy]) * size
            if dt:  # turn about the middle of the points
                centre = points.mean(axis=0)
                s = s + (_rotation(best[1]) - _rotation(t)) @ centre
            score = raster.score(points @ _rotation(t).T + s)
            if score > best[0]:
                best = (score, t, s)
        if best[0] == before:
            step, size = step * 0.5, size * 0.5
        if size < 1e-3:
            break
    return raster.share(points @ _rotation(best[1]).T + best[2]), best[1], best[2]
