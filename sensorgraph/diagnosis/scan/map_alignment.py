"""Does the arena fit the run at all? If not, the rigid motion or the scale of the map that would make it fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast_laser, laser_poses

CELL = 0.1  # [m] of the raster
NEAR = 0.15  # [m] from a wall: the ray ends at it
HARDLY = 0.3  # share of rays that end at walls, below which no name would mean anything
POORLY = 0.45  # share of rays that end at walls, below which a better place is looked for
PARTLY = 0.8  # share of rays that end at walls, below which another scale of the map is looked for
ALIKE = 0.45  # share of readings as long as the arena makes them, below which the run is of another place
LONGER = (0.15, 0.05)  # [m], of the range, that a reading may differ for that
LOOKED = 100  # scans that are cast for it
CLEARLY = 0.25  # by which another place must be better
SCALES = np.geomspace(0.5, 2.0, 47)  # of the map that are tried, 3 % apart
MARGIN = 0.05  # by which another scale must be better than another place
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
    alike: float = 1.0
    """Share of the readings that are about as long as the arena makes them."""
    scale: float = 1.0
    """How many times as large as the place the arena is drawn; then it, not the poses, is to be mended."""

    @property
    def fits(self) -> bool:
        """Tell whether the map may stay where it is."""
        is_lost = max(self.share, self.best_share) < HARDLY or self.alike < ALIKE
        return not is_lost and self.best_share < max(self.share + CLEARLY, POORLY)

    def sentence(self) -> str:
        """Say how well the arena fits the run, and what would mend it."""
        now = f"{100 * self.share:.0f} % of the returns end within {100 * NEAR:.0f} cm of a wall"
        if self.fits and self.share >= PARTLY:
            return now
        if self.fits:
            return (
                f"the arena fits the run only in part: {now}; it lacks something, or holds what is not there"
            )
        if self.best_share < self.share + CLEARLY:
            longs = f"{100 * self.alike:.0f} % of the readings are as long as the arena would make them"
            return f"the arena does not fit the run: {now}, {longs}; no turn, shift or scale of it would mend that"
        if self.scale != 1.0:
            dx, dy = (round(-d / self.scale, 2) + 0.0 for d in (self.dx, self.dy))
            lead = f"the arena does not fit the run, it is drawn {self.scale:.2f} times as large as the place"
            mend = f"with its coordinates divided by {self.scale:.2f} and moved by ({dx:.2f}, {dy:.2f}) m"
        else:
            lead = "the arena does not fit the run"
            mend = (
                f"with the poses turned by {np.degrees(self.dphi):.1f} degrees about their middle and moved by "
                f"({self.dx:.2f}, {self.dy:.2f}) m"
            )
        return f"{lead}: {now}; {mend} it would be {100 * self.best_share:.0f} %"


def placement(data: ScanData, rng: np.random.Generator) -> Placement:
    """Lay the ends of the measured rays over the walls; where few meet, look for a better place."""
    points = _ends(data, rng)
    if len(points) < 100:
        return Placement(share=1.0, best_share=1.0)
    raster = _Raster(data)
    share, alike = raster.share(points), _alike(data)
    if share >= PARTLY and alike >= ALIKE:
        return Placement(share=share, best_share=share, alike=alike)
    moved = Placement(share=share, best_share=share)
    if share <= POORLY or alike < ALIKE:
        moved = _moved(data, raster, points, share)
    scaled = _scaled(raster, points, share)
    is_better = scaled.best_share > max(moved.best_share + MARGIN, PARTLY)
    return replace(scaled if is_better and not scaled.fits else moved, alike=alike)


def _alike(data: ScanData) -> float:
    """Return the share of the returns that are about as long as the arena makes them.

    In an arena full of walls rays end at one by chance; that they are as long as the first wall allows, they are not.
    """
    some = np.linspace(0, data.n_scans - 1, min(data.n_scans, LOOKED)).astype(np.intp)
    sensor, measured = data.sensor, data.ranges[some]
    lasers = laser_poses(data.poses[some], sensor.mount)
    cast, _ = cast_laser(data.arena.walls, lasers, sensor.bearings, sensor.range_max)
    returned = np.isfinite(measured)
    off = np.abs(measured[returned] - cast[returned])
    return float((off < LONGER[0] + LONGER[1] * measured[returned]).mean()) if returned.any() else 1.0


def _moved(data: ScanData, raster: _Raster, points: Floats, share: float) -> Placement:
    """Look for the rigid motion of the poses that lays most ends of rays on walls."""
    middle = data.poses[:, :2].mean(axis=0)
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


def _scaled(raster: _Raster, points: Floats, share: float) -> Placement:
    """Look for the scale (about the origin, then moved) of all that was measured that lays most ends on walls."""
    shifts, counts = zip(*(raster.correlated(scale * points) for scale in SCALES), strict=True)
    if max(counts) < (share + CLEARLY - 0.1) * len(points):
        return Placement(share=share, best_share=share)
    found = [_rescaled(raster, points, float(SCALES[k]), shifts[k]) for k in np.argsort(counts)[-3:]]
    _, scale, shift = max(found, key=lambda one: one[0])
    best_share = raster.share(scale * points + shift)
    return Placement(share=share, best_share=best_share, dx=float(shift[0]), dy=float(shift[1]), scale=scale)


def _rescaled(raster: _Raster, points: Floats, scale: float, shift: Floats) -> tuple[float, float, Floats]:
    """Improve a scale by small steps about the middle of the points; return score, scale, shift.

    It stays near where it began: all points on one spot of a wall would be a perfect fit.
    """
    low, high = 0.95 * scale, 1.05 * scale
    middle = points.mean(axis=0)
    best = (raster.score(scale * points + shift), scale, shift)
    step, size = 0.015, 0.1
    while size > 1e-3:
        before = best[0]
        for ds, dx, dy in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)):
            s = float(np.clip(best[1] * (1 + ds * step), low, high))
            t = best[2] + (best[1] - s) * middle + np.array([dx, dy]) * size
            score = raster.score(s * points + t)
            if score > best[0]:
                best = (score, s, t)
        if best[0] == before:
            step, size = 0.5 * step, 0.5 * size
    return best


def _ends(data: ScanData, rng: np.random.Generator) -> Floats:
    """Return where some of the measured rays end, (n, 2) [m, map]."""
    lasers = laser_poses(data.poses, data.sensor.mount)
    scan, ray = np.nonzero(data.returned)
    if len(scan) > N_POINTS:
        some = rng.choice(len(scan), N_POINTS, replace=False)
        scan, ray = scan[some], ray[some]
    phi = lasers[scan, 2] + data.sensor.bearings[ray]
    r = data.ranges[scan, ray]
    return np.stack([lasers[scan, 0] + r * np.cos(phi), lasers[scan, 1] + r * np.sin(phi)], axis=1)


def _rotation(turn: float) -> Floats:
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s], [s, c]])


class _Raster:
    """Walls in a grid, with the distance to the nearest."""

    def __init__(self, data: ScanData) -> None:
        walls = data.arena.walls
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
        from scipy.signal import fftconvolve  # 0.3 s to import, for a map that fits badly only

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
