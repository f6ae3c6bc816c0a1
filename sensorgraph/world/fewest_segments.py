"""The fewest straight segments that stay within a tolerance of a closed chain of points, as bitmaps are traced.

Selinger (2003), "Potrace: a polygon-based tracing algorithm", section 2.2: of all polygons on the points that stay within
the tolerance, one with the fewest corners, and of these the one whose lines fit best.
"""

from __future__ import annotations

import math

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Floats, Ints


def closed_corners(points: Floats, tolerance: float) -> Ints:
    """Return which points (n, 2) of a closed chain are corners of its simplest polygon, in order, the first one among them.

    Points between two corners lie within the tolerance of the segment that joins these. The chain is opened at its first
    point, which should be a corner, and once more at the corner found farthest along from there.
    """
    n = len(points)
    first = open_corners(np.vstack([points, points[:1]]), tolerance)
    middle = int(first[len(first) // 2])
    turned = np.roll(points, -middle, axis=0)
    again = open_corners(np.vstack([turned, turned[:1]]), tolerance)[:-1]
    return np.sort((again + middle) % n)


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
