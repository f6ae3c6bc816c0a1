"""March of a ray through a bucket grid of faces: the faces that it crosses, in order of range.

Range to the face n·p = d from q in direction u: r = (d - n·q) / (n·u), for n·u < 0 (faces are one-sided).
The visibility of a face, the probability that a crossing ray stops, is constant between edges along it. Kernels take
the arrays of a `FaceSet`, in this order, as `faces`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from planners.kernel import inlined_kernel, inner_kernel, outer_kernel
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Floats, Ints

BUCKET_SIZE = 0.8
"""[m] Side of a bucket; 0.3 to 1.2 m perform alike."""
MAX_BUCKETS = 1 << 24
"""Maximum number of buckets of 8 bytes each: 11 km²."""
END_MARGIN = 0.02
"""[m] Distance beyond its ends up to which a face is listed, so that a blurred end is visible.

A ray that meets the back of a face farther inside than half of it came through solid matter."""
MIN_VISIBILITY = 0.003
"""Visibility below which a stretch is ignored."""
MIN_LENGTH = 1e-6
"""[m] Length up to which a stretch is empty."""
MAX_CANDIDATES = 96
"""Maximum number of faces listed for one ray."""
CANDIDATE_SLOTS = MAX_CANDIDATES + 1
"""Length of the arrays that hold candidates."""


class FaceSet(NamedTuple):
    """Faces as plain arrays for kernels; lengths in m."""

    normals: Floats
    """(n_faces, 2) unit vectors, towards the visible side."""
    offsets: Floats
    """(n_faces,) distances d of the lines from the origin of map."""
    first: Ints
    """(n_faces + 1,) index of each face's first edge; face k has edges first[k] to first[k + 1] - 1."""
    edges: Floats
    """(n_edges,) abscissae t·p, increasing along a face, t = (-n_y, n_x)."""
    levels: Floats
    """(n_edges,) visibility from an edge to the next; 0 after the last edge of a face."""
    blur: Floats
    """(n_edges,) standard error of an edge's position."""
    neighbour: Ints
    """(n_edges,) face that continues where this one ends; -1: none."""

    @property
    def n_faces(self) -> int:
        """Number of faces."""
        return len(self.offsets)

    @property
    def tangents(self) -> Floats:
        """(n_faces, 2) unit vectors: n turned by +90°."""
        return np.stack([-self.normals[:, 1], self.normals[:, 0]], axis=1)

    @property
    def owners(self) -> Ints:
        """(n_edges,) face of each edge."""
        return np.repeat(np.arange(self.n_faces), np.diff(self.first))

    def points(self, k: Ints, s: Floats) -> Floats:
        """Return the places (n, 2) on the lines of faces k (n,) at abscissae s (n,)."""
        return np.asarray(self.normals[k] * self.offsets[k, None] + self.tangents[k] * s[:, None])


class March(NamedTuple):
    """Faces that a ray crosses, nearest first; arrays of length `CANDIDATE_SLOTS`."""

    r: Floats
    """[m] Ranges. The last entry is the range at which the ray meets a face from behind."""
    k: Ints
    """Faces."""
    j: Ints
    """Edges before the crossings."""
    t: Floats
    """[m] Abscissae of the crossings."""


def new_march() -> March:
    """Return memory for the crossings of one ray."""
    n = CANDIDATE_SLOTS
    return March(np.empty(n), np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n))


class BucketGrid(NamedTuple):
    """Faces that pass through each bucket of a grid."""

    origin: Floats
    """(2,) [m] corner of the grid."""
    shape: tuple[int, int]
    start: Ints
    """(nx * ny + 1,) index of each bucket's first member."""
    members: Ints
    """(n,) faces, bucket by bucket."""


