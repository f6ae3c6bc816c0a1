"""Approximate a closed chain of points by the fewest straight segments within a tolerance, as in bitmap tracing.

Dynamic programming over the points minimises, in lexicographic order, (count, misfit):

    count[j] = min_i count[i] + 1,  misfit[j] = min_i misfit[i] + d(i, j).

The minimum is over points i whose chord to j stays within the tolerance of all points between. The term d(i,
j) is the sum of squared distances of the points i to j from their best line (Selinger 2003, "Potrace: a
polygon-based tracing algorithm", section 2.2).
"""

from __future__ import annotations

import math

import numpy as np

from planners.kernel import kernel, outer_kernel
from sensorgraph.types import Floats, Ints

DIGITAL = 0.75
"""[step] Distance of the midpoints of cell borders from the straight line drawn in the cells; at most 0.71."""
CUT = 2
"""Number of points that a corner may cut off at each end of a segment."""
CUT_OFF = DIGITAL + 0.5
"""[step] Maximum distance of these points from the line: a border midpoint half a step farther. A smaller
limit would lose the corners of pilasters."""


def closed_corners(points: Floats, tolerance: float) -> Ints:
    """Return the indices of the corners of the simplest polygon of a closed chain of cell borders (n, 2) [step].

    Points between two corners lie within the tolerance of their chord, or within `DIGITAL` of their best
    line. The second test is needed where a cell at a corner is cut off: a polygon on the points has an
    additional side there.
    """
    opened = np.vstack([points, points[:1]])
    middle = int(open_corners(opened, tolerance)[1])
    turned = np.roll(points, -middle, axis=0)
    corners = open_corners(np.vstack([turned, turned[:1]]), tolerance)[:-1]
    return np.sort((_merged(turned, corners) + middle) % len(points))


def _merged(points: Floats, corners: Ints) -> Ints:
    """Remove corners (k,) of a closed chain whose two sides form one digital line, the straightest first."""
    kept = corners.tolist()
    while len(kept) > 3:
        leaves = [_off_line(points, kept[k - 1], kept[(k + 1) % len(kept)]) for k in range(len(kept))]
        k = int(np.argmin(leaves))
        if leaves[k] > DIGITAL:
            break
        del kept[k]
    return np.array(kept)


def _off_line(points: Floats, first: int, last: int) -> float:
    """Return the maximum distance of the points of a stretch, without its ends, from their best line.

    It is inf without such a line: if the stretch turns back, as in a slit, or if its ends exceed a cut-off
    corner.
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
    """Return the indices of the corners of the simplest polyline of an open chain (n, 2), including both ends."""
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
        main = math.nan  # reference direction of the angles: that of the first limiting point
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


@outer_kernel
def _misfit(sums: Floats, i: int, j: int) -> float:
    """Return the squared distances of the points i to j from their best line, given prefix sums (n + 1, 5)."""
    m = j + 1 - i
    sx, sy = (sums[j + 1, 0] - sums[i, 0]) / m, (sums[j + 1, 1] - sums[i, 1]) / m
    xx = sums[j + 1, 2] - sums[i, 2] - m * sx * sx
    xy = sums[j + 1, 3] - sums[i, 3] - m * sx * sy
    yy = sums[j + 1, 4] - sums[i, 4] - m * sy * sy
    return float(max(0.5 * (xx + yy - math.hypot(xx - yy, 2 * xy)), 0.0))
