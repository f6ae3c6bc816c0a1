"""Forward selection of faces on pooled moments: the face that explains most hits first.

The criterion is the error reduction ratio, with faces as terms. A line n·p = d minimises sum_i w_i (n·p_i - d)²
(total least squares): n is the eigenvector of the smaller eigenvalue of the covariance of its hits.

Each cell of hits votes for the lines through it whose normal agrees with its surroundings (Hough transform). The
strongest line is fitted, cut at gaps in its hits, and its cells are removed. The cost depends on the number of cells
that were hit, not on the length of the log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from planners.array_kernels import make_heap, pop_least
from planners.kernel import inlined_kernel, inner_kernel, outer_kernel
from sensorgraph.models.faces.hit_moments import HIT_CELL, HitMoments
from sensorgraph.models.faces.settings import FACES, LineLimits
from sensorgraph.types import Bools, Floats, Ints

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


def coarseness(range_noise: float) -> int:
    """Return the number of times that a range noise [m] is `FACES.first_sigma`, at least 1."""
    return max(round(range_noise / FACES.first_sigma), 1)


def select_lines(
    hit_moments: HitMoments, *, sigma: float, coarse: int = 1, limits: LineLimits = FACES.first_lines,
    facing: bool = False,
) -> Lines:  # fmt: skip
    """Select lines until no more lines satisfy the limits.

    Parameters
    ----------
    sigma : [m] Standard deviation of hits across a face (range noise and pose noise).
    coarse : `coarseness` of the laser: cells, gaps and lengths suit one of `FACES.first_sigma`. Hits of another one are
        selected as those of a place that is so many times smaller.
    limits : Minimum hits and length of a line, and the gap that ends it.
    facing : Whether hits without a clear normal may be a line that faces their rays; otherwise no line begins there.
    """
    if coarse > 1:
        lines = select_lines(
            hit_moments.scaled_down(coarse), sigma=sigma / coarse, limits=limits, facing=facing
        )
        return Lines(normals=lines.normals, offsets=coarse * lines.offsets, spans=coarse * lines.spans)
    if len(hit_moments.cells) == 0:
        return Lines(normals=np.zeros((0, 2)), offsets=np.zeros(0), spans=np.zeros((0, 2)))
    low = hit_moments.cells.min(axis=0)
    shape = hit_moments.cells.max(axis=0) - low + 1
    grid = np.full((int(shape[0]), int(shape[1])), -1, dtype=np.int32)
    column, row = (hit_moments.cells - low).T
    grid[column, row] = np.arange(len(hit_moments.cells), dtype=np.int32)
    middle = hit_moments.centres.mean(axis=0)  # so that d is small far from the origin of map
    centres, moments = hit_moments.centres - middle, hit_moments.moments
    mean = centres + moments[:, 1:3] / np.maximum(moments[:, :1], 1e-9)
    reach = float(np.hypot(*mean.T).max())
    found = np.zeros((MAX_LINES, 5))
    n_lines = _select_lines(
        grid, np.ascontiguousarray(column), np.ascontiguousarray(row), centres, mean, moments, reach,
        float(max(BAND_SIGMAS * sigma, MIN_BAND)), limits.min_hits, limits.gap, limits.min_length,
        facing, _new_work(len(mean), reach), found,
    )  # fmt: skip
    rows = found[:n_lines]
    normals = rows[:, :2]
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    return Lines(
        normals=normals,
        offsets=rows[:, 2] + normals @ middle,
        spans=rows[:, 3:5] + (tangents @ middle)[:, None],
    )


def select_small_lines(sides: Sequence[HitMoments], *, sigma: float, coarse: int = 1) -> Lines:
    """Select lines among hits that longer lines leave unexplained, on each side of things separately.

    Hits on the front and on the back of a thing that is as thin as the noise lie in the same cells, where they have no common
    normal. So only hits of similar ray directions are pooled. A thing as narrow as the noise, such as the leg of a chair,
    has no clear normal from any side; it is a line that faces the laser.

    Parameters
    ----------
    sides : Hits by the direction of their rays (`HitMoments.by_direction`).
    sigma, coarse : As for `select_lines`.
    """
    found = [
        select_lines(hits, sigma=sigma, coarse=coarse, limits=FACES.later_lines, facing=True)
        for hits in sides
    ]
    return reduce(Lines.joined, found)


class SelectionWork(NamedTuple):
    """Memory of the kernels: a row for each cell, then for each angle.

    The kernels pass on single arrays: to pass all of them takes a second more to compile.
    """

    angle: Floats
    """Bin of the normal's angle; -1 if it is unclear."""
    live: Bools
    """Whether the cell is on no line yet."""
    members: Ints
    """Cells of the line that is fitted."""
    heap: Ints
    places: Floats
    """[m] Abscissae of these cells."""
    order: Ints
    votes: Floats
    """(N_ANGLES, n_offsets)"""
    tops: Floats
    """Most votes of the angle, and their bin of the offset."""
    peaks: Ints
    stale: Bools
    """Whether the votes have changed since."""
    cos: Floats
    sin: Floats