def bucket_grid(faces: FaceSet) -> BucketGrid:
    """List the faces of each bucket.

    Raises
    ------
    SensorgraphError : The faces are so far apart that the grid would be too large.
    """
    if faces.n_faces == 0:
        return BucketGrid(np.zeros(2), (1, 1), np.zeros(2, dtype=np.intp), np.zeros(0, dtype=np.intp))
    owner = faces.owners
    seen = faces.levels > MIN_VISIBILITY
    last = np.flatnonzero(seen)
    ends = np.concatenate([faces.edges[last], faces.edges[last + 1]])
    owners = np.concatenate([owner[last], owner[last]])
    points = faces.points(owners, ends)
    if len(points) == 0:
        points = np.zeros((1, 2))
    origin = points.min(axis=0) - 2 * END_MARGIN - 0.01
    size = np.floor((points.max(axis=0) + 2 * END_MARGIN - origin) / BUCKET_SIZE).astype(int) + 1
    shape = (int(size[0]), int(size[1]))
    if shape[0] * shape[1] > MAX_BUCKETS:
        width, depth = np.ptp(points, axis=0)
        raise SensorgraphError(
            f"faces lie {width:,.0f} x {depth:,.0f} m apart, expected at most {MAX_BUCKETS * BUCKET_SIZE**2 / 1e6:,.0f} "
            "km² in all: remove poses or ranges that are far off (sensorgraph inspect), and build the graph again"
        )
    counts = np.zeros(shape[0] * shape[1] + 1, dtype=np.intp)
    _rasterise(*faces[:5], origin, shape[0], shape[1], counts, np.zeros(0, dtype=np.intp))
    start = np.cumsum(counts) - counts
    members = np.zeros(int(counts.sum()), dtype=np.intp)
    _rasterise(*faces[:5], origin, shape[0], shape[1], start.copy(), members)
    return BucketGrid(origin, shape, start, members)


