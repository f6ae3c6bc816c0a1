"""Corners of a map: shifts of the walls that end there, in the normal equations, and corners that stand between two rays.

Position errors of corners are summed over rays by the wall that each ray meets. V, B and S are the derivatives of the readings by
corner shifts, by the pose of a scan and by the shared unknowns. W holds the weights and y the residuals.

    cv = Bᵀ W V (for each scan),    gv = Sᵀ W V,    vv = Vᵀ W V,    rv = Vᵀ W y.

A corner shift changes a reading only by its component along the wall's normal n: V = ends nᵀ for each of the two ends.

An obstacle that was measured at a wrong place has shifted as a whole. The unknowns u, with the prior N(0, tau²), are therefore one pair
for each corner and one for each obstacle:

    shift of a corner = sqrt(1 - share) u of the corner + sqrt(share) u of its obstacle.

A small pose or map error moves a corner that two rays pass, such as a table leg, in front of one of them. A ray meets a corner at
the lateral distance `aside` and the range r with the probability

    chance = min(½, Phi(-|aside| / hypot(blur_angle r, blur_place))).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan2, erfc, hypot, pi, sqrt

import numpy as np

from planners.array_kernels import last_up_to
from planners.kernel import inner_kernel, outer_kernel
from planners.types import SAME_PLACE
from sensorgraph.types import Bools, Floats, Ints

SHARE_OF_PLACE = 0.5
"""Share of the prior variance of a corner that all corners of its obstacle have in common: its place and its shape are equally uncertain."""
SQRT_2, TURN = sqrt(2.0), 2 * pi


def corner_sums(
    w: Floats,
    rows: Floats,
    ends: Floats,
    wall: Ints,
    y: Floats,
    normals: Floats,
    corners: Ints,
    count: int,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the weighted products cv, gv, vv, rv of corner shifts with poses, columns, each other and residuals.

    Parameters
    ----------
    w : (n_scans, n_rays) [1/m²] Weights; 0 excludes a ray.
    rows : (n_scans, 3 + k, n_rays) Columns of the pose of each scan, and those that all scans share.
    ends : (2, n_scans, n_rays) Derivative of the reading by a shift of each end of the wall along its normal.
    wall : (n_scans, n_rays) Index of the wall.
    y : (n_scans, n_rays) [m] Residuals.
    normals : (n_walls, 2) Unit normals.
    corners : (n_walls, 2) Index of the corner at each end.
    count : Number of corners; each has two columns, x and y.

    Returns
    -------
    (n_scans, 3, 2 count), (k, 2 count), (2 count, 2 count), (2 count,)
    """
    packed = np.ascontiguousarray(ends)  # the kernel is compiled for this layout
    with_pose = np.zeros((len(w), 3, 2 * count))
    by_wall, square = np.zeros((rows.shape[1] - 2, 2, len(normals))), np.zeros((2, 2, len(normals)))
    _by_wall(w, rows, packed, wall, y, normals, corners, with_pose, by_wall, square)
    with_column, with_corner = _by_corner(by_wall, square, normals, corners, count)
    return with_pose, with_column[:-1], with_corner, with_column[-1]


def _by_corner(
    by_wall: Floats, square: Floats, normals: Floats, corners: Ints, count: int
) -> tuple[Floats, Floats]:
    """Convert products by wall end, along its normal, into products by x and y of each corner.

    Returns those with columns (k + 1, 2 count) and with each other (2 count, 2 count).
    """
    with_column = np.zeros((2 * count, len(by_wall)))
    with_corner = np.zeros((2 * count, 2 * count))
    at = 2 * corners[..., None] + np.arange(2)  # (n_walls, 2, 2): column by end and axis
    n = normals[:, None, :, None]
    np.add.at(with_column, at, by_wall.T[:, :, None] * n)  # (n_walls, end, axis, k + 1)
    products = square.T.swapaxes(1, 2)[:, :, None, :, None] * n[..., None] * normals[:, None, None, None]
    np.add.at(with_corner, (at[..., None, None], at[:, None, None]), products)  # over end, axis, end, axis
    return np.ascontiguousarray(with_column.T), with_corner


@outer_kernel
def _by_wall(
    w: Floats,
    rows: Floats,
    ends: Floats,
    wall: Ints,
    y: Floats,
    normals: Floats,
    corners: Ints,
    with_pose: Floats,
    by_wall: Floats,
    square: Floats,
) -> None:
    """Add up the products of corner shifts with poses, and by wall end with columns and each other.

    Shapes: (n_scans, 3, 2 count); (k + 1, 2, n_walls), whose last row is the product with residuals; (2, 2, n_walls).
    """
    n_scans, n_rays = w.shape
    k = rows.shape[1] - 3
    for i in range(n_scans):
        for m in range(n_rays):
            if w[i, m] == 0.0:
                continue
            at = wall[i, m]
            for e in range(2):
                value = w[i, m] * ends[e, i, m]
                for d in range(2):
                    column = 2 * corners[at, e] + d
                    for axis in range(3):
                        with_pose[i, axis, column] += value * normals[at, d] * rows[i, axis, m]
                by_wall[k, e, at] += value * y[i, m]
                square[e, 0, at] += value * ends[0, i, m]
                square[e, 1, at] += value * ends[1, i, m]
        for j in range(k):
            at, first, last = -1, 0.0, 0.0  # neighbouring rays meet the same wall: its sums stay in registers
            for m in range(n_rays):
                value = w[i, m] * rows[i, 3 + j, m]
                if value == 0.0:
                    continue
                if wall[i, m] != at:
                    if at >= 0:
                        by_wall[j, 0, at], by_wall[j, 1, at] = first, last
                    at = wall[i, m]
                    first, last = by_wall[j, 0, at], by_wall[j, 1, at]
                first += value * ends[0, i, m]
                last += value * ends[1, i, m]
            if at >= 0:
                by_wall[j, 0, at], by_wall[j, 1, at] = first, last