def _new_work(n: int, reach: float) -> SelectionWork:
    """Return memory for n cells up to `reach` [m] from the origin."""
    angles, n_offsets = np.zeros((3, N_ANGLES)), int(2 * reach / OFFSET_BIN) + 5
    whole = np.empty((3, n), np.int64)
    return SelectionWork(
        angle=np.empty(n), live=np.ones(n, np.bool_), members=whole[0], heap=whole[1], places=np.empty(n),
        order=whole[2], votes=np.zeros((N_ANGLES, n_offsets)), tops=angles[0],
        peaks=np.zeros(N_ANGLES, np.int64), stale=np.ones(N_ANGLES, np.bool_), cos=angles[1], sin=angles[2],
    )  # fmt: skip


@outer_kernel
def _select_lines(
    grid: Any, column: Any, row: Any, centres: Any, mean: Any, moments: Any, reach: Any, band: Any,
    min_hits: Any, gap: Any, min_length: Any, facing: Any, work: Any, found: Any,
) -> Any:  # fmt: skip
    """Write lines to `found`: normal, offset, first and last abscissa; return their number."""
    angle, live, members, heap, places, order, votes, tops, peaks, stale, cos, sin = work
    _find_normals(grid, column, row, centres, moments, facing, angle)
    for b in range(N_ANGLES):
        cos[b], sin[b] = np.cos(2 * np.pi * b / N_ANGLES), np.sin(2 * np.pi * b / N_ANGLES)
    for i in range(len(mean)):
        _vote(votes, i, angle, mean, moments, cos, sin, reach, 1.0)
    n_found = 0
    failures = 0
    while n_found < len(found) and failures < MAX_LINES:
        a = 0
        for b in range(N_ANGLES):
            if stale[b]:
                peaks[b], stale[b] = 0, False
                for k in range(votes.shape[1]):
                    if votes[b, k] > votes[b, peaks[b]]:
                        peaks[b] = k
                tops[b] = votes[b, peaks[b]]
            if tops[b] > tops[a]:
                a = b
        if tops[a] < 0.5 * min_hits:  # a cell's vote is divided between two bins of the offset
            break
        n = _fit_run(
            cos[a], sin[a], (peaks[a] - 2 + 0.5) * OFFSET_BIN - reach, mean, moments, band, gap, min_length,
            min_hits, angle, live, members, heap, places, order, found[n_found],
        )  # fmt: skip
        if n == 0:
            votes[a, peaks[a]] = 0.0  # no line satisfies the limits there
            stale[a] = True
            failures += 1
            continue
        n_found += 1
        for m in range(n):
            i = members[m]
            live[i] = False
            _vote(votes, i, angle, mean, moments, cos, sin, reach, -1.0)
            own = int(angle[i])
            if own >= 0:
                for s in range(-VOTE_SPREAD, VOTE_SPREAD + 1):
                    stale[(own + s) % N_ANGLES] = True
    return n_found


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


