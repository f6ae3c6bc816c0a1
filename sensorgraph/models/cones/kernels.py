"""The nearest surface in a cone: compiled loops over readings and over stretches of faces.

Range to a stretch: r = sqrt(h² + s²), where h = n·q - d is the distance of the sensor q from the line n·p = d.
The nearest point is at the offset s from the foot of the perpendicular. It is the value of least magnitude in the
intersection of the intervals that the cone and the stretch cover on the line. A stretch is the visible part of the
line between two abscissae t·p, t = (-n_y, n_x).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planners.kernel import inner_kernel, kernel, outer_kernel
from sensorgraph.models.cones.settings import CONES
from sensorgraph.models.distribution import SQRT_HALF
from sensorgraph.models.faces.observed_space import is_ray_observed
from sensorgraph.models.faces.prediction import MIN_SHARE, SUPPORT_MARGIN
from sensorgraph.models.faces.visibility import MIN_COSINE
from sensorgraph.models.mixture import summarise

GRAZING = math.sqrt(1.0 - MIN_COSINE**2) / MIN_COSINE
"""Largest offset s of a cone's edge on a line, in units of h; the line is invisible beyond."""
MAX_CANDIDATES = 16
"""Maximum number of stretches considered in one cone."""
END_BLUR, EDGE_BLUR = 0.004, CONES.edge_blur
"""Standard errors of the end of a stretch [m], with which the search for it ends, and of the edge of a cone [rad]."""
BACK_SLOT = MAX_CANDIDATES + 1
"""Index in the list of ranges of the point where the axis meets a face from behind."""
MAX_BLURS = 3.0
"""Standard errors beyond which an end of a stretch is certainly inside or outside a cone."""


@inner_kernel
def cone_edge(cosine: float, sine: float, cos: float, sin: float) -> float:
    """Return the offset s, in units of h, at which the edge of a cone meets a line; limited to grazing incidence.

    Parameters
    ----------
    cosine, sine : Of the angle from the line's -n to the axis.
    cos, sin : Of the angle from the axis to the edge.
    """
    c, s = cosine * cos - sine * sin, sine * cos + cosine * sin
    if c <= MIN_COSINE:
        return -GRAZING if s > 0.0 else GRAZING
    return -s / c


@inner_kernel
def cone_on_line(
    nx: float, ny: float, ux: float, uy: float, h: float, cos: float, sin: float
) -> tuple[float, float]:
    """Return the first and the last offset s [m] that a cone covers on a line; the first is larger if it points past it.

    Parameters
    ----------
    ux, uy : Direction of the axis.
    h : [m] Distance of the sensor from the line n·p = d.
    cos, sin : Of the half opening angle.
    """
    c, s = -(nx * ux + ny * uy), ny * ux - nx * uy
    a, b = cone_edge(c, s, cos, sin) * h, cone_edge(c, s, cos, -sin) * h
    return (np.inf, -np.inf) if a >= b and abs(a) >= GRAZING * h else (a, b)


@outer_kernel
def ranges_to_stretch(
    origins: Any, directions: Any, halves: Any, nx: Any, ny: Any, d: Any, low: Any, high: Any, r: Any, t: Any
) -> Any:
    """Fill r (n,) [m] with the ranges to a stretch in each cone (inf: none), and t (n,) with the nearest abscissae."""
    half, cos, sin = 0.0, 1.0, 0.0
    for i in range(len(r)):
        qx, qy, ux, uy = origins[i, 0], origins[i, 1], directions[i, 0], directions[i, 1]
        r[i], t[i] = np.inf, 0.0
        h = nx * qx + ny * qy - d
        if h <= 0.0:
            continue
        if halves[i] != half:
            half, cos, sin = halves[i], math.cos(halves[i]), math.sin(halves[i])
        tq = nx * qy - ny * qx
        a, b = cone_on_line(nx, ny, ux, uy, h, cos, sin)
        a, b = max(a, low - tq), min(b, high - tq)
        if a <= b:
            s = min(max(0.0, a), b)
            r[i], t[i] = math.sqrt(h * h + s * s), tq + s


