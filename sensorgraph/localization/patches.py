"""Cut surfaces into short straight patches, and assign points to them.

The middles m_p of the patches are means of points in cells of a side s, moved onto the line n_p · (x - c_p) = 0 that is fitted to
the points within s (`line_map`): m_p -= n_p n_p · (m_p - c_p). Of middles closer than 0.6 s one is kept. A point x belongs to the
nearest patch with |x - m_p| < s and |n_p · (x - m_p)| below a gate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.kernel import outer_kernel
from sensorgraph.localization.line_map import (
    FACING,
    SAME_SIDE,
    Table,
    bucket_key,
    find_slot,
    fit_line,
    is_same_side,
    line_map,
    thinned,
)
from sensorgraph.types import Bools, Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """Middles and normals of patches."""

    middles: Floats
    """(n, 2) [m] in map."""
    normals: Floats
    """(n, 2) Unit normals of the lines, with arbitrary sign."""
    towards: Floats
    """(n, 2) Unit normals towards the side from which the patch was observed; 0, 0 where unknown."""
    side: float
    """[m] Distance between neighbours."""


def cut_patches(points: Floats, normals: Floats, side: float, roundness: float) -> Patches:
    """Cut surfaces into patches about `side` [m] apart.

    Parameters
    ----------
    points, normals : (n, 2) All returns in map.
    roundness : Ratio of the variances across and along above which points form no patch.
    """
    fine = line_map(*thinned(points, normals), side=max(side, 0.1))
    sure = (normals**2).sum(axis=1) > 0.25
    middles, towards = thinned(points[sure], normals[sure], side)
    lines = np.zeros((len(middles), 4))
    _fit_lines(
        np.ascontiguousarray(middles), np.ascontiguousarray(towards), side, roundness, fine.table, lines
    )
    good = lines[:, 2] ** 2 + lines[:, 3] ** 2 > 0
    middles, towards, directions = lines[good, :2], towards[good], lines[good, 2:]
    rough = line_map(middles, towards, side=side)
    kept = np.zeros(len(middles), dtype=np.bool_)
    _suppress(rough.table, 0.6 * side, kept)
    order = rough.order[kept]  # `kept` is in bucket order
    return Patches(middles=middles[order], normals=directions[order], towards=towards[order], side=side)


@outer_kernel
def _fit_lines(
    middles: Floats, towards: Floats, radius: float, roundness: float, table: Table, lines: Floats
) -> None:
    """Fit a line around each middle (n, 2); (n, 4): its point next to the middle and its normal, zeros without a line."""
    for k in range(len(middles)):
        w, cx, cy, nx, ny, across, along = fit_line(
            middles[k, 0], middles[k, 1], towards[k, 0], towards[k, 1], radius, table
        )
        if w > 1.0 and across < roundness * along:
            off = nx * (middles[k, 0] - cx) + ny * (middles[k, 1] - cy)
            lines[k, 0], lines[k, 1] = middles[k, 0] - off * nx, middles[k, 1] - off * ny
            lines[k, 2], lines[k, 3] = nx, ny


@outer_kernel
def _suppress(table: Table, apart: float, kept: Bools) -> None:
    """Keep each point without a kept point of the same side within `apart` [m]."""
    side, _, keys, first, counts, points, normals = table
    for slot in range(len(keys)):
        for k in range(first[slot], first[slot] + counts[slot]):
            bx, by = int(np.floor(points[k, 0] / side)), int(np.floor(points[k, 1] / side))
            is_free = True
            for ix in range(bx - 1, bx + 2):
                for iy in range(by - 1, by + 2):
                    other = find_slot(keys, bucket_key(ix, iy))
                    for j in range(first[other], first[other] + counts[other]):
                        if not kept[j]:
                            continue
                        dx, dy = points[j, 0] - points[k, 0], points[j, 1] - points[k, 1]
                        if dx * dx + dy * dy < apart * apart and is_same_side(
                            normals[k, 0], normals[k, 1], normals[j, 0], normals[j, 1], 0.5, FACING
                        ):
                            is_free = False
            kept[k] = is_free


def assign(points: Floats, normals: Floats, patches: Patches, gate: float) -> Ints:
    """Return the patch (n,) of each point (n, 2): the nearest with its line within `gate` [m], or -1."""
    nearest = np.full(len(points), -1, dtype=np.intp)
    if len(patches.middles) == 0:
        return nearest
    buckets = line_map(patches.middles, patches.towards, side=patches.side)
    _assign(
        np.ascontiguousarray(points),
        np.ascontiguousarray(normals),
        gate,
        buckets.table,
        patches.normals[buckets.order],
        nearest,
    )
    return np.where(nearest >= 0, buckets.order[nearest], -1)


@outer_kernel
def _assign(points: Floats, normals: Floats, gate: float, table: Table, lines: Floats, nearest: Ints) -> None:
    side, _, keys, first, counts, middles, towards = table
    for k in range(len(points)):
        x, y, nx, ny = points[k, 0], points[k, 1], normals[k, 0], normals[k, 1]
        bx, by = int(np.floor(x / side)), int(np.floor(y / side))
        least = side * side
        for ix in range(bx - 1, bx + 2):
            for iy in range(by - 1, by + 2):
                slot = find_slot(keys, bucket_key(ix, iy))
                for j in range(first[slot], first[slot] + counts[slot]):
                    dx, dy = x - middles[j, 0], y - middles[j, 1]
                    if abs(lines[j, 0] * dx + lines[j, 1] * dy) > gate or dx * dx + dy * dy >= least:
                        continue
                    if not is_same_side(nx, ny, towards[j, 0], towards[j, 1], SAME_SIDE, FACING):
                        continue
                    least = dx * dx + dy * dy
                    nearest[k] = j
