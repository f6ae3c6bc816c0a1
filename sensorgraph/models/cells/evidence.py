"""Evidence of a log in cells: hits, passes and interpolated hits by direction, and moments of the hits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel, kernel
from sensorgraph.models.cells.grid import (
    N_SECTORS,
    CellIndices,
    GridWindow,
    RowGrid,
    max_cells_met,
    per_ray,
    sector_of,
    traverse,
)
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.types import Floats

Counts = NDArray[np.float32]
T = TypeVar("T", bound=np.generic)

CELL_SIZE, MAX_REACH, MIN_RANGE = CELLS.cell_size, CELLS.max_reach, CELLS.min_range
SURFACE_STEP, SURFACE_SLOPE, MAX_SURFACE_STEP = 0.10, 4.0, 0.6
"""Distance between end points of neighbouring rays below which they met one surface: [m] at any range, in widths of the gap
between the rays (for surfaces at grazing incidence), and [m] at most."""
FREE_MARGIN, SURFACE_MARGIN_CELLS = 0.15, 1.5
"""The gap between rays is free up to this distance before the shorter ray's end [m], and before one surface [cells]."""
N_MOMENTS = 6  # count, x, y, xx, xy, yy of hits, [m] relative to the centre of their cell


@dataclass(frozen=True, kw_only=True, eq=False)
class CellEvidence:
    """Sums over scans, with a row for each cell that a ray crossed."""

    window: GridWindow
    reach: float
    """[m] Range up to which rays are counted."""
    n_rows: int
    """Number of cells; the arrays may be longer."""
    hits: Counts
    """(n, 16) hits by sector of the ray."""
    interpolated: Counts
    """(n, 16) interpolated hits between neighbouring rays that met one surface."""
    passes: Counts
    """(n, 8) passes in units of the cell side, by sector modulo 8."""
    face: RowGrid
    """(n,) row in `moments`; -1 for cells without hits."""
    n_faces: int
    moments: Floats
    """(n_faces, 16, 6) count, x, y, xx, xy, yy [m] of the hits relative to the centre of their cell."""

    @classmethod
    def of(
        cls, poses: Floats, ranges: Floats, bearings: Floats, *, cell: float = CELL_SIZE,
        reach: float = MAX_REACH,
    ) -> CellEvidence:  # fmt: skip
        """Return the evidence of scans with ranges (n, n_rays) [m] at bearings (n_rays,) [rad].

        Parameters
        ----------
        poses : (n, 3) [m, m, rad] Poses of the laser in map; (n, n_rays, 3) for a sweep, one for each ray.
        """
        poses = per_ray(poses)
        window = GridWindow.around(poses[..., :2].reshape(-1, 2), reach, cell)
        gaps = np.append(np.diff(bearings), 0.0)
        between = np.maximum(
            np.round(gaps / CELLS.max_ray_spacing).astype(np.int64) - 1, 0
        )  # number of virtual rays after each ray
        room = (len(bearings) + int(between.sum())) * max_cells_met(reach, cell)
        hits, interpolated = (np.zeros((0, N_SECTORS), dtype=np.float32) for _ in range(2))
        passes, face = np.zeros((0, N_SECTORS // 2), dtype=np.float32), np.full(0, -1, dtype=np.int32)
        moments = np.zeros((0, N_SECTORS, N_MOMENTS))
        done, n_rows, n_faces = 0, 0, 0
        while done < len(poses):
            if n_rows + room > len(hits):
                n = max(n_rows + room, 2 * len(hits))
                hits, interpolated, passes = (_lengthened(part, n) for part in (hits, interpolated, passes))
                face = _lengthened(face, n, -1)
            if n_faces + len(bearings) > len(moments):
                moments = _lengthened(moments, max(n_faces + len(bearings), 2 * len(moments)))
            done, n_rows, n_faces = add_scans(
                done, poses, ranges, bearings, between, reach, cell, np.array(window.low), window.index,
                n_rows, n_faces, hits, interpolated, passes, face, moments,
            )  # fmt: skip
        return cls(
            window=window, reach=reach, n_rows=n_rows, hits=hits, interpolated=interpolated, passes=passes,
            face=face, n_faces=n_faces, moments=moments,
        )  # fmt: skip

    def widened(self, cells: int = 2) -> CellEvidence:
        """Return the evidence with additional rows for all cells within `cells` of a crossed one, in grid order."""
        seen = self.window.index >= 0
        near = seen.copy()
        for _ in range(cells):
            for axis in (0, 1):
                near |= np.roll(near, 1, axis) | np.roll(near, -1, axis)
        n = int(near.sum())
        index = np.full(near.shape, -1, dtype=np.int32)
        index[near] = np.arange(n, dtype=np.int32)
        old, rows = self.window.index[seen], index[seen]
        return CellEvidence(
            window=GridWindow(cell=self.window.cell, low=self.window.low, index=index), reach=self.reach,
            n_rows=n, hits=_rearranged(self.hits[old], rows, n),
            interpolated=_rearranged(self.interpolated[old], rows, n),
            passes=_rearranged(self.passes[old], rows, n), face=_rearranged(self.face[old], rows, n, -1),
            n_faces=self.n_faces, moments=self.moments,
        )  # fmt: skip


def _lengthened(array: NDArray[T], n: int, fill: int = 0) -> NDArray[T]:
    return _rearranged(array, np.arange(len(array)), n, fill)


def _rearranged(array: NDArray[T], rows: NDArray[np.integer], n: int, fill: int = 0) -> NDArray[T]:
    """Copy the rows of an array to given rows of a new array with n rows."""
    longer = np.zeros((n, *array.shape[1:]), dtype=array.dtype)
    if fill:
        longer[:] = fill
    longer[rows] = array
    return longer


@inner_kernel
def row_of(i: int, j: int, index: RowGrid, n_rows: int) -> int:
    """Return the row of a cell; a new cell is assigned the next free row."""
    if index[i, j] < 0:
        index[i, j] = n_rows
    return int(index[i, j])


@kernel
def add_scans(
    start: int, poses: Floats, ranges: Floats, bearings: Floats, between: CellIndices, reach: float, cell: float,
    low: CellIndices, index: RowGrid, n_rows: int, n_faces: int,
    hits: Counts, interpolated: Counts, passes: Counts, face: RowGrid, moments: Floats,
) -> tuple[int, int, int]:  # fmt: skip
    """Add scans from index `start` until the arrays may overflow; return the next scan and the row counts."""
    n_rays = len(bearings)
    at = np.empty((max_cells_met(reach, cell), 2), dtype=np.int64)
    ends = np.empty(len(at))
    room = (n_rays + between.sum()) * len(at)
    for scan in range(start, len(poses)):
        if n_rows + room > len(hits) or n_faces + n_rays > len(moments):
            return scan, n_rows, n_faces
        for ray in range(n_rays):
            r = ranges[scan, ray]
            if not r > MIN_RANGE:  # too close, or a broken reading
                continue
            pose = poses[scan, min(ray, poses.shape[1] - 1)]
            x, y = pose[0] - low[0] * cell, pose[1] - low[1] * cell
            angle = pose[2] + bearings[ray]
            c, s = math.cos(angle), math.sin(angle)
            b = sector_of(c, s)
            free = r - cell if r < reach else reach
            n_rows = pass_through(x, y, c, s, b, free, 1.0, cell, index, n_rows, passes, at, ends)
            if r < reach:
                px, py = x + r * c, y + r * s
                i, j = math.floor(px / cell), math.floor(py / cell)
                row = row_of(i, j, index, n_rows)
                n_rows = max(n_rows, row + 1)
                hits[row, b] += 1.0
                if face[row] < 0:
                    face[row] = n_faces
                    n_faces += 1
                add_moments(moments[face[row], b], px - (i + 0.5) * cell, py - (j + 0.5) * cell, 1.0)
            if between[ray] > 0 and ray + 1 < n_rays and ranges[scan, ray + 1] > MIN_RANGE:
                n_rows = fill_gap(
                    x, y, angle, bearings[ray + 1] - bearings[ray], r, ranges[scan, ray + 1], between[ray],
                    reach, cell, index, n_rows, interpolated, passes, at, ends,
                )  # fmt: skip
    return len(poses), n_rows, n_faces


@inner_kernel
def add_moments(moments: Floats, x: float, y: float, weight: float) -> None:
    """Add a hit at (x, y) [m], relative to the centre of its cell, to moments (6,)."""
    moments[0] += weight
    moments[1] += weight * x
    moments[2] += weight * y
    moments[3] += weight * x * x
    moments[4] += weight * x * y
    moments[5] += weight * y * y


@inner_kernel
def pass_through(
    x: float, y: float, c: float, s: float, b: int, free: float, weight: float, cell: float,
    index: RowGrid, n_rows: int, passes: Counts, at: CellIndices, ends: Floats,
) -> int:  # fmt: skip
    """Count a pass in every cell of a ray up to `free` [m]; return the number of rows in use."""
    n = traverse(x, y, c, s, free, cell, at, ends)
    before = 0.0
    for k in range(n):
        row = row_of(at[k, 0], at[k, 1], index, n_rows)
        n_rows = max(n_rows, row + 1)
        passes[row, b % (N_SECTORS // 2)] += weight * (ends[k] - before) / cell
        before = ends[k]
    return n_rows


@inner_kernel
def fill_gap(
    x: float, y: float, angle: float, gap: float, r: float, q: float, n_between: int, reach: float, cell: float,
    index: RowGrid, n_rows: int, interpolated: Counts, passes: Counts, at: CellIndices, ends: Floats,
) -> int:  # fmt: skip
    """Add virtual rays between two neighbours with ranges r and q [m] that are `gap` [rad] apart.

    If the neighbours met one surface, virtual rays end on the chord between the two end points. Otherwise only the
    space that both rays crossed is free. Range to the chord at the fraction f of the gap:
    (z = r q sin(gap) / (r sin(f gap) + q sin((1 - f) gap))).
    """
    weight = 1.0 / (n_between + 1)
    apart = math.sqrt(r * r + q * q - 2.0 * r * q * math.cos(gap)) if r < reach and q < reach else math.inf
    one_surface = apart < max(SURFACE_STEP, SURFACE_SLOPE * min(r, q) * gap) and apart < MAX_SURFACE_STEP
    for k in range(n_between):
        f = (k + 1) * weight
        theta = angle + f * gap
        c, s = math.cos(theta), math.sin(theta)
        b = sector_of(c, s)
        free = min(r, q, reach) - FREE_MARGIN
        if one_surface:
            z = r * q * math.sin(gap) / (r * math.sin(f * gap) + q * math.sin((1.0 - f) * gap))
            row = row_of(math.floor((x + z * c) / cell), math.floor((y + z * s) / cell), index, n_rows)
            n_rows = max(n_rows, row + 1)
            interpolated[row, b] += weight
            free = z - SURFACE_MARGIN_CELLS * cell
        n_rows = pass_through(x, y, c, s, b, free, weight, cell, index, n_rows, passes, at, ends)
    return n_rows