@outer_kernel
def count_along_line(
    origins: Any, directions: Any, halves: Any, ranges: Any, reach: Any, unexplained: Any, nx: Any, ny: Any,
    d: Any, tolerance: Any, margin: Any, start: Any, size: Any, hits: Any, new_hits: Any, passes: Any,
) -> Any:  # fmt: skip
    """Count readings in bins of `size` [m] along a line, from the abscissa `start`.

    Fills `hits` with the number of readings that end in a bin, within `tolerance` [m], and `new_hits` with the number
    of `unexplained` ones. Fills `passes`, which has one more entry, with the differences of the number of readings
    whose cone is clear in a bin, by `margin` [m].
    """
    n = len(hits)
    half, cos, sin = 0.0, 1.0, 0.0
    for i in range(len(ranges)):
        qx, qy, ux, uy = origins[i, 0], origins[i, 1], directions[i, 0], directions[i, 1]
        h = nx * qx + ny * qy - d
        clear = reach[i] - margin
        if h <= 0.0 or h > reach[i] + tolerance:
            continue
        if halves[i] != half:
            half, cos, sin = halves[i], math.cos(halves[i]), math.sin(halves[i])
        tq = nx * qy - ny * qx
        a, b = cone_on_line(nx, ny, ux, uy, h, cos, sin)
        if a > b:
            continue
        s = min(max(0.0, a), b)
        if abs(ranges[i] - math.sqrt(h * h + s * s)) < tolerance:
            at = int(np.floor((tq + s - start) / size))
            if 0 <= at < n:
                hits[at] += 1
                new_hits[at] += unexplained[i]
        if clear > h:
            wide = math.sqrt(clear * clear - h * h)
            first = int(np.ceil((max(a, -wide) + tq - start) / size))
            last = int(np.floor((min(b, wide) + tq - start) / size))
            first, last = min(max(first, 0), n), min(max(last, 0), n)
            if first < last:
                passes[first] += 1
                passes[last] -= 1


@inner_kernel
def stretches_in_cone(
    x: Any, y: Any, ux: Any, uy: Any, half: Any, range_max: Any, stretches: Any, levels: Any, r: Any, w: Any
) -> Any:
    """List the stretches in a cone by range r [m], with the probability w that each returns; return their number.

    An end of a stretch near the edge of the cone is inside with the probability Φ(margin / standard error). The entry r[BACK_SLOT] is the
    range at which the axis meets a stretch from behind, which is only possible from unobserved space.
    """
    cos, sin = math.cos(half), math.sin(half)
    n = 0
    r[BACK_SLOT] = 1e300
    for k in range(len(stretches)):
        nx, ny, d = stretches[k, 0], stretches[k, 1], stretches[k, 2]
        h = nx * x + ny * y - d
        if h > range_max:
            continue
        tq = nx * y - ny * x
        if h <= 0.0:
            ahead = nx * ux + ny * uy
            side = tq - h * (nx * uy - ny * ux) / ahead if ahead > 1e-9 else 1e300
            if stretches[k, 3] < side < stretches[k, 4]:
                r[BACK_SLOT] = min(r[BACK_SLOT], -h / ahead)
            continue
        right, left = cone_on_line(nx, ny, ux, uy, h, cos, sin)
        if right > left:
            continue
        low, high = max(right, stretches[k, 3] - tq), min(left, stretches[k, 4] - tq)
        at = min(max(0.0, low), high) if low <= high else 0.5 * (low + high)
        far = math.sqrt(h * h + at * at)
        share = levels[k] if low <= high else 0.0
        if (low == right) != (
            high == left
        ):  # the interval is between an end of the stretch and an edge of the cone
            turn = EDGE_BLUR * far * far / h
            margin = (high - low) / math.sqrt(END_BLUR**2 + turn * turn)
            share = levels[k] * 0.5 * math.erfc(-max(min(margin, MAX_BLURS), -MAX_BLURS) * SQRT_HALF)
        if share < MIN_SHARE or far > range_max:
            continue
        m = n
        while m > 0 and r[m - 1] > far:
            r[m], w[m] = r[m - 1], w[m - 1]
            m -= 1
        r[m], w[m] = far, share
        n = min(n + 1, MAX_CANDIDATES)
    return n


