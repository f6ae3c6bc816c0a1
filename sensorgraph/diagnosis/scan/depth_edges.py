"""Edges in depth: rays that a small pose or map error moves past the end of a surface, and their range beyond it.

A ray at the angle `away` from an edge passes it with the probability chance = min(½, Phi(-away / blur)). The blur combines
the errors of heading and mount with those of place and map over the range of the nearer surface. An edge is where the nearer
of two different walls ends between their rays, or half way between them if it does not end there. Beyond the edge, a ray
reads the extended wall of its neighbour. The rays behind it that meet the same wall
are found by a compiled kernel, because a building has many.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from planners.kernel import inlined_kernel, outer_kernel
from sensorgraph.diagnosis.scan.corner_sums import corners_between_rays
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.ray_order import is_full_turn, neighbouring_rays
from sensorgraph.world.robot import Tolerances

SETTINGS = SCAN.likelihood
REACH = -float(ndtri(SETTINGS.min_edge_chance))
"""Number of blurs beyond which a ray is clear of an edge."""
MIN_SHORT_RANGE = 0.05
"""[m] minimum range over which short readings are distributed, and of the nearer side of an edge: map and pose errors
turn it by their size over the range."""
MAX_CORNERS = 1.5
"""Maximum number of corners per wall in a map of connected walls: closed outlines have one, separate fragments two."""
SLACK = 1e-3
"""[rad] tolerance for the end of a wall outside of two rays, which may have different origins."""
GRAZING = 0.02
"""Minimum cosine to the normal at which a ray meets the extension of a wall."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Edges:
    """Rays so close to a step in depth that a small pose or map error moves them to its other side."""

    index: tuple[Ints, Ints]
    """Indices (scan, ray) of k rays."""
    other: Floats
    """(k,) [m] range on the other side."""
    spread: Floats
    """(k,) [m] standard deviation of `other` due to pose and map errors, without the noise of a reading.

    It increases with the incidence on the other side."""
    chance: Floats
    """(k,) probability of the other side."""


def find_edges(data: ScanData, beams: Beams, walls: Floats) -> Edges | None:
    """Find the rays next to a step in depth, and their range beyond it; each ray keeps its most likely step.

    Rays farther from the edge that meet the same wall are included, because a cell of a map may be wider than the gap
    between rays.
    """
    sensor, shape = data.sensor, beams.ux.shape
    rights, lefts = neighbouring_rays(sensor)
    steps = np.nonzero(beams.wall[:, lefts] != beams.wall[:, rights])
    scan, pair = (np.ascontiguousarray(part) for part in steps)  # one memory layout: compiled once
    right, left = rights[pair], lefts[pair]
    ox, oy, ux, uy, ranges = (
        np.ascontiguousarray(part if part.shape == shape else np.broadcast_to(part, shape))
        for part in (beams.ox, beams.oy, beams.ux, beams.uy, beams.ranges)
    )
    nearer = np.where(ranges[scan, right] <= ranges[scan, left], right, left)
    gap = _gap(data, beams, scan, right, left)
    edge = _end_angle((ox, oy, ux, uy), walls, (scan, right), gap, beams.wall[scan, nearer], nearer == right)
    edge = np.where(np.isnan(edge), gap / 2, edge)
    turn, place = _blur(data.tolerances)
    blur = np.hypot(turn, place / np.maximum(ranges[scan, nearer], MIN_SHORT_RANGE))
    best = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    limits = (
        REACH,
        SETTINGS.min_edge_chance,
        SETTINGS.min_edge_step * sensor.sigma,
        float(sensor.range_max),
        data.max_scatter,
    )
    for ray, other, away in ((right, left, edge), (left, right, gap - edge)):
        add_rays_behind(
            best,
            (scan, ray, away, blur),
            (beams.wall[scan, other], ranges[scan, other]),
            (ox, oy, ux, uy, ranges),
            beams.wall,
            walls,
            _onward(other, ray, data.n_rays),
            np.ascontiguousarray(sensor.bearings),
            (turn, place),
            limits,
        )
    if _is_drawn(data) and not sensor.is_composite and len(rights):
        _add_corners(best, data, (ox, oy, ux, uy), ranges, beams.wall, walls, (rights, lefts))
    at_scan, at_ray = np.nonzero(best[0] > 0)
    if len(at_scan) == 0:
        return None
    chance, beyond, spread = (part[at_scan, at_ray] for part in best)
    return Edges(index=(at_scan, at_ray), other=beyond, spread=spread, chance=chance)


