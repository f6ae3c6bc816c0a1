"""March of rays through a table of cells: where each ray may stop, and with which probability.

Probability of a stop in cell k: w_k = S_k (1 - exp(-rate_k l_k)), where l_k is the chord [m].
Probability of reaching it: S_k = exp(-sum_{i<k} rate_i l_i). Rate of stops [1/m]: rate_k = -log(1 - p_k) / cell.
Range to its face n_k·p = d_k from the laser q in direction u: r_k = (d_k - n_k·q) / (n_k·u).
Variance of a reading about it: sigma² + across² tan²(angle of incidence), and rough² in a cell without a line.
Neighbouring cells that hardly stop the ray are one candidate, whose weight W = sum_k w_k stays below `MAX_MERGED`. Its
range is m = sum_k w_k c_k / W over the middles c_k; its variance is rough² + sum_k w_k (c_k - m)² / W.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.cells.evidence import MIN_RANGE, CellEvidence
from sensorgraph.models.cells.grid import (
    CellIndices,
    RowGrid,
    max_cells_met,
    per_ray,
    sector_of,
    traverse,
)
from sensorgraph.models.cells.local_lines import COS, NO_LINE, OFFSET_STEP, SIN, Codes, Offsets, local_lines
from sensorgraph.models.cells.visibility import logits
from sensorgraph.models.mixture import summarise
from sensorgraph.types import Floats

MIN_SINE = 0.17
"""Sine of the angle between ray and line below which the line does not determine the range."""
MIN_SURVIVAL = 1e-4
"""Survival probability below which a ray is not followed further."""
MAX_MERGED = 1e-3
"""Probability of a stop below which neighbouring cells are one candidate; in free space, some 0.5 m."""
RATES = np.concatenate([[0.0], np.geomspace(2e-3, 200.0, 127)])
"""[1/m] Rate of stops for each code, in steps of 10 %: none, and from one in 500 m to one in 5 mm."""
MAX_SERIES = 1e-3
"""Largest x at which three terms of the series of 1 - exp(-x) suffice; the relative error is below 1e-10."""


class CellTable(NamedTuple):
    """Lookup table of the march; row -1 of each array is an unobserved cell."""

    low: Floats
    """(2,) [m] corner of the window."""
    cell: float
    """[m] Side of a cell."""
    reach: float
    """[m] Range up to which rays are followed."""
    rows: RowGrid
    """(nx, ny) row of each cell."""
    rate: Codes
    """(n + 1, 16) code in `RATES` of the rate of stops."""
    angle: Codes
    """(n + 1, 16) code of the angle of the face's normal."""
    offset: Offsets
    """(n + 1, 16) [mm] offset of the face from the centre of the cell."""
    sigma: float
    """[m] Standard deviation of a range about a line at normal incidence, including the noise of poses."""
    across: float
    """[m] Standard deviation of the place of a line, which counts with the tangent of the angle of incidence."""
    rough: float
    """[m] Standard deviation of a range in a cell without a line."""
    is_seen: Codes
    """(n + 1,) 1 where a training ray crossed the cell, else 0."""


class RayWork(NamedTuple):
    """Memory of the march for one ray: cells that it crosses, and candidates at which it may stop, sorted by range."""

    at: CellIndices
    """(n_max, 2) indices of the crossed cells in the window."""
    ends: Floats
    """(n_max,) [m] distance at which the ray leaves each."""
    r: Floats
    """(n_max,) [m] range of a candidate; `w`: its probability, `sigma`: its standard deviation [m]."""
    w: Floats
    sigma: Floats
    unseen: Floats
    """(n_max,) [m] length of the ray up to there in cells that no training ray crossed."""


def new_work(table: CellTable, room: int = 1) -> RayWork:
    """Return memory for one ray, with `room` times as many candidates as cells."""
    n = max_cells_met(table.reach, table.cell)
    r, w, sigma = (np.empty(room * n) for _ in range(3))
    return RayWork(np.empty((n, 2), dtype=np.int64), np.empty(n), r, w, sigma, np.empty(n))