@inner_kernel
def is_cone_observed(
    x: Any, y: Any, ux: Any, uy: Any, half: Any, reach: Any, origin: Any, cell: Any, clearance: Any
) -> Any:
    """Return whether a cone lies in observed space; it is sampled with rays at most a cell apart at its end."""
    n = 2 * int(np.ceil(half * max(reach, 0.0) / cell))
    for m in range(n + 1):
        turn = half * (2.0 * m / n - 1.0) if n > 0 else 0.0
        cos, sin = math.cos(turn), math.sin(turn)
        if not is_ray_observed(
            x, y, ux * cos - uy * sin, uy * cos + ux * sin, reach, origin, cell, clearance
        ):
            return False
    return True


@kernel
def predict_cones(
    x: Any, y: Any, cos: Any, sin: Any, cos_b: Any, sin_b: Any, halves: Any, range_max: Any, stretches: Any,
    levels: Any, sigma: Any, origin: Any, cell: Any, clearance: Any, which: Any, table: Any, supported: Any,
) -> Any:  # fmt: skip
    """Fill table (n_poses, n_rays, 6) as `mixture.summarise`, and `supported` (n_poses, n_rays).

    The nearest stretch m stops the cone with probability w_m, so its weight is w_m prod_{i<m} (1 - w_i).

    Parameters
    ----------
    stretches : (n, 5) n_x, n_y, d, low, high of each stretch.
    levels : (n,) Probability that a stretch in the cone returns.
    supported : Filled with whether the cone lies in observed space.
    """
    r, w, spread = np.empty(BACK_SLOT + 1), np.empty(BACK_SLOT + 1), np.full(BACK_SLOT + 1, sigma)
    for i in range(len(x)):
        for b in range(len(cos_b)):
            ux, uy = cos[i] * cos_b[b] - sin[i] * sin_b[b], sin[i] * cos_b[b] + cos[i] * sin_b[b]
            n = stretches_in_cone(x[i], y[i], ux, uy, halves[b], range_max, stretches, levels, r, w)
            passed = 1.0
            for m in range(n):
                w[m], passed = passed * w[m], passed * (1.0 - w[m])
            row = table[i, b]
            row[0], row[1], row[2], row[3], row[4], row[5] = summarise(
                r, w, spread, n, passed, range_max, which
            )
            reach = range_max if row[4] > 0.5 else row[1] - SUPPORT_MARGIN
            supported[i, b] = r[BACK_SLOT] > reach and is_cone_observed(
                x[i], y[i], ux, uy, halves[b], reach, origin, cell, clearance
            )


@kernel
def list_cones(
    x: Any, y: Any, cos: Any, sin: Any, cos_b: Any, sin_b: Any, halves: Any, range_max: Any, stretches: Any,
    levels: Any, r: Any, w: Any, passed: Any,
) -> Any:  # fmt: skip
    """Fill the mixtures of all cones; return the largest number of candidates.

    Parameters
    ----------
    r, w : (n_poses, n_rays, `BACK_SLOT` + 1) Range [m] and weight of each stretch in a cone; other weights are 0.
    passed : (n_poses, n_rays) Probability that no stretch stops the cone.
    """
    most = 0
    for i in range(len(x)):
        for b in range(len(cos_b)):
            ux, uy = cos[i] * cos_b[b] - sin[i] * sin_b[b], sin[i] * cos_b[b] + cos[i] * sin_b[b]
            far, share = r[i, b], w[i, b]
            n = stretches_in_cone(x[i], y[i], ux, uy, halves[b], range_max, stretches, levels, far, share)
            left = 1.0
            for m in range(n):
                share[m], left = left * share[m], left * (1.0 - share[m])
            for m in range(n, len(share)):
                far[m], share[m] = np.inf, 0.0
            passed[i, b] = left
            most = max(most, n)
    return most
