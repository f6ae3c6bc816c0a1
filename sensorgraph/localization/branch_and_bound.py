"""Find the best pose of a scan in a likelihood field, and its rivals, without an initial pose.

The search maximises, over x, y and heading in a window,

    score = mean_k field(pose ∘ points_k)

by branch and bound (Olson 2009; Hess, Kohler, Rapp and Andor 2016). A pyramid of maxima over 2^h by 2^h cells
bounds the score of as many positions at once. Nodes leave a queue in the order of their bounds. The first
position to leave it is the best one; the next outside its neighbourhood is its first rival.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel, kernel
from sensorgraph.localization.likelihood_field import PEAK, LikelihoodField
from sensorgraph.types import Floats

MAX_LEVELS = 8
"""Maximum number of pyramid levels above the field; the coarsest bounds 256 by 256 cells."""
FIRST_NODES = 1 << 14
"""Initial capacity of the queue; it doubles when full."""
_Cells = NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class SearchWindow:
    """Window of the search: all cells and headings within half sides around a centre."""

    x: float = 0.0
    """[m] centre"""
    y: float = 0.0
    """[m] centre"""
    phi: float = 0.0
    """[rad] centre"""
    half_x: float
    """[m]"""
    half_y: float
    """[m]"""
    half_phi: float = np.pi
    """[rad] π or more: all headings; the first and the last are then neighbours."""

    @classmethod
    def around(cls, pose: Floats, *, half_xy: float, half_phi: float) -> SearchWindow:
        """Return the window with sides of 2 `half_xy` [m] and 2 `half_phi` [rad] around a pose (3,)."""
        x, y, phi = (float(value) for value in pose)
        return cls(x=x, y=y, phi=phi, half_x=half_xy, half_y=half_xy, half_phi=half_phi)


@dataclass(frozen=True, kw_only=True, eq=False)
class Modes:
    """Poses at which a scan fits, the best first."""

    poses: Floats
    """(n, 3) [m, m, rad] Poses, phi in (-π, π]."""
    scores: Floats
    """(n,) Mean of the field at the points, 0 to 1, in non-increasing order."""

    @property
    def rivalry(self) -> float:
        """Score of the second pose relative to the first; 0 without a second."""
        return float(self.scores[1] / self.scores[0]) if len(self.scores) > 1 else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class MaxPyramid:
    """A likelihood field prepared for any number of searches."""

    field: LikelihoodField

    @cached_property
    def levels(self) -> NDArray[np.uint8]:
        """(n_levels + 1, ny + pad, nx + pad) Maximum of the 2^h by 2^h cells right of and above each cell.

        Cell (0, 0) of the field is at [pad, pad], pad = 2^n_levels, so that each block that overlaps the
        field is included.
        """
        values = self.field.values
        n_levels = min(MAX_LEVELS, max(int(np.ceil(np.log2(max(values.shape)))), 1))
        pad = 1 << n_levels
        levels = np.zeros((n_levels + 1, values.shape[0] + pad, values.shape[1] + pad), dtype=np.uint8)
        levels[0, pad:, pad:] = values
        for h in range(n_levels):
            step, below, above = 1 << h, levels[h], levels[h + 1]
            above[:] = below
            np.maximum(above[:, :-step], below[:, step:], out=above[:, :-step])
            wide = above.copy()
            np.maximum(above[:-step], wide[step:], out=above[:-step])
        return levels

    def search(
        self,
        points: Floats,
        window: SearchWindow,
        *,
        heading_step: float = float(np.radians(0.5)),
        min_score: float = 0.3,
        max_modes: int = 8,
        rival_ratio: float = 0.9,
        apart: tuple[float, float] = (0.5, float(np.radians(10.0))),
    ) -> Modes:
        """Return the best pose of points in a window, and its rivals.

        A rival is the best remaining pose outside a box of ±`apart` around each pose returned before it.

        Parameters
        ----------
        points : (n, 2) [m] Returns of one or several scans, in the frame whose pose is sought.
        heading_step : [rad] Step between headings.
        min_score : Minimum score of a pose.
        rival_ratio : Minimum score of a rival relative to the best.
        apart : [m] along x or y, [rad]: a rival differs by more in at least one of the three.

        Returns
        -------
        Modes; empty if no pose reaches `min_score`.

        Raises
        ------
        ValueError : There is no point.
        """
        if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
            raise ValueError(f"points has shape {points.shape}, expected (n, 2), n > 0")
        resolution = self.field.resolution
        turns, is_full_turn = _turns(window.half_phi, heading_step)
        headings = window.phi + turns
        cells = _cells(points, headings, window, self.field)
        half = np.array([window.half_x, window.half_y]) / resolution
        reach = np.floor(half + 1e-9).astype(np.int32)  # 0.4 m is eight cells of 0.05 m
        box = np.array(
            [*np.floor(np.array([apart[0], apart[0]]) / resolution + 1e-9), int(apart[1] / heading_step)]
        )
        box = box.astype(np.int32)
        found = np.zeros((max_modes, 4), dtype=np.int32)
        lowest = max(int(np.ceil(min_score * PEAK * len(points))), 1)
        n = _best_first(self.levels, cells, reach, box, is_full_turn, lowest, float(rival_ratio), found)
        sums, turn, offsets = found[:n, 0], found[:n, 1], found[:n, 2:]
        poses = np.column_stack([np.array([window.x, window.y]) + resolution * offsets, headings[turn]])
        poses[:, 2] = np.pi - (np.pi - poses[:, 2]) % (2 * np.pi)
        return Modes(poses=poses, scores=sums / (PEAK * len(points)))


def _turns(half: float, step: float) -> tuple[Floats, bool]:
    """Return the turns (n,) [rad] from the centre, and whether they cover a full turn."""
    if half >= np.pi:
        n = int(np.ceil(2 * np.pi / step))
        return np.arange(-(n // 2), n - n // 2, dtype=np.float64) * (2 * np.pi / n), True
    n = int(half / step + 1e-9)
    return np.arange(-n, n + 1, dtype=np.float64) * step, False


def _cells(points: Floats, headings: Floats, window: SearchWindow, field: LikelihoodField) -> _Cells:
    """Return the cells (n_headings, n_points, 2), x and y, of the points at the centre of the window."""
    cos, sin = np.cos(headings)[:, None], np.sin(headings)[:, None]
    x = window.x + cos * points[:, 0] - sin * points[:, 1]
    y = window.y + sin * points[:, 0] + cos * points[:, 1]
    return np.floor((np.stack([x, y], axis=-1) - field.origin) / field.resolution).astype(np.int32)


@kernel
def _best_first(
    levels: NDArray[np.uint8],
    cells: _Cells,
    reach: _Cells,
    box: _Cells,
    is_full_turn: bool,
    lowest: int,
    ratio: float,
    found: _Cells,
) -> int:
    """Fill `found` (max_modes, 4) with sum, heading and offset of each pose, the best first; return their number.

    Sums are integers, and the sum of a child is at most that of its parent. So the queue is one stack of
    nodes per sum, emptied from the largest sum down.
    """
    top = 0
    while top + 1 < levels.shape[0] and (1 << (top + 1)) <= 2 * max(reach[0], reach[1]) + 1:
        top += 1
    n_headings = cells.shape[0]
    greatest = 255 * cells.shape[1]
    stacks = np.full(greatest + 1, -1, dtype=np.int32)  # top node of each sum
    nodes = np.empty((FIRST_NODES, 5), dtype=np.int32)  # next, level, heading, dx, dy
    used, free, n_found = 0, -1, 0
    side = 1 << top
    for heading in range(n_headings):
        for dy in range(-reach[1], reach[1] + 1, side):
            for dx in range(-reach[0], reach[0] + 1, side):
                total = _bound(levels, cells, top, heading, dx, dy, lowest)
                if total >= lowest:
                    nodes = _with_room(nodes, used)
                    _fill(nodes, used, stacks[total], top, heading, dx, dy)
                    stacks[total] = used
                    used += 1
    now = greatest
    while now >= lowest and n_found < found.shape[0]:
        node = stacks[now]
        if node < 0:
            now -= 1
            continue
        stacks[now] = nodes[node, 0]
        level, heading, dx, dy = nodes[node, 1], nodes[node, 2], nodes[node, 3], nodes[node, 4]
        nodes[node, 0], free = free, node
        if _is_near_found(found, n_found, box, n_headings, is_full_turn, level, heading, dx, dy):
            continue
        if level == 0:
            _record(found, n_found, now, heading, dx, dy)
            n_found += 1
            lowest = max(lowest, int(np.ceil(ratio * found[0, 0])))
            continue
        half = 1 << (level - 1)
        bounds = _bounds_of_children(levels, cells, level - 1, heading, dx, dy, lowest)
        for child in range(4):
            x, y, total = dx + half * (child & 1), dy + half * (child >> 1), bounds[child]
            if total < lowest or x > reach[0] or y > reach[1]:
                continue
            if level == 1:  # the best pose is at least as good as this one
                lowest = max(lowest, int(np.ceil(ratio * total)))
            if free >= 0:
                node, free = free, nodes[free, 0]
            else:
                nodes = _with_room(nodes, used)
                node = used
                used += 1
            _fill(nodes, node, stacks[total], level - 1, heading, x, y)
            stacks[total] = node
    return n_found


@inner_kernel
def _bound(
    levels: NDArray[np.uint8], cells: _Cells, level: int, heading: int, dx: int, dy: int, lowest: int
) -> int:
    """Return an upper bound of the sum over the cells of a node at (dx, dy); 0 if it is below `lowest`."""
    pad = 1 << (levels.shape[0] - 1)
    ny, nx = levels.shape[1], levels.shape[2]
    total = 0
    n = cells.shape[1]
    for k in range(n):
        x, y = cells[heading, k, 0] + dx + pad, cells[heading, k, 1] + dy + pad
        if 0 <= x < nx and 0 <= y < ny:
            total += levels[level, y, x]
        if total + 255 * (n - 1 - k) < lowest:
            return 0
    return total


@inner_kernel
def _bounds_of_children(
    levels: NDArray[np.uint8], cells: _Cells, level: int, heading: int, dx: int, dy: int, lowest: int
) -> tuple[int, int, int, int]:
    """Return `_bound` of the four children, at a level, of a node at (dx, dy): at the node, right of it, above, and both."""
    pad = 1 << (levels.shape[0] - 1)
    ny, nx = levels.shape[1], levels.shape[2]
    half = 1 << level
    a, b, c, d = 0, 0, 0, 0
    n = cells.shape[1]
    for k in range(n):
        x, y = cells[heading, k, 0] + dx + pad, cells[heading, k, 1] + dy + pad
        if x >= 0 and y >= 0 and x + half < nx and y + half < ny:
            a += levels[level, y, x]
            b += levels[level, y, x + half]
            c += levels[level, y + half, x]
            d += levels[level, y + half, x + half]
        elif x + half >= 0 and y + half >= 0 and x < nx and y < ny:
            is_right, is_above = x + half < nx, y + half < ny
            if x >= 0 and y >= 0:
                a += levels[level, y, x]
            if y >= 0 and is_right:
                b += levels[level, y, x + half]
            if x >= 0 and is_above:
                c += levels[level, y + half, x]
            if is_right and is_above:
                d += levels[level, y + half, x + half]
        if max(max(a, b), max(c, d)) + 255 * (n - 1 - k) < lowest:
            return 0, 0, 0, 0
    return a, b, c, d


@inner_kernel
def _is_near_found(
    found: _Cells,
    n_found: int,
    box: _Cells,
    n_headings: int,
    is_full_turn: bool,
    level: int,
    heading: int,
    dx: int,
    dy: int,
) -> bool:
    """Tell whether all positions of a node lie within the box around a pose already found."""
    last = (1 << level) - 1
    for i in range(n_found):
        turn = abs(heading - found[i, 1])
        if is_full_turn:
            turn = min(turn, n_headings - turn)
        x, y = dx - found[i, 2], dy - found[i, 3]
        if turn <= box[2] and -box[0] <= x and x + last <= box[0] and -box[1] <= y and y + last <= box[1]:
            return True
    return False


@inner_kernel
def _fill(nodes: _Cells, at: int, following: int, level: int, heading: int, dx: int, dy: int) -> None:
    nodes[at, 0], nodes[at, 1], nodes[at, 2], nodes[at, 3], nodes[at, 4] = following, level, heading, dx, dy


@inner_kernel
def _record(found: _Cells, at: int, total: int, heading: int, dx: int, dy: int) -> None:
    found[at, 0], found[at, 1], found[at, 2], found[at, 3] = total, heading, dx, dy


@kernel
def _with_room(nodes: _Cells, used: int) -> _Cells:
    """Return the nodes, copied to twice the capacity if all are used."""
    if used < nodes.shape[0]:
        return nodes
    more = np.empty((2 * nodes.shape[0], nodes.shape[1]), dtype=np.int32)
    for node in range(nodes.shape[0]):  # more[:n] = nodes would compile an error message for 3 s
        for k in range(nodes.shape[1]):
            more[node, k] = nodes[node, k]
    return more
