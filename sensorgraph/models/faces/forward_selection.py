"""Forward selection of faces on pooled moments: the face that explains most hits first.

The criterion is the error reduction ratio, with faces as terms. A line n·p = d minimises sum_i w_i (n·p_i - d)²
(total least squares): n is the eigenvector of the smaller eigenvalue of the covariance of its hits.

Each cell of hits votes for the lines through it whose normal agrees with its surroundings (Hough transform). The
strongest line is fitted, cut at gaps in its hits, and its cells are removed. The cost depends on the number of cells
that were hit, not on the length of the log.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.array_kernels import make_heap, pop_least
from planners.kernel import inlined_kernel, inner_kernel, kernel
from sensorgraph.models.faces.hit_moments import HIT_CELL, HitMoments
from sensorgraph.models.faces.settings import FACES, LineLimits
from sensorgraph.types import Floats, Ints

N_ANGLES, VOTE_SPREAD = 240, 3
"""Number of normal angles over the full circle, since faces are one-sided; neighbouring bins on each side that a cell also votes for."""
OFFSET_BIN = HIT_CELL
"""[m] Bin size of the offset."""
BAND_SIGMAS, MIN_BAND, FIRST_BAND = 3.0, 0.6 * HIT_CELL, 1.5 * OFFSET_BIN
"""Half width of the band of a line: in standard deviations of hits across it, [m] at least, and [m] at first."""
NEIGHBOURHOODS, MIN_NEIGHBOURHOOD_HITS = (2, 4), 3
"""Cells to each side whose hits, of which so many are needed, determine the normal of a cell; the second if the first is unclear."""
MIN_ELONGATION = 3.0
"""Minimum ratio of the variances of hits along and across for a clear normal."""
MIN_FACING = 0.02
"""Minimum cosine between a line's normal and the direction to the laser for a cell of the line."""
MAX_TURN = np.radians(40.0)
"""[rad] Largest angle between the normals of a line and of a cell on it, and between those before and after a fit."""
MAX_TURN_BINS, MIN_AGREEMENT = N_ANGLES * MAX_TURN / (2 * np.pi), np.cos(MAX_TURN)
REFITS = 4
"""Number of alternating fits of a line and its cells."""
MAX_LINES = 4096
"""Largest number of lines in one call, and number of bins without a line after which the search ends."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lines:
    """One-sided lines n·p = d with the interval of abscissae t·p of their hits; t is n turned by +90°."""

    normals: Floats
    """(n_faces, 2) unit vectors, towards the visible side."""
    offsets: Floats
    """(n_faces,) [m] distances d from the origin of map."""
    spans: Floats
    """(n_faces, 2) [m] first and last abscissa."""

    def __len__(self) -> int:
        return len(self.offsets)

    def joined(self, other: Lines) -> Lines:
        """Return the lines of both, those of self first."""
        return Lines(
            normals=np.concatenate([self.normals, other.normals]),
            offsets=np.concatenate([self.offsets, other.offsets]),
            spans=np.concatenate([self.spans, other.spans]),
        )

    def take(self, index: Ints) -> Lines:
        """Return a subset, in the order of `index`."""
        return Lines(normals=self.normals[index], offsets=self.offsets[index], spans=self.spans[index])


def select_lines(hit_moments: HitMoments, *, sigma: float, limits: LineLimits = FACES.first_lines) -> Lines:
    """Select lines until no more lines satisfy the limits.

    Parameters
    ----------
    sigma : [m] Standard deviation of hits across a face (range noise and pose noise).
    limits : Minimum hits and length of a line, and the gap that ends it.
    """
    if len(hit_moments.cells) == 0:
        return Lines(normals=np.zeros((0, 2)), offsets=np.zeros(0), spans=np.zeros((0, 2)))
    low = hit_moments.cells.min(axis=0)
    shape = hit_moments.cells.max(axis=0) - low + 1
    grid = np.full((int(shape[0]), int(shape[1])), -1, dtype=np.int32)
    column, row = (hit_moments.cells - low).T
    grid[column, row] = np.arange(len(hit_moments.cells), dtype=np.int32)
    middle = hit_moments.centres.mean(axis=0)  # so that d is small far from the origin of map
    rows = _select_lines(
        grid, np.ascontiguousarray(column), np.ascontiguousarray(row), hit_moments.centres - middle,
        hit_moments.moments, float(max(BAND_SIGMAS * sigma, MIN_BAND)), limits.min_hits, limits.gap,
        limits.min_length,
    )  # fmt: skip
    normals = rows[:, :2]
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    return Lines(
        normals=normals,
        offsets=rows[:, 2] + normals @ middle,
        spans=rows[:, 3:5] + (tangents @ middle)[:, None],
    )


@kernel
def _select_lines(
    grid: Any, column: Any, row: Any, centres: Any, moments: Any, band: Any, min_hits: Any, gap: Any,
    min_length: Any,
) -> Any:  # fmt: skip
    n_cells = len(column)
    angle = _normal_bins(grid, column, row, centres, moments)
    mean = np.empty((n_cells, 2))
    for i in range(n_cells):
        for j in range(2):
            mean[i, j] = centres[i, j] + moments[i, 1 + j] / max(moments[i, 0], 1e-9)
    reach = 0.0
    for i in range(n_cells):
        reach = max(reach, np.hypot(mean[i, 0], mean[i, 1]))
    n_d = int(2 * reach / OFFSET_BIN) + 5
    cos, sin, stale = np.empty(N_ANGLES), np.empty(N_ANGLES), np.empty(N_ANGLES, np.bool_)
    for b in range(N_ANGLES):
        stale[b] = True
        cos[b], sin[b] = np.cos(2 * np.pi * b / N_ANGLES), np.sin(2 * np.pi * b / N_ANGLES)
    votes = np.zeros((N_ANGLES, n_d))
    tops = np.zeros(N_ANGLES)
    places = np.zeros(N_ANGLES, np.int64)
    live = np.empty(n_cells, np.bool_)
    for i in range(n_cells):
        live[i] = True
        _vote(votes, i, angle, mean, moments, cos, sin, reach, 1.0)
    found = np.zeros((MAX_LINES, 5))
    n_found = 0
    failures = 0
    while n_found < len(found) and failures < MAX_LINES:
        for a in range(N_ANGLES):
            if stale[a]:
                places[a] = np.argmax(votes[a])
                tops[a] = votes[a, places[a]]
                stale[a] = False
        best = np.argmax(tops)
        if tops[best] < 0.5 * min_hits:  # a cell's vote is divided between two bins of the offset
            break
        a, k = int(best), int(places[best])
        line, members = _fit_run(
            cos[a], sin[a], (k - 2 + 0.5) * OFFSET_BIN - reach, mean, moments, live, angle, band, gap,
            min_length, min_hits,
        )  # fmt: skip
        if len(members) == 0:
            votes[a, k] = 0.0  # no line satisfies the limits there
            stale[a] = True
            failures += 1
            continue
        for c in range(5):
            found[n_found, c] = line[c]
        n_found += 1
        for i in members:
            live[i] = False
            _vote(votes, i, angle, mean, moments, cos, sin, reach, -1.0)
            own = int(angle[i])
            if own >= 0:
                for s in range(-VOTE_SPREAD, VOTE_SPREAD + 1):
                    stale[(own + s) % N_ANGLES] = True
    return found[:n_found].copy()


@inner_kernel
def _vote(
    votes: Any, i: Any, angle: Any, mean: Any, moments: Any, cos: Any, sin: Any, reach: Any, sign: Any
) -> Any:
    """Add the hits of cell i to lines n·p = d near its normal, or remove them (`sign` -1).

    The bin of the angle s bins away has the weight 1 - |s| / (VOTE_SPREAD + 1), divided linearly between two bins of d.
    """
    if angle[i] < 0:
        return
    for s in range(-VOTE_SPREAD, VOTE_SPREAD + 1):
        a = (int(angle[i]) + s) % N_ANGLES
        d = (cos[a] * mean[i, 0] + sin[a] * mean[i, 1] + reach) / OFFSET_BIN + 2
        k = int(np.floor(d - 0.5))
        f = d - 0.5 - k
        w = sign * moments[i, 0] * (1 - abs(s) / (VOTE_SPREAD + 1.0))
        votes[a, k] += (1 - f) * w
        votes[a, k + 1] += f * w


@kernel
def _normal_bins(grid: Any, column: Any, row: Any, centres: Any, moments: Any) -> Any:
    """Return the angle bin of each cell's normal, from the moments of surrounding cells; -1 if it is unclear.

    With the covariance (xx, xy, yy) of the hits, their long axis has the angle ½ atan2(2 xy, xx - yy), and their variances
    along and across it are ½ (xx + yy) ± sqrt(¼ (xx - yy)² + xy²). The normal faces the mean direction of the rays.
    """
    n_cells = len(column)
    nx, ny = grid.shape
    angle = np.empty(n_cells)
    for i in range(n_cells):
        angle[i] = -1.0
        for half in NEIGHBOURHOODS:
            m0, mx, my, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            ux, uy = moments[i, 6], moments[i, 7]
            for c in range(max(column[i] - half, 0), min(column[i] + half + 1, nx)):
                for r in range(max(row[i] - half, 0), min(row[i] + half + 1, ny)):
                    j = grid[c, r]
                    if j < 0:
                        continue
                    m = moments[j]
                    if m[6] * moments[i, 6] + m[7] * moments[i, 7] < 0:
                        continue
                    dx, dy = centres[j, 0] - centres[i, 0], centres[j, 1] - centres[i, 1]
                    m0 += m[0]
                    mx += m[1] + m[0] * dx
                    my += m[2] + m[0] * dy
                    xx += m[3] + 2 * dx * m[1] + m[0] * dx * dx
                    xy += m[4] + dx * m[2] + dy * m[1] + m[0] * dx * dy
                    yy += m[5] + 2 * dy * m[2] + m[0] * dy * dy
                    ux += m[6]
                    uy += m[7]
            if m0 < MIN_NEIGHBOURHOOD_HITS:
                continue
            xx, xy, yy = xx / m0 - (mx / m0) ** 2, xy / m0 - mx * my / m0**2, yy / m0 - (my / m0) ** 2
            mid, half_gap = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
            if mid + half_gap > MIN_ELONGATION * (mid - half_gap):
                along = 0.5 * np.arctan2(2 * xy, xx - yy)
                nx_, ny_ = -np.sin(along), np.cos(along)
                if nx_ * ux + ny_ * uy > 0:
                    nx_, ny_ = -nx_, -ny_
                angle[i] = np.floor(np.arctan2(ny_, nx_) / (2 * np.pi) * N_ANGLES + 0.5) % N_ANGLES
                break
    return angle


@inlined_kernel
def _is_on_line(i: Any, nx: Any, ny: Any, d: Any, width: Any, mean: Any, moments: Any, angle: Any) -> Any:
    """Return whether cell i lies within `width` [m] of a line, and its hits and its normal face the same way."""
    if abs(nx * mean[i, 0] + ny * mean[i, 1] - d) > width:
        return False
    if nx * moments[i, 6] + ny * moments[i, 7] > -MIN_FACING * moments[i, 0]:
        return False
    if angle[i] < 0:
        return True
    turn = abs(angle[i] - np.arctan2(ny, nx) / (2 * np.pi) * N_ANGLES) % N_ANGLES
    return min(turn, N_ANGLES - turn) <= MAX_TURN_BINS


@inner_kernel
def _moments_of(members: Any, mean: Any, moments: Any) -> Any:
    """Return the number of hits of some cells, their mean x and y [m], and their covariance xx, xy, yy [m²]."""
    m0, mx, my, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    x0, y0 = mean[members[0], 0], mean[members[0], 1]
    for i in members:
        w = moments[i, 0]
        x, y = mean[i, 0] - x0, mean[i, 1] - y0
        m0 += w
        mx += w * x
        my += w * y
        xx += w * x * x + (moments[i, 3] - moments[i, 1] ** 2 / w)
        xy += w * x * y + (moments[i, 4] - moments[i, 1] * moments[i, 2] / w)
        yy += w * y * y + (moments[i, 5] - moments[i, 2] ** 2 / w)
    cx, cy = mx / m0, my / m0
    return m0, cx + x0, cy + y0, xx / m0 - cx * cx, xy / m0 - cx * cy, yy / m0 - cy * cy


@kernel
def _fit_run(
    c: Any, s: Any, d: Any, mean: Any, moments: Any, live: Any, angle: Any, band: Any, gap: Any, min_length: Any,
    min_hits: Any,
) -> Any:  # fmt: skip
    """Fit the line near (c, s, d) to its strongest run of live cells; return no members if there is no such run."""
    nx, ny = c, s
    none = np.empty(0, np.int64)
    line = np.zeros(5)
    n_cells = len(mean)
    index = np.empty(n_cells, np.int64)
    low, high = -np.inf, np.inf
    for step in range(REFITS):
        width = max(band, FIRST_BAND) if step == 0 else band
        n = 0
        for i in range(n_cells):
            if not live[i] or not _is_on_line(i, nx, ny, d, width, mean, moments, angle):
                continue
            t = -ny * mean[i, 0] + nx * mean[i, 1]
            if t < low - gap or t > high + gap:
                continue
            index[n] = i
            n += 1
        if n == 0:
            return line, none
        heap, place = np.empty(n, np.int64), np.empty(n)
        for k in range(n):
            place[k] = -ny * mean[index[k], 0] + nx * mean[index[k], 1]
        make_heap(heap, n, place)
        members: Any = np.empty(n, np.int64)
        t = np.empty(n)
        for k in range(n):
            o = pop_least(heap, n - k, place)
            members[k], t[k] = index[o], place[o]
        first, last, most = 0, 0, -1.0
        start, total = 0, 0.0
        for k in range(n):
            if k > 0 and t[k] - t[k - 1] > gap:
                start, total = k, 0.0
            total += moments[members[k], 0]
            if total > most:
                first, last, most = start, k, total
        members = members[first : last + 1]
        low, high = t[first], t[last]
        m0, x, y, xx, xy, yy = _moments_of(members, mean, moments)
        if m0 < min_hits or high - low + HIT_CELL < min_length:
            return line, none
        if high - low > 2 * band or step == REFITS - 1:
            along = 0.5 * np.arctan2(2 * xy, xx - yy)
            ax, ay = -np.sin(along), np.cos(along)
            if ax * nx + ay * ny < 0:
                ax, ay = -ax, -ay
            if ax * nx + ay * ny > MIN_AGREEMENT:
                nx, ny = ax, ay
        d = nx * x + ny * y
        low = high = -ny * mean[members[0], 0] + nx * mean[members[0], 1]
        for i in members:
            t_i = -ny * mean[i, 0] + nx * mean[i, 1]
            low, high = min(low, t_i), max(high, t_i)
    line[0], line[1], line[2], line[3], line[4] = nx, ny, d, low, high
    return line, members
