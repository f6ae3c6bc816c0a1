"""Points on surfaces in hash buckets, and the line fitted to the points around a position.

The line is the weighted principal axis of the points that lie on the same side of a surface, with weights

    u_k = (1 - d_k² / radius²)²,  d_k < radius the distance of point k from the position (Cleveland 1979).

With W = sum u_k and the weighted mean m and covariance C of the points, its direction is at the angle

    angle = atan2(2 C_xy, C_xx - C_yy) / 2,

and the variances across and along it are the eigenvalues (C_xx + C_yy) / 2 ∓ √((C_xx - C_yy)² / 4 + C_xy²).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.kernel import inner_kernel, kernel, outer_kernel
from sensorgraph.localization.settings import MATCH, UNKNOWN_NORMAL_LENGTH
from sensorgraph.types import Floats, Ints

FACING = 0.25
"""Cosine between the direction to the laser and a normal above which the laser observes that side, not along
it."""
SAME_SIDE = 0.3
"""Cosine between two normals below which their points lie on different surfaces."""
VOXEL = 0.05
"""[m] Side of the cells in which points with similar normals are averaged; it bounds the cost of a match."""
Table = tuple[float, float, Ints, Ints, Ints, Floats, Floats]
"""Fields of a `LineMap` as kernels take them: side, facing, keys, first, counts, points, normals."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LineMap:
    """Points in the buckets of a hash table; built by `line_map`."""

    side: float
    """[m] Side of a bucket, and maximum radius of a fitted line."""
    keys: Ints
    """(n_slots,) Packed bucket of each slot; -1: empty. n_slots is a power of 2."""
    first: Ints
    """(n_slots,) First point of the bucket."""
    counts: Ints
    """(n_slots,) Number of points in the bucket."""
    points: Floats
    """(n_points, 2) [m] Points in map, sorted by bucket."""
    normals: Floats
    """(n_points, 2) Unit normals towards the observed side; 0, 0: unknown."""
    order: Ints
    """(n_points,) Index of each point in the input."""
    facing: float
    """Cosine between a normal and the direction to the laser above which the laser observes that side."""

    @property
    def table(self) -> Table:
        """The fields as kernels take them."""
        return self.side, self.facing, self.keys, self.first, self.counts, self.points, self.normals


def line_map(
    points: Floats, normals: Floats | None = None, *, side: float = MATCH.first_radius, facing: float = FACING
) -> LineMap:
    """Sort points into buckets.

    Parameters
    ----------
    points : (n, 2) [m] Points in map.
    normals : (n, 2) Directions towards the observed side; None, or 0, 0: unknown.
    side : [m] Side of a bucket.
    facing : Cosine as in `LineMap`; 0 where normals are accurate to a degree.
    """
    n = len(points)
    normals = np.zeros((n, 2)) if normals is None else normals
    n_slots = 1 << max(4, int(2 * n).bit_length())
    keys = np.full(n_slots, -1, dtype=np.intp)
    first, counts = np.zeros(n_slots, dtype=np.intp), np.zeros(n_slots, dtype=np.intp)
    order = np.zeros(n, dtype=np.intp)
    _fill(np.ascontiguousarray(points), side, keys, first, counts, order)
    kept = points[order], normals[order]
    return LineMap(
        side=side,
        keys=keys,
        first=first,
        counts=counts,
        points=kept[0],
        normals=kept[1],
        order=order,
        facing=facing,
    )


def thinned(points: Floats, normals: Floats, side: float = VOXEL) -> tuple[Floats, Floats]:
    """Return the means (m, 2) of points and normals that share a square cell and an octant of directions."""
    n = len(points)
    keys = np.full(1 << max(4, int(2 * n).bit_length()), -1, dtype=np.intp)
    sums = np.zeros((n, 6))
    rows = np.zeros(len(keys), dtype=np.intp)
    m = _add_up(np.ascontiguousarray(points), np.ascontiguousarray(normals), side, keys, rows, sums)
    means = sums[:m, :4] / sums[:m, 4:5]
    lengths = np.hypot(means[:, 2], means[:, 3])
    wanted = np.where(sums[:m, 5] > 0, 1.0, np.minimum(lengths, UNKNOWN_NORMAL_LENGTH))
    means[:, 2:] *= (wanted / np.where(lengths > 0, lengths, 1.0))[:, None]
    return means[:, :2], means[:, 2:]


