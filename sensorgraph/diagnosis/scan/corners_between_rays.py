"""Corners between two rays that both pass them: legs of tables that a small pose or map error moves in front of a ray.

A ray meets a corner at the lateral distance `aside` and the range r with the probability

    chance = min(½, Phi(-|aside| / hypot(blur_angle r, blur_place))).

The loop over scans and corners is compiled.
"""

from __future__ import annotations

from math import atan2, erfc, hypot, pi, sqrt

import numpy as np

from planners.kernel import inner_kernel, kernel
from sensorgraph.types import Floats, Ints
from sensorgraph.world.ray_intersection import SAME_PLACE

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
    """Return the probability that each ray meets a visible corner next to it, and the range of that corner.

    A corner is skipped if it ends a wall that one of the two rays around it meets, because that edge is found elsewhere.

    Parameters
    ----------
    corners : (n_corners, 2) [m] Places of the corners.
    walls : (n_walls, 2, 2) [m] End points of the walls.
    rays : ox, oy, ux, uy (n_scans, n_rays) Origins [m] and unit directions.
    ranges : (n_scans, n_rays) [m] Maximum distance of a corner, at most the range that the ray meets.
    wall : (n_scans, n_rays) Index of the wall that the ray meets; negative without one.
    pairs : Right and left ray (n_pairs,) of each pair of neighbours; the pairs are in counter-clockwise order.
    first : (n_pairs,) [rad] Bearing of each right ray relative to the first.
    blur : [rad, m] Standard deviations of the direction and of the place of a corner.
    least : Minimum probability; smaller values are set to 0.

    Returns
    -------
    Probability (n_scans, n_rays) of the most likely corner, at most 1/2, and its range [m], nan without a corner
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
    """Return the index of the pair of rays around a place; -1 without one."""
    dx, dy, c, s = x - ox[rights[0]], y - oy[rights[0]], ux[rights[0]], uy[rights[0]]
    angle = atan2(c * dy - s * dx, c * dx + s * dy) % TURN
    at, step = int(np.searchsorted(first, angle, side="right")) - 1, 0
    for _ in range(
        len(rights)
    ):  # the rays of a robot that turns during the sweep deviate from their bearings
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
    """Return whether the wall with the index `at` ends at a place; False for a negative index."""
    if at < 0:
        return False
    to_first = abs(walls[at, 0, 0] - x) + abs(walls[at, 0, 1] - y)
    to_last = abs(walls[at, 1, 0] - x) + abs(walls[at, 1, 1] - y)
    return bool(min(to_first, to_last) < SAME_PLACE)


@inner_kernel
def _is_in_sight(walls: Floats, ox: float, oy: float, dx: float, dy: float) -> bool:
    """Return whether no wall crosses the segment from an origin along (dx, dy) [m], before its end."""
    short = 1.0 - SAME_PLACE / hypot(dx, dy)
    for at in range(len(walls)):
        ex, ey = walls[at, 1, 0] - walls[at, 0, 0], walls[at, 1, 1] - walls[at, 0, 1]
        ax, ay = walls[at, 0, 0] - ox, walls[at, 0, 1] - oy
        across = dx * ey - dy * ex
        share, along = (ax * dy - ay * dx) / across, (ax * ey - ay * ex) / across
        if 0.0 <= share <= 1.0 and 0.0 <= along < short:  # False for parallel lines: inf or nan
            return False
    return True
