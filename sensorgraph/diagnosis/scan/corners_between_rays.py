"""Corners that stand between two rays which both pass them: legs of tables that a small error puts before a ray.

The loop over scans and corners is compiled; `plain_corners_between_rays` asks every pair of rays for every corner.
"""

from __future__ import annotations

from math import atan2, erfc, hypot, pi, sqrt

import numpy as np
from scipy.special import ndtr

from planners.kernel import inner_kernel, kernel
from sensorgraph.types import Floats, Ints
from sensorgraph.world.ray_intersection import SAME_PLACE, nearest_walls_plain

SQRT_2, TURN = sqrt(2.0), 2 * pi


@kernel
def corners_between_rays(
    corners: Floats,
    walls: Floats,
    rays: tuple[Floats, Floats, Floats, Floats],
    ranges: Floats,
    wall: Ints,
    pairs: tuple[Ints, Ints],
    first: Floats,
    is_full_turn: bool,
    blur: tuple[float, float],
    least: float,
) -> tuple[Floats, Floats]:
    """Return how likely each ray meets a corner that it passes, next to it and in sight, and at what range.

    A corner of a wall that the ray or its neighbour on the other side of the corner meets is none: that edge is seen.

    Parameters
    ----------
    corners : (n_corners, 2) [m]
    walls : (n_walls, 2, 2) [m]
    rays : ox, oy, ux, uy (n_scans, n_rays), origins [m] and unit directions
    ranges, wall : (n_scans, n_rays) [m] how far corners may be from where rays begin, at most as far as what they meet,
    and the index of the wall of that, below 0 for none
    pairs : right and left ray (n_pairs,) of each pair of neighbours, counter-clockwise from pair to pair
    first : (n_pairs,) [rad] bearing of each right ray, counted from the first
    blur : [rad, m] standard deviation of the direction in which a corner stands, and of its place
    least : chance; less is none

    Returns
    -------
    chance (n_scans, n_rays), at most 1/2, of the likeliest corner, and range [m], nan where there is none
    """
    ox, oy, ux, uy = rays
    rights, lefts = pairs
    chance, met = np.zeros(ranges.shape), np.full(ranges.shape, np.nan)
    for i in range(len(ranges)):
        for c in range(len(corners)):
            x, y = corners[c]
            at = _pair_around(x, y, ox[i], oy[i], ux[i], uy[i], rights, lefts, first, is_full_turn)
            if (
                at < 0
                or _ends_at(walls, wall[i, rights[at]], x, y)
                or _ends_at(walls, wall[i, lefts[at]], x, y)
            ):
                continue
            for ray in (rights[at], lefts[at]):
                dx, dy = x - ox[i, ray], y - oy[i, ray]
                ahead, aside, r = (
                    ux[i, ray] * dx + uy[i, ray] * dy,
                    uy[i, ray] * dx - ux[i, ray] * dy,
                    hypot(dx, dy),
                )
                if ahead <= 0.0 or r >= ranges[i, ray]:
                    continue
                likely = min(0.5, 0.5 * erfc(abs(aside) / hypot(blur[0] * r, blur[1]) / SQRT_2))
                if likely < least or likely <= chance[i, ray]:
                    continue
                is_before_both = r < ranges[i, rights[at]] and r < ranges[i, lefts[at]]
                if is_before_both or _is_in_sight(walls, ox[i, ray], oy[i, ray], dx, dy):
                    chance[i, ray], met[i, ray] = likely, ahead
    return chance, met