def _is_drawn(data: ScanData) -> bool:
    """Return whether the map has connected walls, unlike an occupancy-grid map (steps) or an identified one (fragments)."""
    if data.grain > 0 or data.arena.is_identified:
        return False
    walls = data.arena.walls
    n = data.kept(b"corners", lambda: len(np.unique(walls.reshape(-1, 2), axis=0)))
    return 0 < n < MAX_CORNERS * len(walls)


def _add_corners(
    best: tuple[Floats, Floats, Floats],
    data: ScanData,
    rays: tuple[Floats, Floats, Floats, Floats],
    ranges: Floats,
    wall: Ints,
    walls: Floats,
    pairs: tuple[Ints, Ints],
) -> None:
    """Enter the corners that stand between two rays, such as table legs, where they are the most likely other side."""
    sensor, blur = data.sensor, _blur(data.tolerances)
    chance, met = corners_between_rays(
        np.unique(walls.reshape(-1, 2), axis=0),
        walls,
        rays,
        np.minimum(ranges - SETTINGS.min_edge_step * sensor.sigma, sensor.range_max),
        wall,
        pairs,
        sensor.bearings[pairs[0]] - sensor.bearings[pairs[0][0]],
        is_full_turn(sensor.bearings),
        blur,
        SETTINGS.min_edge_chance,
    )
    is_better = chance > best[0]
    for part, new in zip(best, (chance, met, np.full(ranges.shape, blur[1])), strict=True):
        part[is_better] = new[is_better]


def _gap(data: ScanData, beams: Beams, scan: Ints, right: Ints, left: Ints) -> Floats:
    """Return the actual angle [rad] from right rays to left ones, which changes if the robot turns during the sweep."""
    told = (data.sensor.bearings[left] - data.sensor.bearings[right]) % (2 * np.pi)
    to_right, to_left = ((beams.ux[scan, ray], beams.uy[scan, ray]) for ray in (right, left))
    across = to_right[0] * to_left[1] - to_right[1] * to_left[0]
    along = to_right[0] * to_left[0] + to_right[1] * to_left[1]
    turned = (np.arctan2(across, along) - told + np.pi) % (2 * np.pi) - np.pi
    return np.maximum(told + turned, 0.0)


def _end_angle(
    rays: tuple[Floats, Floats, Floats, Floats],
    walls: Floats,
    at: tuple[Ints, Ints],
    gap: Floats,
    wall: Ints,
    is_right: Bools,
) -> Floats:
    """Return the angle [rad] from right rays to the end of the nearer walls (k,); nan where no end is between the rays.

    Parameters
    ----------
    rays : (n_scans, n_rays) each: origin x, y [m], direction x, y.
    at : (k,) each: scan and right ray.
    wall : (k,) The nearer wall of each pair of rays; negative without one.
    is_right : (k,) Whether the right ray meets it.
    """
    best = np.full(len(gap), np.nan)
    if len(walls) == 0:
        return best
    known = wall >= 0
    ox, oy, ux, uy = (part[at] for part in rays)
    towards = np.where(is_right, 1.0, -1.0)  # the other ray
    for end in (0, 1):
        corner = walls[np.where(known, wall, 0), end]
        x, y = corner[:, 0] - ox, corner[:, 1] - oy
        angle = np.arctan2(ux * y - uy * x, ux * x + uy * y)
        fits = known & (angle >= -SLACK) & (angle <= gap + SLACK)
        angle = np.clip(angle, 0.0, gap)
        best = np.where(fits & ~(towards * best > towards * angle), angle, best)
    return best


def _blur(t: Tolerances) -> tuple[float, float]:
    """Return the standard deviations of a ray's direction [rad] and of its place relative to the map, along each axis [m]."""
    return float(np.hypot(t.pose_yaw, t.mount_yaw)), float(np.sqrt(t.pose_xy**2 + t.map**2 + t.mount_xy**2))