@inner_kernel
def _find_normals(
    grid: Any, column: Any, row: Any, centres: Any, moments: Any, facing: Any, angle: Any
) -> Any:
    """Find the bin of the angle of each cell's normal, from the moments of surrounding cells.

    An unclear normal is -1, or faces the rays of the cell if `facing`.

    With the covariance (xx, xy, yy) of the hits, their long axis has the angle ½ atan2(2 xy, xx - yy), and their variances
    along and across it are ½ (xx + yy) ± sqrt(¼ (xx - yy)² + xy²). The normal faces the mean direction of the rays.
    """
    nx, ny = grid.shape
    for i in range(len(column)):
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
                angle[i] = _bin_of(nx_, ny_)
                break
        if facing and angle[i] < 0:
            angle[i] = _bin_of(-moments[i, 6], -moments[i, 7])


@inlined_kernel
def _bin_of(nx: Any, ny: Any) -> Any:
    """Return the bin of the angle of a normal."""
    return np.floor(np.arctan2(ny, nx) / (2 * np.pi) * N_ANGLES + 0.5) % N_ANGLES


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
def _moments_of(n: Any, members: Any, mean: Any, moments: Any) -> Any:
    """Return the number of hits of n cells, their mean x and y [m], and their covariance xx, xy, yy [m²]."""
    m0, mx, my, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    x0, y0 = mean[members[0], 0], mean[members[0], 1]
    for k in range(n):
        i = members[k]
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


@inner_kernel
def _fit_run(
    c: Any, s: Any, d: Any, mean: Any, moments: Any, band: Any, gap: Any, min_length: Any, min_hits: Any,
    angle: Any, live: Any, members: Any, heap: Any, places: Any, order: Any, line: Any,
) -> Any:  # fmt: skip
    """Fit the line near (c, s, d) to its strongest run of live cells, the members; return their number, 0 if there is no such run."""
    nx, ny = c, s
    low, high, n = -np.inf, np.inf, 0
    for step in range(REFITS):
        width = max(band, FIRST_BAND) if step == 0 else band
        near = 0
        for i in range(len(mean)):
            if not live[i] or not _is_on_line(i, nx, ny, d, width, mean, moments, angle):
                continue
            t = -ny * mean[i, 0] + nx * mean[i, 1]
            if t < low - gap or t > high + gap:
                continue
            members[near], places[near] = i, t
            near += 1
        if near == 0:
            return 0
        make_heap(heap, near, places)
        first, last, most = 0, 0, -1.0
        start, total, before = 0, 0.0, 0.0
        for k in range(near):
            o = pop_least(heap, near - k, places)
            order[k] = members[o]
            if k > 0 and places[o] - before > gap:
                start, total = k, 0.0
            before = places[o]
            total += moments[order[k], 0]
            if total > most:
                first, last, most = start, k, total
        n = last + 1 - first
        for k in range(n):
            members[k] = order[first + k]
        low = -ny * mean[members[0], 0] + nx * mean[members[0], 1]
        high = -ny * mean[members[n - 1], 0] + nx * mean[members[n - 1], 1]
        m0, x, y, xx, xy, yy = _moments_of(n, members, mean, moments)
        if m0 < min_hits or high - low + HIT_CELL < min_length:
            return 0
        if high - low > 2 * band or step == REFITS - 1:
            along = 0.5 * np.arctan2(2 * xy, xx - yy)
            ax, ay = -np.sin(along), np.cos(along)
            if ax * nx + ay * ny < 0:
                ax, ay = -ax, -ay
            if ax * nx + ay * ny > MIN_AGREEMENT:
                nx, ny = ax, ay
        d = nx * x + ny * y
        low, high = np.inf, -np.inf
        for k in range(n):
            t = -ny * mean[members[k], 0] + nx * mean[members[k], 1]
            low, high = min(low, t), max(high, t)
    line[0], line[1], line[2], line[3], line[4] = nx, ny, d, low, high
    return n