@inner_kernel
def _pair_around(
    x: float,
    y: float,
    ox: Floats,
    oy: Floats,
    ux: Floats,
    uy: Floats,
    rights: Ints,
    lefts: Ints,
    first: Floats,
    is_full_turn: bool,
) -> int:
    """Return the pair of rays of a scan between which a place lies; -1 for none."""
    dx, dy, c, s = x - ox[rights[0]], y - oy[rights[0]], ux[rights[0]], uy[rights[0]]
    angle = atan2(c * dy - s * dx, c * dx + s * dy) % TURN
    at, step = int(np.searchsorted(first, angle, side="right")) - 1, 0
    for _ in range(len(rights)):  # a robot that turns within a sweep has turned the rays, too
        right, left = rights[at], lefts[at]
        if ux[right] * (y - oy[right]) - uy[right] * (x - ox[right]) < 0.0:
            move = -1
        elif uy[left] * (x - ox[left]) - ux[left] * (y - oy[left]) < 0.0:
            move = 1
        else:
            return at
        if step != 0 and move != step:
            return -1
        step = move
        at += move
        if is_full_turn:
            at = at % len(rights)
        elif at < 0 or at >= len(rights):
            return -1
    return -1


@inner_kernel
def _ends_at(walls: Floats, at: int, x: float, y: float) -> bool:
    """Tell whether a wall, of this index or none below 0, ends at a place."""
    if at < 0:
        return False
    to_first = abs(walls[at, 0, 0] - x) + abs(walls[at, 0, 1] - y)
    to_last = abs(walls[at, 1, 0] - x) + abs(walls[at, 1, 1] - y)
    return bool(min(to_first, to_last) < SAME_PLACE)


@inner_kernel
def _is_in_sight(walls: Floats, ox: float, oy: float, dx: float, dy: float) -> bool:
    """Tell whether no wall crosses the way from an origin by (dx, dy) [m], short of its end."""
    short = 1.0 - SAME_PLACE / hypot(dx, dy)
    for at in range(len(walls)):
        ex, ey = walls[at, 1, 0] - walls[at, 0, 0], walls[at, 1, 1] - walls[at, 0, 1]
        ax, ay = walls[at, 0, 0] - ox, walls[at, 0, 1] - oy
        across = dx * ey - dy * ex
        share, along = (ax * dy - ay * dx) / across, (ax * ey - ay * ex) / across
        if 0.0 <= share <= 1.0 and 0.0 <= along < short:  # not so where they are parallel: inf or nan
            return False
    return True


def plain_corners_between_rays(
    corners: Floats,
    walls: Floats,
    rays: tuple[Floats, Floats, Floats, Floats],
    ranges: Floats,
    wall: Ints,
    pairs: tuple[Ints, Ints],
    blur: tuple[float, float],
    least: float,
) -> tuple[Floats, Floats]:
    """Return what `corners_between_rays` does."""
    chance, met = np.zeros(ranges.shape), np.full(ranges.shape, np.nan)
    for right, left in zip(*pairs, strict=True):
        for x, y in corners:
            towards = {ray: _towards(x, y, tuple(part[:, ray] for part in rays)) for ray in (right, left)}
            kept = (towards[right][1] >= 0) & (towards[left][1] <= 0)
            for ray in (right, left):
                to_ends = np.abs(walls[wall[:, ray]] - [x, y]).sum(axis=2)  # (n_scans, 2)
                kept &= ~((to_ends < SAME_PLACE).any(axis=1) & (wall[:, ray] >= 0))
            for ray in (right, left):
                ahead, aside = towards[ray]
                r = np.hypot(ahead, aside)
                ox, oy = rays[0][:, ray], rays[1][:, ray]
                first, _ = nearest_walls_plain(walls, ox, oy, (x - ox) / r, (y - oy) / r)
                met_here = kept & (ahead > 0) & (r < ranges[:, ray]) & (first > r - SAME_PLACE)
                likely = np.minimum(0.5, ndtr(-np.abs(aside) / np.hypot(blur[0] * r, blur[1])))
                better = met_here & (likely >= least) & (likely > chance[:, ray])
                chance[better, ray], met[better, ray] = likely[better], ahead[better]
    return chance, met


def _towards(x: float, y: float, rays: tuple[Floats, ...]) -> tuple[Floats, Floats]:
    """Return how far ahead and to the left of each ray a place lies [m]."""
    ox, oy, ux, uy = rays
    return ux * (x - ox) + uy * (y - oy), ux * (y - oy) - uy * (x - ox)