def _onward(behind: Ints, ahead: Ints, n_rays: int) -> Ints:
    """Return the next ray (n_rays,) behind each one, away from the edge; -1 at the end."""
    out = np.full(n_rays, -1, dtype=np.intp)
    out[behind] = ahead
    return out


@inlined_kernel
def _beyond(
    walls: Floats, behind: int, met: float, ox: float, oy: float, ux: float, uy: float
) -> tuple[float, float]:
    """Return the range [m] of a ray beyond an edge, and the cosine of its incidence there.

    That is where the ray meets the line of the wall `behind`, or else the range `met` by its neighbour.
    """
    if behind < 0:
        return met, 1.0
    ax, ay = walls[behind, 0, 0], walls[behind, 0, 1]
    dx, dy = walls[behind, 1, 0] - ax, walls[behind, 1, 1] - ay
    length = max(math.hypot(dx, dy), 1e-12)
    nx, ny = dy / length, -dx / length
    across = ux * nx + uy * ny
    r = ((ax - ox) * nx + (ay - oy) * ny) / across
    return r if abs(across) > GRAZING and r > 0 else met, abs(across)


@outer_kernel
def add_rays_behind(
    best: tuple[Floats, Floats, Floats],
    edges: tuple[Ints, Ints, Floats, Floats],
    other: tuple[Ints, Floats],
    rays: tuple[Floats, Floats, Floats, Floats, Floats],
    wall: Ints,
    walls: Floats,
    onward: Ints,
    bearings: Floats,
    blur: tuple[float, float],
    limits: tuple[float, float, float, float, float],
) -> None:
    """Enter the ray next to each edge, and those behind it that meet the same wall, where the edge is their most likely one.

    Parameters
    ----------
    best : (n_scans, n_rays) each: probability of the other side, range there [m], standard deviation [m]; changed in
        place. Of equally likely edges, the last one wins.
    edges : (k,) each: scan, ray next to the edge, its angle [rad] from the edge, and the edge's blur [rad].
    other : (k,) each: wall on the other side, negative without one, and range [m] at which the neighbour met it.
    rays : (n_scans, n_rays) each: origin x, y [m], direction x, y, range [m].
    wall : (n_scans, n_rays) Wall that each ray meets.
    walls : (n_walls, 2, 2) [m]
    onward : (n_rays,) The next ray away from the edge; -1 at the end.
    bearings : (n_rays,) [rad]
    blur : Standard deviations of a ray's direction [rad] and place [m].
    limits : Number of blurs up to which rays behind are entered, minimum probability, minimum step in depth [m],
        maximum range of a return [m], and maximum standard deviation [m].
    """
    turn, place = blur
    reach, least, step, farthest, widest = limits
    chances, others, spreads = best
    scan, first, away, edge_blur = edges
    ox, oy, ux, uy, ranges = rays
    for e in range(len(scan)):
        i, m, angle, behind = scan[e], first[e], away[e], other[0][e]
        while True:
            chance = min(0.5 * math.erfc(angle / edge_blur[e] / math.sqrt(2.0)), 0.5)
            beyond, cosine = _beyond(walls, behind, other[1][e], ox[i, m], oy[i, m], ux[i, m], uy[i, m])
            own = ranges[i, m]
            if (
                chance > least
                and chance >= chances[i, m]
                and abs(beyond - own) > step
                and math.isfinite(own)
                and beyond > 0
                and min(own, beyond) < farthest  # otherwise neither side returns
            ):
                spread = 0.0
                if math.isfinite(beyond):
                    sine = math.sqrt(max(1 - cosine * cosine, 0.0))
                    spread = min(math.hypot(turn * beyond * sine, place) / cosine, widest)
                chances[i, m], others[i, m], spreads[i, m] = chance, beyond, spread
            further = onward[m]
            if not angle < reach * edge_blur[e] or further < 0 or wall[i, further] != wall[i, m]:
                break
            angle += abs((bearings[further] - bearings[m] + np.pi) % (2 * np.pi) - np.pi)
            m = further