def tabulate(
    evidence: CellEvidence,
    beta: Floats | None,
    spread: tuple[float, float, float],
) -> CellTable:
    """Compute the lookup table from (widened) evidence and the coefficients of the visibility polynomial.

    `spread` holds sigma, across and rough [m]. Without beta, every cell stops a ray with the probability 0.2.
    """
    window = evidence.window
    angle, offset = local_lines(evidence)
    if beta is None:
        rate = np.full(angle.shape, -math.log1p(-0.2) / window.cell)
    else:
        rate = np.logaddexp(0.0, logits(evidence, beta)) / window.cell  # -log(1 - p) per cell side
    n = evidence.n_rows
    seen = np.zeros(n + 1, dtype=np.uint8)
    for counts in (evidence.hits, evidence.interpolated, evidence.passes):
        seen[:-1] |= counts[:n].any(axis=1)
    return CellTable(
        low=np.array(window.low) * window.cell, cell=window.cell, reach=evidence.reach, rows=window.index,
        rate=np.searchsorted(np.sqrt(RATES[1:-1] * RATES[2:]), rate).astype(np.uint8) + np.uint8(1),
        angle=angle, offset=offset, sigma=spread[0], across=spread[1], rough=spread[2], is_seen=seen,
    )  # fmt: skip


@inner_kernel
def face_range(
    x: float, y: float, c: float, s: float, i: int, j: int, middle: float, code: int, offset: int, cell: float
) -> tuple[float, float]:
    """Return the range at which a ray from (x, y) meets the face of cell (i, j), and the cosine of incidence.

    Where the line is unknown, the range is `middle` [m] or that of the hits, and the cosine is 0.
    """
    px, py = (i + 0.5) * cell - x, (j + 0.5) * cell - y  # from the start to the centre of the cell
    d = offset * OFFSET_STEP
    if code == NO_LINE:
        return (px * c + py * s + d if offset != 0 else middle), 0.0
    nx, ny = COS[code], SIN[code]
    den = nx * c + ny * s
    if abs(den) <= MIN_SINE:
        return middle, 0.0
    r = (nx * px + ny * py + d) / den
    return (r, abs(den)) if abs(r - middle) < 2.0 * cell else (middle, 0.0)


@inner_kernel
def width_of(cosine: float, sigma: float, across: float, rough: float) -> float:
    """Return the standard deviation [m] of a reading about a face met at a cosine of incidence; 0: no line."""
    if cosine <= 0.0:
        return rough
    return math.sqrt(sigma * sigma + across * across * (1.0 / (cosine * cosine) - 1.0))


@inner_kernel
def insert_candidate(
    at: float, weight: float, width: float, unknown: float, n: int, r: Floats, w: Floats, sigma: Floats,
    unseen: Floats,
) -> int:  # fmt: skip
    """Insert a candidate into n sorted ones; return their number."""
    m = n
    while m > 0 and r[m - 1] > at:
        r[m], w[m], sigma[m], unseen[m] = r[m - 1], w[m - 1], sigma[m - 1], unseen[m - 1]
        m -= 1
    r[m], w[m], sigma[m], unseen[m] = at, weight, width, unknown
    return n + 1


@inner_kernel
def insert_merged(
    total: float, first: float, second: float, rough: float, unknown: float, n: int, r: Floats, w: Floats,
    sigma: Floats, unseen: Floats,
) -> int:  # fmt: skip
    """Insert the candidate with the moments sum w, sum w c and sum w c² of several cells; return the number."""
    mean = first / total
    width = math.sqrt(rough * rough + max(second / total - mean * mean, 0.0))
    return insert_candidate(mean, total, width, unknown, n, r, w, sigma, unseen)


@inner_kernel
def row_of(i: int, j: int, table: CellTable) -> int:
    """Return the row of cell (i, j); -1 for one that no ray crossed, as all outside the window."""
    if 0 <= i < table.rows.shape[0] and 0 <= j < table.rows.shape[1]:
        return int(table.rows[i, j])
    return -1


