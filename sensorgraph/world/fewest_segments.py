"""The fewest straight segments that stay within a tolerance of a closed chain of points, as bitmaps are traced.

Selinger (2003), "Potrace: a polygon-based tracing algorithm", section 2.2: of all polygons on the points that stay within
the tolerance, one with the fewest corners, and of these the one whose lines fit best.
"""

from __future__ import annotations

import math

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Floats, Ints

DIGITAL = 0.75
"""[step] by which the middles of the borders of cells are off the line that is drawn in them, at most 0.71."""
CUT = 2
"""Points that a corner may cut off at either end of a stretch."""
CUT_OFF = DIGITAL + 0.5
"""[step] by which these are off at most: the middle of a border half a step further. Else the corner of a pilaster is lost."""


def closed_corners(points: Floats, tolerance: float) -> Ints:
    """Return which points (n, 2) of a closed chain of borders of cells [step] are corners of its simplest polygon, in order.

    Points between two corners lie within the tolerance of the segment that joins these, or within what a digital line
    leaves of the line that fits them: where a cell at a corner is cut off, a polygon on the points has a side more.
    """
    opened = np.vstack([points, points[:1]])
    middle = int(open_corners(opened, tolerance)[1])
    turned = np.roll(points, -middle, axis=0)
    corners = open_corners(np.vstack([turned, turned[:1]]), tolerance)[:-1]
    return np.sort((_merged(turned, corners) + middle) % len(points))


def _merged(points: Floats, corners: Ints) -> Ints:
    """Take away corners (k,) of a closed chain whose two sides are one digital line, the straightest first."""
    kept = corners.tolist()
    while len(kept) > 3:
        leaves = [_off_line(points, kept[k - 1], kept[(k + 1) % len(kept)]) for k in range(len(kept))]
        k = int(np.argmin(leaves))
        if leaves[k] > DIGITAL:
            break
        del kept[k]
    return np.array(kept)


def _off_line(points: Floats, first: int, last: int) -> float:
    """Return how far points from one to another, but for their ends, are off the line that fits them at most.

    Where they go back along it, as into a slit and out again, or an end is more than a corner that is cut off, there is no
    such line: inf.
    """
    n = len(points)
    own = points[np.arange(first, last + (n if last <= first else 0) + 1) % n]
    inner = own[CUT:-CUT] if len(own) > 4 * CUT else own
    middle = inner.mean(axis=0)
    way = np.linalg.svd(inner - middle, full_matrices=False)[2][0]
    along, across = (inner - middle) @ way, np.array([-way[1], way[0]])
    goes_back = np.ptp(along) > abs(along[-1] - along[0]) + 2 * DIGITAL
    if goes_back or np.abs((own - middle) @ across).max() > CUT_OFF:
        return np.inf
    return float(np.abs((inner - middle) @ across).max())


@kernel
def open_corners(points: Floats, tolerance: float) -> Ints:
    """Return which points (n, 2) of a chain are corners of its simplest polyline, with both ends."""
    n = len(points)
    sums = np.zeros((n + 1, 5))
    for i in range(n):
        x, y = points[i, 0] - points[0, 0], points[i, 1] - points[0, 1]
        sums[i + 1, 0] = sums[i, 0] + x
        sums[i + 1, 1] = sums[i, 1] + y
        sums[i + 1, 2] = sums[i, 2] + x * x
        sums[i + 1, 3] = sums[i, 3] + x * y
        sums[i + 1, 4] = sums[i, 4] + y * y
    count = np.full(n, n, dtype=np.int64)
    misfit = np.full(n, np.inf)
    before = np.zeros(n, dtype=np.int64)
    count[0], misfit[0] = 0, 0.0
    for i in range(n - 1):
        low, high, farthest = -math.inf, math.inf, 0.0
        main = math.nan  # direction that angles are taken from: of the first point that limits them
        for j in range(i + 1, n):
            x, y = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            d = math.hypot(x, y)
            angle = 0.0
            if d > tolerance or not math.isnan(main):
                angle = math.atan2(y, x)
                main = angle if math.isnan(main) else main
                angle = (angle - main + math.pi) % (2 * math.pi) - math.pi
            if low <= angle <= high and d >= farthest - tolerance:
                total = misfit[i] + _misfit(sums, i, j)
                if count[i] + 1 < count[j] or (count[i] + 1 == count[j] and total < misfit[j]):
                    count[j], misfit[j], before[j] = count[i] + 1, total, i
            if d > tolerance:
                half = math.asin(tolerance / d)
                low, high = max(low, angle - half), min(high, angle + half)
                if low > high:
                    break
            farthest = max(farthest, d)
    out = np.zeros(count[n - 1] + 1, dtype=np.int64)
    at = n - 1
    for k in range(count[n - 1], -1, -1):
        out[k] = at
        at = before[at]
    return out


@kernel
def _misfit(sums: Floats, i: int, j: int) -> float:
    """Return the squares that the best line leaves of the points from i to j, by sums over the first k points (n + 1, 5)."""
    m = j + 1 - i
    sx, sy = (sums[j + 1, 0] - sums[i, 0]) / m, (sums[j + 1, 1] - sums[i, 1]) / m
    xx = sums[j + 1, 2] - sums[i, 2] - m * sx * sx
    xy = sums[j + 1, 3] - sums[i, 3] - m * sx * sy
    yy = sums[j + 1, 4] - sums[i, 4] - m * sy * sy
    return float(max(0.5 * (xx + yy - math.hypot(xx - yy, 2 * xy)), 0.0))


def plain_open_corners(points: Floats, tolerance: float) -> Ints:
    """Return what `open_corners` does, each segment measured by itself."""
    n = len(points)
    best: list[tuple[float, float, list[int]]] = [(0, 0.0, [0])]
    for j in range(1, n):
        options = []
        for i in range(j):
            own = points[i : j + 1]
            if _stays(own, tolerance):
                squares = np.linalg.svd(own - own.mean(axis=0), compute_uv=False)
                fewest, left, way = best[i]
                options.append((fewest + 1, left + float(squares[-1] ** 2), [*way, j]))
        best.append(min(options, key=lambda o: (o[0], o[1])))
    return np.array(best[-1][2])


def _stays(points: Floats, tolerance: float) -> bool:
    """Tell whether points (n, 2) stay within a tolerance of the chord from the first to the last."""
    chord = points[-1] - points[0]
    inner = points[1:-1] - points[0]
    length = float(np.hypot(*chord))
    if not len(inner):
        return True
    far = np.hypot(*inner.T)
    if length == 0.0:
        return bool((far <= tolerance).all())
    ahead, across = inner @ chord / length, inner @ np.array([-chord[1], chord[0]]) / length
    near = (np.abs(across) <= tolerance) & ((ahead >= 0) | (far <= tolerance))
    return bool(near.all() and far.max() <= length + tolerance)
