"""Space that rays observed when a map was made; beyond it the map carries no information."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.kernel import inner_kernel
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenSpace:
    """Grid of the cells that a ray of the map's own runs crossed or ended in."""

    cells: NDArray[np.uint8]
    """(nx, ny) 1: observed. Everything outside the grid is unobserved."""
    origin: Floats
    """(2,) [m, map] Lower left corner of cell (0, 0)."""
    resolution: float
    """[m] Side of a cell."""


def seen_by_graph(graph: Sensorgraph) -> SeenSpace | None:
    """Return the space observed by the runs of a sensorgraph of faces or cells; None for other models."""
    model = graph.model
    if isinstance(model, Faces):
        observed = model.observed
        cells = np.ascontiguousarray(observed.counts > 0, dtype=np.uint8)
        return SeenSpace(cells=cells, origin=observed.origin, resolution=observed.cell)
    if isinstance(model, CellModel):
        table = model.table
        cells = np.ascontiguousarray(table.is_seen[table.rows] > 0, dtype=np.uint8)
        return SeenSpace(cells=cells, origin=np.asarray(table.low, dtype=np.float64), resolution=table.cell)
    return None


@inner_kernel
def is_ray_seen(cells: NDArray[np.uint8], x0: float, y0: float, x1: float, y1: float) -> bool:
    """Tell whether all cells along a ray, in cell units, are observed, by steps of half a cell."""
    dx, dy = x1 - x0, y1 - y0
    n = int(2.0 * np.sqrt(dx * dx + dy * dy)) + 1
    nx, ny = cells.shape
    for k in range(n + 1):
        x, y = x0 + dx * (k / n), y0 + dy * (k / n)
        if x < 0 or y < 0 or x >= nx or y >= ny:
            return False
        if cells[int(x), int(y)] == 0:
            return False
    return True
