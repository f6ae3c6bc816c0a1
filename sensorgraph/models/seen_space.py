"""The cells that the training rays of a model crossed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.types import Bools, Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenSpace:
    """Grid of the cells that a ray of the map's own runs crossed or ended in."""

    cells: Bools
    """(nx, ny) Whether a cell is observed. Everything outside the grid is unobserved."""
    origin: Floats
    """(2,) [m, map] Lower left corner of cell (0, 0)."""
    resolution: float
    """[m] Side of a cell."""

    @property
    def area(self) -> float:
        """Area [m²] of the observed cells."""
        return float(self.cells.sum()) * self.resolution**2

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower left and upper right corner (2,) [m, map] of the observed cells, of which there is at least one."""
        index = np.argwhere(self.cells)
        return self.corners(index.min(axis=0)), self.corners(index.max(axis=0) + 1)

    def corners(self, index: Floats) -> Floats:
        """Return the points (..., 2) [m, map] at places (..., 2) in units of cells."""
        return np.asarray(self.origin + index * self.resolution)

    def contains(self, points: Floats) -> Bools:
        """Tell which points (..., 2) [m, map] are in observed cells."""
        cells = np.floor((points - self.origin) / self.resolution).astype(np.intp)
        inside = ((cells >= 0) & (cells < self.cells.shape)).all(axis=-1)
        cells[~inside] = 0
        return np.asarray(inside & self.cells[cells[..., 0], cells[..., 1]])

    def draw(self, n: int, rng: np.random.Generator) -> Floats:
        """Draw n poses (n, 3) [m, m, rad], uniform over the observed cells and the headings."""
        cells = np.argwhere(self.cells)
        cells = cells[rng.integers(len(cells), size=n)]
        places = self.corners(cells + rng.uniform(size=cells.shape))
        return np.column_stack([places, rng.uniform(-np.pi, np.pi, n)])


def seen_space(model: Faces | CellModel) -> SeenSpace:
    """Return the cells that training rays of a model have crossed."""
    if isinstance(model, Faces):
        space = model.observed
        return SeenSpace(cells=space.counts > 0, origin=space.origin, resolution=space.cell)
    table = model.table
    seen = np.ascontiguousarray(table.is_seen[table.rows] > 0)
    return SeenSpace(cells=seen, origin=np.asarray(table.low, dtype=np.float64), resolution=table.cell)