@outer_kernel
def stop_candidates(
    x: float, y: float, c: float, s: float, table: CellTable, work: RayWork
) -> tuple[int, float]:
    """List the candidates in `work` at which a ray from (x, y) [m] in map in the direction (c, s) may stop.

    Returns
    -------
    number of candidates, probability that none stops the ray
    """
    at, ends, r, w, sigma, unseen = work
    x0, y0 = x - table.low[0], y - table.low[1]
    b = sector_of(c, s)
    n_steps = traverse(x0, y0, c, s, table.reach, table.cell, at, ends)
    n = 0
    survival, before, unobserved = 1.0, 0.0, 0.0
    merged, first, second = 0.0, 0.0, 0.0  # sums of w, w c and w c² of the cells to merge
    for k in range(n_steps):
        i, j = at[k]
        row = row_of(i, j, table)
        chord = ends[k] - before
        rate = RATES[table.rate[row, b]] if ends[k] > MIN_RANGE else 0.0  # shorter ranges are not used
        x = rate * chord
        chance = survival * (x * (1.0 - x * (0.5 - x / 6.0)) if x < MAX_SERIES else -math.expm1(-x))
        middle = 0.5 * (before + ends[k])
        survival -= chance
        is_small = chance < MAX_MERGED
        if merged > 0.0 and (not is_small or merged + chance >= MAX_MERGED):
            n = insert_merged(merged, first, second, table.rough, unobserved, n, r, w, sigma, unseen)
            merged, first, second = 0.0, 0.0, 0.0
        if is_small:
            merged, first, second = (
                merged + chance,
                first + chance * middle,
                second + chance * middle * middle,
            )
        else:
            at_r, cosine = face_range(
                x0, y0, c, s, i, j, middle, table.angle[row, b], table.offset[row, b], table.cell
            )
            width = width_of(cosine, table.sigma, table.across, table.rough)
            n = insert_candidate(max(at_r, 0.0), chance, width, unobserved, n, r, w, sigma, unseen)
        before = ends[k]
        if table.is_seen[row] == 0:
            unobserved += chord
        if survival < MIN_SURVIVAL:
            break
    if merged > 0.0:
        n = insert_merged(merged, first, second, table.rough, unobserved, n, r, w, sigma, unseen)
    return n, survival


@inner_kernel
def candidates_of(
    p: int, q: int, poses: Floats, bearings: Floats, table: CellTable, work: RayWork
) -> tuple[int, float]:
    """Compute `stop_candidates` of ray q from pose p; poses (n_poses, n_rays or 1, 3) are those of the laser."""
    pose = poses[p, min(q, poses.shape[1] - 1)]
    angle = pose[2] + bearings[q]
    return stop_candidates(pose[0], pose[1], math.cos(angle), math.sin(angle), table, work)


@outer_kernel
def summarise_rays(
    poses: Floats, bearings: Floats, table: CellTable, which: int, work: RayWork, out: Floats, near: Floats,
    unobserved: Floats,
) -> None:  # fmt: skip
    """Summarise every ray; poses (n_poses, n_rays or 1, 3) are those of the laser.

    Fills out (n_poses, n_rays, 6) as `mixture.summarise`. Fills `near` (n_poses, n_rays) with the probability that a
    return is within 2 `OFF_DISTANCE` of the median, and `unobserved` (n_poses, n_rays) with the length [m] in
    unobserved cells before the mode.
    """
    _, _, r, w, sigma, unseen = work
    for p in range(len(poses)):
        for q in range(len(bearings)):
            n, survival = candidates_of(p, q, poses, bearings, table, work)
            summary = summarise(r, w, sigma, n, survival, table.reach, which)
            for k in range(6):
                out[p, q, k] = summary[k]
            inside, total, length = 0.0, 0.0, 0.0
            for k in range(n):
                total += w[k]
                if abs(r[k] - summary[0]) <= 2.0 * OFF_DISTANCE:
                    inside += w[k]
                if r[k] <= summary[1]:
                    length = unseen[k]
            near[p, q] = inside / total if total > 0.0 else 0.0
            unobserved[p, q] = length


@outer_kernel
def fill_candidates(
    poses: Floats, bearings: Floats, table: CellTable, work: RayWork, r: Floats, w: Floats, sigma: Floats,
    survival: Floats,
) -> int:  # fmt: skip
    """Fill r, w, sigma (n_poses, n_rays, n_max) and survival (n_poses, n_rays); return the largest number of candidates."""
    most = 0
    for p in range(len(poses)):
        for q in range(len(bearings)):
            own = RayWork(work.at, work.ends, r[p, q], w[p, q], sigma[p, q], work.unseen)
            n, survival[p, q] = candidates_of(p, q, poses, bearings, table, own)
            r[p, q, n:], w[p, q, n:], sigma[p, q, n:] = math.inf, 0.0, table.rough
            most = max(most, n)
    return most


def list_candidates(
    table: CellTable, poses: Floats, bearings: Floats, *, room: int = 1
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the candidates of every ray: r, w, sigma (n_poses, n_rays, n_most) and survival (n_poses, n_rays).

    Candidates are sorted by range. Unused entries have r = inf and w = 0; n_most is `room` times the largest number of
    candidates. The arrays are large, so pass few poses at a time.
    """
    shape = (len(poses), len(bearings))
    size = room * max_cells_met(table.reach, table.cell)
    r, w, sigma = (np.empty((*shape, size)) for _ in range(3))
    survival = np.empty(shape)
    n = room * fill_candidates(per_ray(poses), bearings, table, new_work(table), r, w, sigma, survival)
    return r[..., :n].copy(), w[..., :n].copy(), sigma[..., :n].copy(), survival