@outer_kernel
def _rasterise(
    normals: Any, offsets: Any, first: Any, edges: Any, levels: Any, origin: Any, nx: Any, ny: Any, at: Any,
    members: Any,
) -> Any:  # fmt: skip
    """Count the buckets of each face in `at`, or fill `members` from these indices if it is not empty."""
    fill = len(members) > 0
    for k in range(len(offsets)):
        low, high = 1e300, -1e300
        for j in range(first[k], first[k + 1] - 1):
            if levels[j] > MIN_VISIBILITY:
                low = min(low, edges[j])
                high = max(high, edges[j + 1])
        if high < low:
            continue
        low -= END_MARGIN
        high += END_MARGIN
        n_x, n_y = normals[k, 0], normals[k, 1]
        ax, ay = n_x * offsets[k] - n_y * low, n_y * offsets[k] + n_x * low
        dx, dy = -n_y * (high - low), n_x * (high - low)
        i0 = max(int((min(ax, ax + dx) - 1e-6 - origin[0]) / BUCKET_SIZE), 0)
        i1 = min(int((max(ax, ax + dx) + 1e-6 - origin[0]) / BUCKET_SIZE), nx - 1)
        j0 = max(int((min(ay, ay + dy) - 1e-6 - origin[1]) / BUCKET_SIZE), 0)
        j1 = min(int((max(ay, ay + dy) + 1e-6 - origin[1]) / BUCKET_SIZE), ny - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                s_in, s_out = 0.0, 1.0
                for axis in range(2):
                    a = ax if axis == 0 else ay
                    v = dx if axis == 0 else dy
                    lo = origin[axis] + (i if axis == 0 else j) * BUCKET_SIZE - 1e-6
                    hi = lo + BUCKET_SIZE + 2e-6
                    if abs(v) < 1e-12:
                        if a < lo or a > hi:
                            s_out = -1.0
                    else:
                        p, q = (lo - a) / v, (hi - a) / v
                        s_in = max(s_in, min(p, q))
                        s_out = min(s_out, max(p, q))
                if s_in <= s_out:
                    bucket = i * ny + j
                    if fill:
                        members[at[bucket]] = k
                    at[bucket] += 1


@inner_kernel
def edge_before(edges: Any, a: Any, b: Any, t: Any) -> Any:
    """Return j with edges[j] <= t < edges[j + 1] among a ... b - 1; a - 1 before the first, b - 1 after the last."""
    low, high = a, b
    while low < high:
        middle = (low + high) // 2
        if edges[middle] <= t:
            low = middle + 1
        else:
            high = middle
    return low - 1


@inlined_kernel
def crossed_faces(
    qx: Any, qy: Any, ux: Any, uy: Any, reach: Any, least: Any, faces: Any, buckets: Any, march: Any
) -> Any:
    """List the faces that a ray crosses up to `reach` [m], nearest first; return their number.

    Fills a `March`. Stops early when the survival probability is below `least`. The entry r[MAX_CANDIDATES] is the range
    at which the ray meets a face from behind, which is only possible from unobserved space.

    The function is one loop for speed, since every ray of every prediction runs through it.
    """
    normals, offsets, first, edges, levels, _, _ = faces
    origin, shape, start, members = buckets
    r, k, j, t = march
    nx, ny = shape
    n = 0
    r[MAX_CANDIDATES] = 1e300
    x, y = qx - origin[0], qy - origin[1]
    per_x = 1.0 / ux if abs(ux) > 1e-15 else 1e300  # [m/m] length of the ray per metre along the axis, signed
    per_y = 1.0 / uy if abs(uy) > 1e-15 else 1e300
    width, depth = nx * BUCKET_SIZE, ny * BUCKET_SIZE
    enter, leave = 0.0, reach
    if per_x < 1e299:
        a, b = -x * per_x, (width - x) * per_x
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    elif x < 0 or x > width:
        return 0
    if per_y < 1e299:
        a, b = -y * per_y, (depth - y) * per_y
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    elif y < 0 or y > depth:
        return 0
    if enter >= leave:
        return 0
    i_x = min(max(int((x + enter * ux) / BUCKET_SIZE), 0), nx - 1)
    i_y = min(max(int((y + enter * uy) / BUCKET_SIZE), 0), ny - 1)
    step_x = 1 if ux > 0 else -1
    step_y = 1 if uy > 0 else -1
    next_x = ((i_x + (1 if ux > 0 else 0)) * BUCKET_SIZE - x) * per_x if per_x < 1e299 else 1e300
    next_y = ((i_y + (1 if uy > 0 else 0)) * BUCKET_SIZE - y) * per_y if per_y < 1e299 else 1e300
    per_x, per_y = BUCKET_SIZE * abs(per_x), BUCKET_SIZE * abs(per_y)
    r_in = enter
    survival = 1.0
    while True:
        r_out = min(next_x, next_y)
        since = n
        bucket = i_x * ny + i_y
        for m in range(start[bucket], start[bucket + 1]):
            f = members[m]
            den = normals[f, 0] * ux + normals[f, 1] * uy
            if den > 1e-6:
                above = offsets[f] - normals[f, 0] * qx - normals[f, 1] * qy
                if r_in * den <= above < r_out * den and above < r[MAX_CANDIDATES] * den:
                    rho = above / den
                    s = -normals[f, 1] * (qx + rho * ux) + normals[f, 0] * (qy + rho * uy)
                    at = edge_before(edges, first[f], first[f + 1], s)
                    if (
                        first[f] <= at < first[f + 1] - 1
                        and levels[at] > 0.5
                        and edges[at] + 0.5 * END_MARGIN < s < edges[at + 1] - 0.5 * END_MARGIN
                    ):
                        r[MAX_CANDIDATES] = rho
                continue
            if den > -1e-6:
                continue
            above = offsets[f] - normals[f, 0] * qx - normals[f, 1] * qy
            if above >= 0 or above > r_in * den or above <= r_out * den:
                continue
            rho = above / den
            if rho > reach:
                continue
            s = -normals[f, 1] * (qx + rho * ux) + normals[f, 0] * (qy + rho * uy)
            a, b = first[f], first[f + 1]
            if s < edges[a] - END_MARGIN or s > edges[b - 1] + END_MARGIN or n >= MAX_CANDIDATES:
                continue
            at = n
            while at > since and r[at - 1] > rho:
                r[at], k[at], j[at], t[at] = r[at - 1], k[at - 1], j[at - 1], t[at - 1]
                at -= 1
            r[at], k[at], t[at] = rho, f, s
            j[at] = edge_before(edges, a, b, s)
            n += 1
        for m in range(since, n):
            if j[m] >= first[k[m]]:
                survival *= 1.0 - levels[j[m]]
        if survival < least or r_out >= leave:
            return n
        r_in = r_out
        if next_x < next_y:
            next_x += per_x
            i_x += step_x
        else:
            next_y += per_y
            i_y += step_y
        if i_x < 0 or i_x >= nx or i_y < 0 or i_y >= ny:
            return n
