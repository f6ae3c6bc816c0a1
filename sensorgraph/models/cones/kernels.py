"""The nearest surface in a cone: compiled loops over readings, and over the stretches of faces.

A stretch is what is seen of the line n·p = d between two abscissae t·p, t = (-n_y, n_x). At the foot of the perpendicular
from q it is h = n·q - d away; s metres beside the foot, hypot(h, s). A cone about the axis u covers an interval of s, and
the nearest surface lies at the foot if that is within the cone and the stretch, else where the nearer of them ends.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planners.kernel import inner_kernel, kernel
from sensorgraph.models.cones.settings import CONES
from sensorgraph.models.faces.observed_space import is_ray_observed
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.mixture import SQRT_HALF, summarise

MIN_COSINE = CONES.min_cosine
GRAZING = math.sqrt(1.0 - MIN_COSINE**2) / MIN_COSINE
"""Metres to the side, in units of h, beyond which a line is out of sight."""
MAX_CANDIDATES, END_BLUR, EDGE_BLUR = CONES.max_candidates, CONES.end_blur, CONES.edge_blur
MIN_SHARE, SUPPORT_MARGIN = FACES.prediction.min_share, FACES.prediction.support_margin
BACK = MAX_CANDIDATES + 1
"""Place in the list of ranges of where the axis meets a face from behind."""
BLURS = 3.0
"""Standard errors beyond which an end is surely within a cone, or beside it."""


@inner_kernel
def cone_edge(cosine: float, sine: float, cos: float, sin: float) -> float:
    """Return how far to the side, in units of h, the edge of a cone meets a line; held at a grazing angle.

    Parameters
    ----------
    cosine, sine : of the angle from the line's -n to the axis
    cos, sin : of the angle from the axis to the edge
    """
    c, s = cosine * cos - sine * sin, sine * cos + cosine * sin
    if c <= MIN_COSINE:
        return -GRAZING if s > 0.0 else GRAZING
    return -s / c


@kernel
def ranges_to_stretch(
    origins: Any, directions: Any, halves: Any, nx: Any, ny: Any, d: Any, low: Any, high: Any, r: Any, t: Any
) -> Any:
    """Fill ranges r (n,) [m] to the nearest point of a stretch in each cone, inf for none, and its abscissa t (n,)."""
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
        c, s = -(nx * ux + ny * uy), ny * ux - nx * uy
        a, b = cone_edge(c, s, cos, sin) * h, cone_edge(c, s, cos, -sin) * h
        if a >= b and abs(a) >= GRAZING * h:  # all of the cone looks past the line
            continue
        a, b = max(a, low - tq), min(b, high - tq)
        if a <= b:
            s = min(max(0.0, a), b)
            r[i], t[i] = math.sqrt(h * h + s * s), tq + s


@kernel
def count_along_line(
    origins: Any,
    directions: Any,
    halves: Any,
    ranges: Any,
    reach: Any,
    free: Any,
    nx: Any,
    ny: Any,
    d: Any,
    tolerance: Any,
    margin: Any,
    start: Any,
    size: Any,
    hits: Any,
    fresh: Any,
    passes: Any,
) -> Any:
    """Count in bins of `size` [m] along a line, from abscissa `start` on, what readings say of it.

    Fills `hits`: readings that end there to `tolerance` [m]; `fresh`: those of them that are `free` of an explanation;
    `passes` (one longer, differences): those whose cone was clear there, by `margin` [m].
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
        c, s = -(nx * ux + ny * uy), ny * ux - nx * uy
        a, b = cone_edge(c, s, cos, sin) * h, cone_edge(c, s, cos, -sin) * h
        if a >= b and abs(a) >= GRAZING * h:
            continue
        s = min(max(0.0, a), b)
        if abs(ranges[i] - math.sqrt(h * h + s * s)) < tolerance:
            at = int(np.floor((tq + s - start) / size))
            if 0 <= at < n:
                hits[at] += 1
                fresh[at] += free[i]
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
    """List the stretches in a cone, nearest first: ranges r [m] and the chance w that each returns; return how many.

    An end that is about where the cone ends may be in it or beside it: its chance is shared out. r[BACK] is the range at
    which the axis meets a stretch from behind: it can only come from where nobody has looked.
    """
    cos, sin = math.cos(half), math.sin(half)
    n = 0
    r[BACK] = 1e300
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
                r[BACK] = min(r[BACK], -h / ahead)
            continue
        c, s = -(nx * ux + ny * uy), ny * ux - nx * uy
        right, left = cone_edge(c, s, cos, sin) * h, cone_edge(c, s, cos, -sin) * h
        if right >= left and abs(right) >= GRAZING * h:
            continue
        low, high = max(right, stretches[k, 3] - tq), min(left, stretches[k, 4] - tq)
        at = min(max(0.0, low), high) if low <= high else 0.5 * (low + high)
        far = math.sqrt(h * h + at * at)
        share = levels[k] if low <= high else 0.0
        if (low == right) != (high == left):  # one end of the stretch, one edge of the cone
            turn = EDGE_BLUR * far * far / h
            margin = (high - low) / math.sqrt(END_BLUR**2 + turn * turn)
            share = levels[k] * 0.5 * math.erfc(-max(min(margin, BLURS), -BLURS) * SQRT_HALF)
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
    x: Any, y: Any, ux: Any, uy: Any, half: Any, reach: Any, origin: Any, cell: Any, room: Any
) -> Any:
    """Look along rays that fill a cone, at most a cell apart where it ends."""
    n = 2 * int(np.ceil(half * max(reach, 0.0) / cell))
    for m in range(n + 1):
        turn = half * (2.0 * m / n - 1.0) if n > 0 else 0.0
        cos, sin = math.cos(turn), math.sin(turn)
        if not is_ray_observed(x, y, ux * cos - uy * sin, uy * cos + ux * sin, reach, origin, cell, room):
            return False
    return True


@kernel
def predict_cones(
    x: Any,
    y: Any,
    cos: Any,
    sin: Any,
    cos_b: Any,
    sin_b: Any,
    halves: Any,
    range_max: Any,
    stretches: Any,
    levels: Any,
    sigma: Any,
    origin: Any,
    cell: Any,
    room: Any,
    which: Any,
    table: Any,
    supported: Any,
) -> Any:
    """Fill table (n_poses, n_rays, 6) as `mixture.summarise` and `supported` (n_poses, n_rays): the cone was seen.

    Parameters
    ----------
    stretches : (n, 5) n_x, n_y, d, low, high
    levels : (n,) chance that a stretch in the cone returns
    """
    r, w, spread = np.empty(BACK + 1), np.empty(BACK + 1), np.full(BACK + 1, sigma)
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
            supported[i, b] = r[BACK] > reach and is_cone_observed(
                x[i], y[i], ux, uy, halves[b], reach, origin, cell, room
            )