@dataclass(frozen=True, kw_only=True, eq=False)
class Corners:
    """Corners at the ends of each wall."""

    ends: Ints
    """(n_walls, 2) Indices of the corners."""
    count: int
    rest: int = -1
    """Index shared by all fixed corners; -1 if every corner may shift."""
    obstacle: Ints | None = None
    """(count,) Index of the obstacle of each corner; `n_obstacles` for a corner of the outline. None: there are no obstacles."""
    n_obstacles: int = 0

    @property
    def n_unknowns(self) -> int:
        """Number of pairs of unknowns: of the corners, then of the obstacles."""
        return self.count + self.n_obstacles

    def of_obstacles(self, obstacle: Ints, n_obstacles: int) -> Corners:
        """Return the corners with their obstacles.

        Parameters
        ----------
        obstacle : (n_walls,) Index of the obstacle of each wall; `n_obstacles` for the outline.
        """
        owner = np.full(self.count, n_obstacles)
        owner[self.ends] = obstacle[:, None]
        return replace(self, obstacle=owner, n_obstacles=n_obstacles)

    @property
    def _shares(self) -> tuple[Floats, float]:
        """Factor of the unknown of each corner (count, 1), and of those of the obstacles."""
        alone = np.where(self.obstacle == self.n_obstacles, 1.0, np.sqrt(1 - SHARE_OF_PLACE))[:, None]
        return alone, float(np.sqrt(SHARE_OF_PLACE))

    def shifts(self, unknowns: Floats) -> Floats:
        """Return the shifts (2 count,) [m] of the corners for unknowns (2 n_unknowns,) [m]."""
        if self.obstacle is None or not self.n_obstacles:
            return unknowns
        alone, common = self._shares
        pairs = unknowns.reshape(-1, 2)
        together = np.vstack([pairs[self.count :], np.zeros((1, 2))])
        return np.asarray((alone * pairs[: self.count] + common * together[self.obstacle]).ravel())

    def of_unknowns(self, of_shifts: Floats) -> Floats:
        """Return derivatives (..., 2 n_unknowns) by the unknowns, from those (..., 2 count) by the shifts."""
        if self.obstacle is None or not self.n_obstacles:
            return of_shifts
        alone, common = self._shares
        pairs = of_shifts.reshape(*of_shifts.shape[:-1], self.count, 2)
        member = np.equal.outer(np.arange(self.n_obstacles), self.obstacle).astype(np.float64)
        both = np.concatenate([alone * pairs, common * (member @ pairs)], axis=-2)
        return np.asarray(both.reshape(*of_shifts.shape[:-1], -1))

    def unknowns(self, shifts: Floats) -> Floats:
        """Return unknowns (2 n_unknowns, k) [m] that have the shifts (2 count, k): those of the corners alone."""
        if self.obstacle is None:
            return shifts
        alone = np.repeat(self._shares[0], 2, axis=0)
        return np.concatenate([shifts / alone, np.zeros((2 * self.n_obstacles, shifts.shape[1]))])

    @classmethod
    def of(cls, walls: Floats, met: Bools | None = None) -> Corners:
        """Merge wall ends that coincide; corners that only end walls which no ray meets, by `met` (n_walls,), are fixed."""
        x, y = np.round(walls.reshape(-1, 2), 6).T
        _, index = np.unique(x + 1j * y, return_inverse=True)
        index = index.reshape(-1, 2)
        count = int(index.max()) + 1 if len(index) else 0
        if met is None:
            return cls(ends=index, count=count)
        is_met = np.zeros(count, dtype=np.bool_)
        is_met[index[met]] = True
        n_met = int(is_met.sum())
        if n_met == count:
            return cls(ends=index, count=count)
        index = np.where(is_met, np.cumsum(is_met) - 1, n_met)[index]
        return cls(ends=index, count=n_met + 1, rest=n_met)


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
    chance, met = np.zeros(ranges.shape), np.full(ranges.shape, np.nan)
    _find_corners(corners, walls, rays, ranges, wall, pairs, first, is_full_turn, blur, least, chance, met)
    return chance, met


@outer_kernel
def _find_corners(
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
    chance: Floats,
    met: Floats,
) -> None:
    """Enter probability and range of the most likely corner of each ray, as of `corners_between_rays`."""
    ox, oy, ux, uy = rays
    rights, lefts = pairs
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
    at, step = last_up_to(first, angle), 0
    # the rays of a robot that turns during the sweep deviate from their bearings
    for _ in range(len(rights)):
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
