"""Reachable places of a disc: a distance field on a fine raster, and its part that is connected to the start."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from planners.arena import Arena
from planners.clearance import Barriers
from planners.errors import PlanError
from planners.joins.ompl_process import JOIN_PLANNERS
from planners.types import ROUND_OFF, Bools, Floats, Ints

NODE_STEP = 0.02
"""[m] Upper bound of the node spacing; reduced so that a cell is a whole number of steps."""
MAX_NODES = 6_000_000
"""Maximum number of raster nodes; a larger floor gets a larger step."""
MAX_CELLS = 1_000_000
"""Maximum number of grid cells; larger grids are rejected."""
DISTANCE_CAP = 0.45
"""[m] beyond the clearance, at which distances to walls are capped."""
MIN_SHARE = 0.04
"""Minimum reachable share of a cell's area for the cell to count as reachable."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reach:
    """Possible places of the robot's centre, on a raster with `per_cell`² nodes in each position cell."""

    origin: Floats
    """(2,) [m] lower left corner of the grid of cells."""
    cell: float
    """[m] side of a position cell."""
    per_cell: int
    """Number of nodes along a cell's side."""
    clearance: float
    """[m] required distance of the robot's centre from barriers."""
    distance: Floats
    """(mx, my) [m] exact distance of each node to the nearest barrier, capped; 0 outside free space."""
    mask: Bools
    """(mx, my) whether each node is reachable."""
    fits: int
    """Number of nodes where the robot fits, reachable or not."""
    join_planner: str = JOIN_PLANNERS[0]
    """OMPL planner of paths on this floor: one of JOIN_PLANNERS, or module:Class."""

    @property
    def step(self) -> float:
        """[m] between nodes."""
        return self.cell / self.per_cell

    @property
    def shape(self) -> tuple[int, int]:
        """Number of position cells (nx, ny)."""
        return self.mask.shape[0] // self.per_cell, self.mask.shape[1] // self.per_cell

    @property
    def share(self) -> float:
        """Reachable share of the places where the robot fits."""
        return float(self.mask.sum() / self.fits)

    def nodes(self, index: tuple[np.ndarray, ...]) -> Floats:
        """Return the positions (n, 2) [m] of nodes given as index arrays (i, j)."""
        return self.origin + (np.stack(index, axis=-1) + 0.5) * self.step

    def nearest(self, place: ArrayLike) -> Ints | None:
        """Return the index (2,) of the reachable node nearest to a place (2,) [m], among those around it, or None."""
        place = np.asarray(place, dtype=np.float64)
        at = np.floor((place - self.origin) / self.step).astype(np.intp)
        low = np.maximum(at - 2, 0)
        around = np.argwhere(self.mask[low[0] : at[0] + 3, low[1] : at[1] + 3]) + low
        if not len(around):
            return None
        away = np.hypot(*(self.nodes(tuple(around.T)) - place).T)
        return np.asarray(around[away.argmin()])

    def blocks(self, raster: np.ndarray) -> np.ndarray:
        """Reshape a raster (mx, my) to (nx, ny, per_cell²), one row per cell."""
        (nx, ny), k = self.shape, self.per_cell
        return raster.reshape(nx, k, ny, k).swapaxes(1, 2).reshape(nx, ny, k * k)

    def deepest(self, cells: NDArray[np.int64]) -> Floats:
        """Return the reachable place (n, 2) [m] farthest from walls in each cell (n, 2)."""
        within = tuple(cells.T)
        depth = np.where(self.blocks(self.mask)[within], self.blocks(self.distance)[within], 0.0)
        node = depth.argmax(axis=1)
        inside = np.column_stack([node // self.per_cell, node % self.per_cell])
        return np.asarray(self.origin + cells * self.cell + (inside + 0.5) * self.step)

    def areas(self) -> Floats:
        """Return the reachable share (nx, ny) of each cell's area; nodes at its border count in part."""
        near = ndimage.binary_dilation(self.mask, np.ones((3, 3), dtype=np.bool_))
        part = np.clip(0.5 + (self.distance - self.clearance) / self.step, 0.0, 1.0) * near
        return np.asarray(self.blocks(part).mean(axis=-1), dtype=np.float64)

    def with_clearance(self, clearance: float) -> Reach:
        """Return the reach from the same places with a smaller clearance."""
        fits = self.distance >= clearance
        parts, _ = ndimage.label(fits)
        return replace(
            self, clearance=clearance, mask=np.isin(parts, np.unique(parts[self.mask])), fits=int(fits.sum())
        )

    def cells(self) -> Bools:
        """Return whether each position cell (nx, ny) counts as reachable."""
        return np.asarray((self.areas() >= MIN_SHARE) & self.blocks(self.mask).any(axis=-1))


@dataclass(frozen=True, eq=False)
class ReturnableSet:
    """The bins that a Dubins car can reach from a pose and from which it can return.

    "Returnable" as in M. Turchetta, F. Berkenkamp and A. Krause, Safe exploration in finite Markov decision
    processes with Gaussian processes, NIPS 2016.
    """

    bins: Bools
    """(nx, ny, n_phi) reachable and returnable bins."""
    returns: Bools
    """(n, n, n_headings) lattice cells from which the pose can be reached."""
    first_heading: float
    """[rad] first heading of the lattice."""


def reach(
    arena: Arena,
    barriers: Barriers,
    *,
    clearance: float,
    cell: float,
    start: Floats | None = None,
    name: str = "start",
) -> Reach:
    """Return the places that keep `clearance` and are connected to `start` (x, y, ...).

    Without a start, return the largest connected part.


    Parameters
    ----------
    name : Name of the start in error messages.

    Raises
    ------
    PlanError : There are too many cells, the robot fits nowhere, or it cannot be at the start.
    """
    x0, y0, x1, y1 = arena.bounds
    nx, ny = (max(math.ceil(round(side / cell, 9)), 1) for side in (x1 - x0, y1 - y0))
    if nx * ny > MAX_CELLS:
        raise PlanError(
            f"cell {cell} m makes {nx} x {ny} cells of the {x1 - x0:.1f} x {y1 - y0:.1f} m arena, more than "
            f"{MAX_CELLS:,}; choose a larger cell, and check that the arena is in metres"
        )
    per_cell = max(math.ceil(round(cell / NODE_STEP, 9)), 1)
    per_cell = max(min(per_cell, math.isqrt(MAX_NODES // (nx * ny))), 2)
    step = cell / per_cell
    x: Floats = x0 + (np.arange(nx * per_cell, dtype=np.float64) + 0.5) * step
    y: Floats = y0 + (np.arange(ny * per_cell, dtype=np.float64) + 0.5) * step
    distance = barriers.field(x, y, clearance + DISTANCE_CAP)
    distance[~arena.contains_grid(x, y)] = 0.0
    fits = distance >= clearance
    if not fits.any():
        raise PlanError(
            f"no place in the arena is {clearance:.2f} m clear of walls (the widest has "
            f"{distance.max():.2f} m); the robot does not fit: use a smaller `margin` or footprint_radius"
        )
    whole = Reach(
        origin=np.array([x0, y0]),
        cell=cell,
        per_cell=per_cell,
        clearance=clearance,
        distance=distance,
        mask=fits,
        fits=int(fits.sum()),
    )
    parts, _ = ndimage.label(fits)
    if start is None:
        wanted = int(np.bincount(parts[fits]).argmax())
    else:
        away = check_free(name, start, arena, barriers, clearance)
        node = whole.nearest(start[:2])
        if node is None:
            raise PlanError(
                f"{name} ({start[0]:g}, {start[1]:g}) is in a gap of only {2 * away:.2f} m; move it into open space"
            )
        wanted = parts[tuple(node)]
    return replace(whole, mask=np.asarray(parts == wanted))


def check_free(name: str, place: Floats, arena: Arena, barriers: Barriers, clearance: float) -> float:
    """Return the distance [m] of a place from the nearest barrier.

    Raises
    ------
    PlanError : It is outside the arena or too near to a wall; `name` is its name in the message.
    """
    where = f"{name} ({place[0]:g}, {place[1]:g})"
    away = float(barriers.distances(place[None, :2])[0])
    if not arena.contains(place[:2]):
        raise PlanError(
            f"{where} is {away:.2f} m inside a wall or outside the arena; move it into free space"
        )
    if away < clearance - ROUND_OFF:
        raise PlanError(
            f"{where} is {away:.3f} m from a wall, less than the robot's radius and margin of {clearance:.3f} m; "
            "move it away from the wall or shrink footprint_radius"
        )
    return away
