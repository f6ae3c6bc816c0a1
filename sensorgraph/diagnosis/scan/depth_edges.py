"""Edges in depth: rays that a small error of pose or map takes past the end of a surface, and what they read there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.ray_order import neighbouring_rays

SETTINGS = SCAN.likelihood
MIN_END_RANGE = 0.05
"""[m] range of the nearer side of an edge, at least: map and pose errors turn it by their size over the range."""
GRAZING = -0.02
"""Cosine against the normal, above which a ray does not meet the extension of a wall."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Edges:
    """Rays so near a step in depth that a small error of pose or map takes them to its other side."""

    index: tuple[Ints, Ints]
    """Indices (scan, ray) of k rays."""
    other: Floats
    """(k,) [m] what they would read on the other side."""
    chance: Floats
    """(k,) of being there."""


def find_edges(data: ScanData, beams: Beams, walls: Floats) -> Edges | None:
    """Find the rays next to a step in depth, and what they would read beyond it."""
    t = data.tolerances
    ranges, wall = beams.ranges, beams.wall
    rights, lefts = neighbouring_rays(data.sensor)
    scan, pair = np.nonzero(wall[:, lefts] != wall[:, rights])
    if len(scan) == 0:
        return None
    right, left, bearings = rights[pair], lefts[pair], data.sensor.bearings
    gap = (bearings[left] - bearings[right]) % (2 * np.pi)
    near = np.where(ranges[scan, right] <= ranges[scan, left], right, left)
    # where the nearer surface ends, as an angle from the right ray
    edge = _end_angle(beams, walls, scan, right, near, gap)
    r_near = np.maximum(ranges[scan, near], MIN_END_RANGE)
    blur = np.sqrt(t.pose_yaw**2 + t.mount_yaw**2 + (t.pose_xy**2 + t.map**2 + t.mount_xy**2) / r_near**2)
    rows: list[tuple[Ints, Ints, Floats, Floats]] = []
    for ray, other, away, onward in (
        (right, left, edge, _onward(lefts, rights, data.n_rays)),
        (left, right, gap - edge, _onward(rights, lefts, data.n_rays)),
    ):
        rays = [(scan, ray, other, away, blur)]
        while data.grain > 0 and len(rays[-1][0]):  # a cell is wider than the gap between rays
            rays.append(_next_to(*rays[-1], onward, wall, bearings))
        rows += [_beside_edge(data, beams, walls, *one) for one in rays]
    index_scan, index_ray, beyond, chance = (np.concatenate(column) for column in zip(*rows, strict=True))
    if data.grain > 0:  # between two edges the nearer one counts
        order = np.argsort(chance, kind="stable")
        index_scan, index_ray, beyond, chance = (
            column[order] for column in (index_scan, index_ray, beyond, chance)
        )
    return Edges(index=(index_scan, index_ray), other=beyond, chance=chance)


def _onward(behind: Ints, ahead: Ints, n_rays: int) -> Ints:
    """Return the neighbour ahead of each ray (n_rays,), -1 where there is none."""
    out = np.full(n_rays, -1, dtype=np.intp)
    out[behind] = ahead
    return out


def _next_to(
    scan: Ints, ray: Ints, other: Ints, away: Floats, blur: Floats, onward: Ints, wall: Ints, bearings: Floats
) -> tuple[Ints, Ints, Ints, Floats, Floats]:
    """Return the rays one further from their edges, as far as they meet the same wall and the edge may be theirs."""
    further = onward[ray]
    is_near = ndtr(-away / blur) > SETTINGS.min_edge_chance
    some = np.flatnonzero((further >= 0) & (wall[scan, further] == wall[scan, ray]) & is_near)
    step = np.abs((bearings[further[some]] - bearings[ray[some]] + np.pi) % (2 * np.pi) - np.pi)
    return scan[some], further[some], other[some], away[some] + step, blur[some]


def _beside_edge(
    data: ScanData,
    beams: Beams,
    walls: Floats,
    scan: Ints,
    ray: Ints,
    other: Ints,
    away: Floats,
    blur: Floats,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Return scan, ray, what it would read beyond the edge [m], and the chance that it is there."""
    chance = np.minimum(ndtr(-away / blur), 0.5)
    beyond = _extended(beams, walls, scan, ray, other)
    own = beams.ranges[scan, ray]
    with np.errstate(invalid="ignore"):
        keep = (
            (chance > SETTINGS.min_edge_chance)
            & (np.abs(beyond - own) > SETTINGS.min_edge_step * data.sensor.sigma)
            & np.isfinite(own)
            & (beyond > 0)
        )
    return scan[keep], ray[keep], beyond[keep], chance[keep]


def _end_angle(beams: Beams, walls: Floats, scan: Ints, right: Ints, near: Ints, gap: Floats) -> Floats:
    """Return the angle [rad] from the right ray to the end of the nearer wall; half the gap where it has none there."""
    index = beams.wall[scan, near]
    middle = gap / 2
    if len(walls) == 0:
        return np.asarray(middle)
    known = index >= 0
    ux, uy = beams.ux[scan, right], beams.uy[scan, right]
    ox = np.broadcast_to(beams.ox, beams.ux.shape)[scan, right]
    oy = np.broadcast_to(beams.oy, beams.ux.shape)[scan, right]
    best = np.asarray(middle).copy()
    for end in (0, 1):
        corner = walls[np.where(known, index, 0), end]
        x, y = corner[:, 0] - ox, corner[:, 1] - oy
        angle = np.arctan2(ux * y - uy * x, ux * x + uy * y)
        fits = known & (angle >= -1e-3) & (angle <= gap + 1e-3)
        best = np.where(fits, np.clip(angle, 0.0, gap), best)
    return best


def _extended(beams: Beams, walls: Floats, scan: Ints, ray: Ints, other: Ints) -> Floats:
    """Return where a ray would meet the surface that its neighbour meets, extended; inf where that is nothing."""
    index = beams.wall[scan, other]
    fallback = beams.ranges[scan, other]
    if len(walls) == 0:
        return np.asarray(fallback)
    a = walls[np.where(index >= 0, index, 0), 0]
    nx, ny = beams.nx[scan, other], beams.ny[scan, other]
    ox = np.broadcast_to(beams.ox, beams.ux.shape)[scan, ray]
    oy = np.broadcast_to(beams.oy, beams.ux.shape)[scan, ray]
    across = beams.ux[scan, ray] * nx + beams.uy[scan, ray] * ny
    with np.errstate(divide="ignore", invalid="ignore"):
        r = ((a[:, 0] - ox) * nx + (a[:, 1] - oy) * ny) / across
    usable = (index >= 0) & (across < GRAZING)
    return np.asarray(np.where(usable, r, fallback))