@outer_kernel
def _add_up(points: Floats, normals: Floats, side: float, keys: Ints, rows: Ints, sums: Floats) -> int:
    m = 0
    for k in range(len(points)):
        x, y, nx, ny = points[k, 0], points[k, 1], normals[k, 0], normals[k, 1]
        sector = 4 * int(nx > 0) + 2 * int(ny > 0) + int(abs(nx) > abs(ny))
        if nx * nx + ny * ny <= 0.25:
            sector = 8 + sector // 2
        key = bucket_key(12 * int(np.floor(x / side)) + sector, int(np.floor(y / side)))
        slot = find_slot(keys, key)
        if keys[slot] == -1:
            keys[slot] = key
            rows[slot] = m
            m += 1
        row = rows[slot]
        for i, value in enumerate((x, y, nx, ny, 1.0)):
            sums[row, i] += value
        sums[row, 5] = 1.0 if sector < 8 else 0.0
    return m


@inner_kernel
def bucket_key(x: int, y: int) -> int:
    """Pack the two numbers of a bucket into one non-negative number."""
    return ((x + 1073741824) << 31) | (y + 1073741824)


@inner_kernel
def find_slot(keys: Ints, key: int) -> int:
    """Return the slot of a bucket, or the empty slot for its insertion."""
    mask = len(keys) - 1
    slot = (key * 0x9E3779B97F4A7C1 ^ (key >> 29)) & mask
    while keys[slot] != -1 and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@kernel
def _fill(points: Floats, side: float, keys: Ints, first: Ints, counts: Ints, order: Ints) -> None:
    n = len(points)
    slots = np.empty(n, dtype=np.intp)
    for k in range(n):
        key = bucket_key(int(np.floor(points[k, 0] / side)), int(np.floor(points[k, 1] / side)))
        slot = find_slot(keys, key)
        keys[slot] = key
        counts[slot] += 1
        slots[k] = slot
    total = 0
    for slot in range(len(keys)):
        first[slot] = total
        total += counts[slot]
        counts[slot] = 0
    for k in range(n):
        slot = slots[k]
        order[first[slot] + counts[slot]] = k
        counts[slot] += 1


@inner_kernel
def is_same_side(ax: float, ay: float, bx: float, by: float, same_side: float, facing: float) -> bool:
    """Tell whether two points may lie on one side of one surface, by their normals.

    Vectors of unit length are normals, shorter ones are directions to the laser, and (0, 0) carries no
    information.
    """
    dot = ax * bx + ay * by
    a, b = ax * ax + ay * ay, bx * bx + by * by
    if a > 0.25 and b > 0.25:
        return dot >= same_side
    return a == 0.0 or b == 0.0 or dot > facing * np.sqrt(a * b)


@inner_kernel
def fit_line(
    x: float, y: float, nx: float, ny: float, radius: float, table: Table
) -> tuple[float, float, float, float, float, float, float]:
    """Fit a line to the points around (x, y) with normals similar to (nx, ny), where both are known.

    Returns
    -------
    Sum of weights (0: no point), x and y of the mean [m], unit normal x and y, variances across and along
    [m²].
    """
    side, facing, keys, first, counts, points, normals = table
    w, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    bx, by = int(np.floor(x / side)), int(np.floor(y / side))
    inverse = 1.0 / (radius * radius)
    for ix in range(bx - 1, bx + 2):
        for iy in range(by - 1, by + 2):
            slot = find_slot(keys, bucket_key(ix, iy))
            for k in range(first[slot], first[slot] + counts[slot]):
                dx, dy = points[k, 0] - x, points[k, 1] - y
                near = 1.0 - (dx * dx + dy * dy) * inverse
                if near <= 0.0:
                    continue
                if not is_same_side(nx, ny, normals[k, 0], normals[k, 1], SAME_SIDE, facing):
                    continue
                u = near * near
                w += u
                sx += u * dx
                sy += u * dy
                sxx += u * dx * dx
                sxy += u * dx * dy
                syy += u * dy * dy
    if w <= 0.0:
        return 0.0, x, y, 1.0, 0.0, 0.0, 0.0
    sx, sy = sx / w, sy / w
    sxx, sxy, syy = sxx / w - sx * sx, sxy / w - sx * sy, syy / w - sy * sy
    half = 0.5 * (sxx + syy)
    spread = np.sqrt(0.25 * (sxx - syy) * (sxx - syy) + sxy * sxy)
    angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
    return w, x + sx, y + sy, -np.sin(angle), np.cos(angle), max(half - spread, 0.0), half + spread
